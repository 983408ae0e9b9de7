"""Annotate after recording: goals are painted when a picture is read, never into the recording.

Shows that one recording serves every way of marking a goal. Where the bag lay after an attempt is the goal of that
attempt, in hindsight; it may be shown as an outline or a patch, of any colour, or be replaced by another attempt's.
Needs the recording that `make demo` leaves behind.

Prints which attempts can teach, and draws four annotations of the first of them into `runs/examples/annotated.png`:

    128 of 130 attempts show how to reach a goal
    attempt 0: its goal's middle is at (402, 187), 122 pixels from the bag
    drawn: runs/examples/annotated.png
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

import baggie
from baggie.data.summary import goal_of, is_demonstration
from baggie.pictures import write_picture
from baggie.vision.draw import paint_goal

RECORDING = Path("demo/recording")
PICTURE = Path("runs/examples/annotated.png")


def main() -> None:
    """Four annotations of one picture."""
    if not RECORDING.is_dir():
        sys.exit(f"error: no recording in {RECORDING}; make one first: make demo")
    recording = baggie.open_dataset(RECORDING)
    teaching = [attempt for attempt in recording if is_demonstration(attempt)]
    print(f"{len(teaching)} of {len(recording)} attempts show how to reach a goal")

    attempt, other = teaching[:2]
    goal = goal_of(attempt)  # Goal(corners), pixels (u, v) of the picture before
    u, v = goal.center
    away = np.linalg.norm(goal.center - attempt.box_before.mean(axis=0))
    print(
        f"attempt {attempt.attempt_id}: its goal's middle is at ({u:.0f}, {v:.0f}), {away:.0f} pixels from the bag"
    )

    ways = [
        goal,
        replace(goal, style="outline"),
        replace(goal, style="outline", color=(255, 160, 0)),
        goal_of(other),  # any attempt's goal, with its release pose, may be the goal in any other's picture
    ]
    pictures = [paint_goal(attempt.before.color, way) for way in ways]
    write_picture(PICTURE, np.vstack([np.hstack(pictures[:2]), np.hstack(pictures[2:])]))
    print(f"drawn: {PICTURE}")


if __name__ == "__main__":
    main()
