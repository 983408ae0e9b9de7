"""A policy of your own: subclass `Policy`, write `plan`.

Shows that a policy is one method, by one that learns without a network. Every attempt of a recording tells where in the
picture a bag lay and where the arm closed on it; a homography through these pairs takes pixels to the robot. The bag is
found by its hue. Needs the recording that `make demo` leaves behind.

Prints how far the plans for attempts it did not learn from are from what was done there:

    learned from 105 attempts, measured on 25
    picks 0.11 cm off (worst 0.14), places 0.62 cm (worst 1.18)
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

import baggie
from baggie.data.summary import goal_of, is_demonstration
from baggie.errors import BaggieError
from baggie.geometry import PlanarPose, apply_homography
from baggie.metrics import summary
from baggie.types import Attempt, Goal, Observation, PickPlace, Plan, require_goal

RECORDING = Path("demo/recording")


class HomographyPolicy(baggie.Policy):
    """Picks the reddest thing, places it at the goal, by a homography learned from attempts."""

    name = "homography"

    def __init__(self, attempts: Sequence[Attempt]) -> None:
        pixels = [attempt.box_before.mean(axis=0) for attempt in attempts]
        places = [attempt.outcome.executed.pick.xy for attempt in attempts]
        found, _ = cv2.findHomography(np.array(pixels), np.array(places), cv2.RANSAC, 0.01)
        self._to_robot = np.asarray(found, float)

    def plan(self, observation: Observation, goal: Goal | None = None) -> Plan:
        """Yaws stay 0. Raises `BaggieError` when nothing red is in sight, or there is no goal."""
        hsv = cv2.cvtColor(observation.color, cv2.COLOR_RGB2HSV)
        red = (np.abs(hsv[..., 0].astype(int) - 90) > 80) & (hsv[..., 1] > 120)
        if not red.any():
            raise BaggieError("expected a red bag in the picture, found none; bring it into view")
        v, u = np.nonzero(cv2.medianBlur(red.astype(np.uint8), 5))
        seen = np.array([[u.mean(), v.mean()], require_goal(goal).center])
        pick, place = (PlanarPose(x, y) for x, y in apply_homography(self._to_robot, seen).tolist())
        return Plan(PickPlace(pick, place), views={"red": red.astype(np.float32)})


def main() -> None:
    """Learn from most attempts, measure on the others."""
    if not RECORDING.is_dir():
        sys.exit(f"error: no recording in {RECORDING}; make one first: make demo")
    attempts = [attempt for attempt in baggie.open_dataset(RECORDING) if is_demonstration(attempt)]
    few = len(attempts) // 5
    policy, others = HomographyPolicy(attempts[:-few]), attempts[-few:]
    print(f"learned from {len(attempts) - few} attempts, measured on {few}")
    plans = [policy.plan(attempt.before, goal_of(attempt)).action for attempt in others]
    done = [attempt.outcome.executed for attempt in others]
    pick = summary([100 * a.pick.distance(b.pick) for a, b in zip(plans, done, strict=True)])
    place = summary([100 * a.place.distance(b.place) for a, b in zip(plans, done, strict=True)])
    print(
        f"picks {pick['mean']:.2f} cm off (worst {pick['max']:.2f}), "
        f"places {place['mean']:.2f} cm (worst {place['max']:.2f})"
    )


if __name__ == "__main__":
    main()
