"""Where things lie at first: anywhere on the table that the arm reaches and the height map shows, apart."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from baggie.geometry import PlanarPose, Rectangle

REACH = Rectangle(0.30, 0.65, -0.40, 0.40)
"""Where the arm carries blocks, turned by up to a quarter turn; inside Ravens' grid by 5 cm and more."""
GAP_M = 0.015
"""Between any two things: the cup and what it carries come down without touching what is beside."""
_TRIES = 200


def radius_m(size_m: ArrayLike) -> float:
    """Of the disc about a box's middle that holds it at any yaw; `size_m`: its sides, metres, of which two count."""
    return float(np.hypot(*np.asarray(size_m, float)[:2]) / 2)


def scatter(radii_m: Mapping[str, float], rng: np.random.Generator) -> dict[str, PlanarPose]:
    """Poses, yaw and all, of discs that overlap nowhere and lie wholly within `REACH`; by name, metres."""
    while True:
        poses: dict[str, PlanarPose] = {}
        for name in sorted(radii_m, key=lambda each: -radii_m[each]):  # small ones still find a place later
            for _ in range(_TRIES):
                x, y = REACH.sample(rng, radii_m[name])
                pose = PlanarPose(float(x), float(y), float(rng.uniform(-np.pi, np.pi)))
                if all(
                    pose.distance(there) > radii_m[name] + radii_m[at] + GAP_M for at, there in poses.items()
                ):
                    poses[name] = pose
                    break
            else:
                break  # too full: begin anew
        if len(poses) == len(radii_m):
            return poses


def left_to_right(names: list[str], poses: Mapping[str, PlanarPose]) -> list[str]:
    """The order in which a picture shows what looks alike, seen from the robot."""
    return sorted(names, key=lambda name: -poses[name].y)
