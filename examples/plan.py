"""A picture and a goal in, poses for the robot out: five lines, and what it takes to show them.

    python examples/plan.py                                           # after `make demo`
    python examples/plan.py --policy RUN --picture photo.png --goal 320 180

RUN is the folder of a training run, a Hub id, or what `baggie export` wrote.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import tyro

from baggie import Policy, open_dataset
from baggie.errors import BaggieError
from baggie.pictures import read_picture, write_picture
from baggie.types import Goal, Image, Observation, Plan
from baggie.vision.draw import paint_goal

DEMO = Path("demo")
COLORS = {"pick": (255, 64, 160), "place": (0, 220, 255)}


@dataclass(frozen=True)
class Options:
    """Plan one pick and place."""

    policy: str = str(DEMO / "keypoint")
    """The folder of a training run or of an exported policy, or a Hub id."""
    picture: Path | None = None
    """What the policy's camera sees; the last picture of the demo's recording unless given."""
    goal: tuple[float, float] | None = None
    """The goal's middle, pixels (u, v) of the picture; the picture's middle unless given."""
    side: float | None = None
    """The goal's side, pixels: as long as the bag's looks. A sixteenth of the picture's width unless given."""
    out: Path = Path("plan.png")
    """Where to draw the plan."""


def main(options: Options) -> int:
    """Plan, print, draw; the exit status."""
    if options.policy == Options.policy and not Path(options.policy).is_dir():
        return failed(
            f"no run in {options.policy}: `make demo` makes one, or give --policy RUN --picture FILE"
        )
    if options.picture is None and not (DEMO / "recording").is_dir():
        return failed("no picture: give --picture FILE, one of the policy's camera")
    try:
        picture = the_picture(options.picture)
        height, width = picture.shape[:2]
        goal_at = options.goal or (width / 2, height / 2)

        # The five lines.
        policy = Policy.from_pretrained(options.policy)
        observation = Observation(picture)
        goal = Goal(square(goal_at, options.side or width / 16))
        plan = policy.plan(observation, goal)
        print(plan.action)

        write_picture(options.out, drawn(picture, goal, plan))
    except BaggieError as error:
        return failed(str(error))
    within = [f"{1000 * m:.0f} mm" if m else "unknown" for m in (plan.pick_within_m, plan.place_within_m)]
    print(f"confidence {plan.confidence:.0%}; right nine times of ten within: {' and '.join(within)}")
    print(f"drawn: {options.out}")
    return 0


def failed(why: str) -> int:
    print(f"error: {why}", file=sys.stderr)
    return 1


def the_picture(path: Path | None) -> Image:
    if path is not None:
        return read_picture(path)
    recording = open_dataset(DEMO / "recording")
    return recording[len(recording) - 1].before.color


def square(middle: tuple[float, float], side: float) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """The corners `(4, 2)` around a pixel (u, v)."""
    return np.array(middle) + side / 2 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])


def drawn(picture: Image, goal: Goal, plan: Plan) -> Image:
    """The goal's outline, and a cross where each heat map is greatest; a policy without heat maps has none."""
    shown = paint_goal(picture, Goal(goal.corners, "outline"))
    for name, view in plan.views.items():
        row, column = np.unravel_index(view.argmax(), view.shape)
        scale = picture.shape[1] / view.shape[1]
        at = (round((column + 0.5) * scale - 0.5), round((row + 0.5) * scale - 0.5))
        cv2.drawMarker(shown, at, COLORS[name], cv2.MARKER_CROSS, 20, 2, cv2.LINE_AA)
        cv2.putText(shown, name, (at[0] + 10, at[1] - 10), cv2.FONT_HERSHEY_SIMPLEX, 0.5, COLORS[name])
    return shown


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Options)))
