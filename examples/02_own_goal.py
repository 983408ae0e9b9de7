"""A goal of your own: mark in the picture where the bag is to go.

Shows what a goal is: an outline in the picture, as large as the bag looks there. It may be turned; with several bags in
view it may say which one is meant, by a pixel on it. A policy answers with poses for the robot, and how sure it is.
Needs what `make demo` leaves behind.

Prints a plan for each goal, and draws them into `runs/examples/own-goal.png`:

    square to the picture: pick (0.412, 0.083), place (0.488, -0.102) at 1 degrees, within 6 and 9 mm
    turned by 30 degrees: pick (0.412, 0.083), place (0.488, -0.102) at -29 degrees, within 6 and 9 mm
    of the bag at (301, 122): pick (0.412, 0.083), place (0.488, -0.102) at 1 degrees, within 6 and 9 mm
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

from baggie import Policy, open_dataset
from baggie.data.summary import goal_of
from baggie.geometry import rotation
from baggie.pictures import write_picture
from baggie.types import Goal, Observation
from baggie.vision.draw import paint_goal

POLICY, RECORDING = Path("demo/keypoint"), Path("demo/recording")
PICTURE = Path("runs/examples/own-goal.png")


def main() -> None:
    """Plan with three goals in one picture."""
    if not (POLICY.is_dir() and RECORDING.is_dir()):
        sys.exit(f"error: no {POLICY} and {RECORDING} here; make them first: make demo")
    policy = Policy.from_pretrained(POLICY)
    attempt = open_dataset(RECORDING)[0]
    observation = Observation(attempt.before.color)  # any picture (H, W, 3) of the policy's camera
    corners = goal_of(attempt).corners  # (4, 2) pixels (u, v): where the bag lay in the end
    middle = corners.mean(axis=0)
    turned = (corners - middle) @ rotation(math.radians(30)).T + middle
    u, v = attempt.box_before.mean(axis=0).tolist()
    goals = {
        "square to the picture": Goal(corners),
        "turned by 30 degrees": Goal(turned, style="outline", color=(255, 160, 0)),
        f"of the bag at ({u:.0f}, {v:.0f})": Goal(corners, object_at=(u, v)),
    }
    picture = observation.color
    for name, goal in goals.items():
        plan = policy.plan(observation, goal)
        pick, place = plan.action.pick, plan.action.place
        sure = [f"{1000 * m:.0f}" if m else "unknown" for m in (plan.pick_within_m, plan.place_within_m)]
        print(
            f"{name}: pick ({pick.x:.3f}, {pick.y:.3f}), place ({place.x:.3f}, {place.y:.3f}) "
            f"at {math.degrees(place.yaw):.0f} degrees, within {' and '.join(sure)} mm"
        )
        picture = paint_goal(picture, goal)
    write_picture(PICTURE, picture)


if __name__ == "__main__":
    main()
