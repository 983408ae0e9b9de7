"""Plan in a program of your own, without PyTorch: a picture and a goal in, poses for the robot out.

Shows that an exported policy loads and plans as a training run does; only the network is run by something else. Put
your picture and your goal in: `(H, W, 3)` uint8 RGB of the policy's camera, and an outline as large as the bag looks
there. Needs what `python examples/12_export.py` writes.

Prints the plan and how sure it is, and draws it into `runs/examples/plan.png`:

    pick at (0.412, -0.083), place at (0.560, 0.204), turned by 14 degrees
    right nine times of ten within 6 and 9 mm; PyTorch was not needed
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

import cv2
import numpy as np

from baggie import Policy
from baggie.errors import BaggieError
from baggie.pictures import read_picture, write_picture
from baggie.types import Goal, Observation
from baggie.vision.draw import paint_goal

POLICY = Path("runs/examples/exported")  # or a Hub id, or the folder of a training run
CAMERA = Path("demo/keypoint/reference.png")  # a picture with a bag in it
DRAWN = Path("runs/examples/plan.png")
COLORS = {"pick": (255, 64, 160), "place": (0, 220, 255)}


def main() -> None:
    """Plan, print, draw."""
    if not (POLICY.is_dir() and CAMERA.is_file()):
        sys.exit(
            f"error: no {POLICY} and {CAMERA} here; make them first: make demo, python examples/12_export.py"
        )
    picture = read_picture(CAMERA)
    height, width = picture.shape[:2]
    side = width / 16
    middle = np.array([width / 2, height / 2])
    goal = Goal(middle + side / 2 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]), style="outline")
    try:
        policy = Policy.from_pretrained(POLICY)
        plan = policy.plan(Observation(picture), goal)
    except BaggieError as error:  # one line: no bag in sight, a goal out of reach, another camera's picture
        sys.exit(f"error: {error}")

    pick, place = plan.action.pick, plan.action.place
    turned = f"turned by {math.degrees(place.yaw - pick.yaw):.0f} degrees"
    print(f"pick at ({pick.x:.3f}, {pick.y:.3f}), place at ({place.x:.3f}, {place.y:.3f}), {turned}")
    within = [f"{1000 * m:.0f}" if m else "unknown" for m in (plan.pick_within_m, plan.place_within_m)]
    without = "was not needed" if "torch" not in sys.modules else "was loaded"
    print(f"right nine times of ten within {' and '.join(within)} mm; PyTorch {without}")

    shown = paint_goal(picture, goal)
    for name, view in plan.views.items():  # heat maps of the whole picture, at any resolution
        row, column = np.unravel_index(view.argmax(), view.shape)
        scale = width / view.shape[1]
        at = (round((column + 0.5) * scale), round((row + 0.5) * scale))
        cv2.drawMarker(shown, at, COLORS[name], cv2.MARKER_CROSS, 20, 2, cv2.LINE_AA)
    write_picture(DRAWN, shown)


if __name__ == "__main__":
    main()
