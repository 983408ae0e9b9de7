"""Where things lie at first: anywhere on the table that the arm reaches and the height map shows, apart.

The colours of Ravens' blocks and bowls: Tableau's ten, RGB.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from baggie.errors import BaggieError
from baggie.geometry import PlanarPose, Rectangle
from baggie.seeds import first_fit
from baggie.sim.objects import Color

COLORS: dict[str, Color] = {
    "blue": (78, 121, 167),
    "red": (255, 87, 89),
    "green": (89, 169, 79),
    "orange": (242, 142, 43),
    "yellow": (237, 201, 72),
    "purple": (176, 122, 161),
    "pink": (255, 157, 167),
    "cyan": (118, 183, 178),
    "brown": (156, 117, 95),
    "gray": (186, 176, 172),
}


REACH = Rectangle(0.30, 0.65, -0.40, 0.40)
"""Where the arm carries blocks, turned by up to a quarter turn; inside Ravens' grid by 5 cm and more."""
GAP_M = 0.015
"""Between any two things: the cup and what it carries come down without touching what is beside."""
_TRIES, _LAYOUTS = 200, 300
"""To find a place for one thing beside those that lie, and of layouts begun anew because there was none."""


def radius_m(size_m: ArrayLike) -> float:
    """Of the disc about a box's middle that holds it at any yaw; `size_m`: its sides, metres, of which two count."""
    return float(np.hypot(*np.asarray(size_m, float)[:2]) / 2)


def find_room(
    radius_m: float, taken: Mapping[str, PlanarPose], radii_m: Mapping[str, float], rng: np.random.Generator
) -> PlanarPose | None:
    """A pose, yaw and all, of a disc wholly within `REACH` and apart from discs that lie where `taken` says; metres.

    `radii_m`: theirs, by name. None where no try found room.
    """

    def somewhere() -> PlanarPose:
        x, y = REACH.sample(rng, radius_m)
        return PlanarPose(float(x), float(y), float(rng.uniform(-np.pi, np.pi)))

    def is_free(pose: PlanarPose) -> bool:
        return all(pose.distance(there) > radius_m + radii_m[at] + GAP_M for at, there in taken.items())

    return first_fit(somewhere, is_free, _TRIES)


def scatter(radii_m: Mapping[str, float], rng: np.random.Generator) -> dict[str, PlanarPose]:
    """Poses, yaw and all, of discs that overlap nowhere and lie wholly within `REACH`; by name, metres.

    Raises `BaggieError` where there is no room for all of them.
    """
    poses = first_fit(lambda: _lay_out(radii_m, rng), lambda laid: len(laid) == len(radii_m), _LAYOUTS)
    if poses is None:
        raise BaggieError(
            f"expected things that find room beside each other within {REACH}, {GAP_M * 100:.1f} cm apart, got "
            f"{len(radii_m)} of radii {[round(radius, 3) for radius in radii_m.values()]} m; take fewer or smaller ones"
        )
    return poses


def _lay_out(radii_m: Mapping[str, float], rng: np.random.Generator) -> dict[str, PlanarPose]:
    """Lay one after another where there is room for it; where there is none for one, neither it nor those after it."""
    poses: dict[str, PlanarPose] = {}
    for name in sorted(radii_m, key=lambda each: -radii_m[each]):  # small ones still find a place later
        pose = find_room(radii_m[name], poses, radii_m, rng)
        if pose is None:
            break
        poses[name] = pose
    return poses


def left_to_right(names: list[str], poses: Mapping[str, PlanarPose]) -> list[str]:
    """The order in which a picture shows what looks alike, seen from the robot."""
    return sorted(names, key=lambda name: -poses[name].y)
