"""What else may be on the table: flat things that lie there, and small things that stand there and do not move."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from baggie.geometry import PlanarPose

Kind = Literal["paper", "tape", "box", "cylinder", "magazine", "coaster", "cup", "dome"]
FLAT: tuple[Kind, ...] = ("paper", "tape", "magazine", "coaster")
"""They touch nothing."""
_SHEET_M = 0.0002  # thinner than the goal card, which is to lie on top


@dataclass(frozen=True)
class Distractor:
    """A thing on the table that is neither bag nor goal."""

    kind: Kind
    pose: PlanarPose
    """Of its middle, robot base frame."""
    size_m: tuple[float, float, float]
    """Length, width and height along its own axes; round things are as long as wide."""
    color: tuple[int, int, int]
    """RGB."""
    accent: tuple[int, int, int] = (240, 240, 235)
    """RGB of the picture on a magazine and of what is in a cup."""

    @property
    def standing(self) -> bool:
        """Whether a gripper or a bag can run into it."""
        return self.kind not in FLAT


def distractor_xml(number: int, thing: Distractor) -> str:
    """The geoms of the `number`-th distractor, fixed to the world."""
    return "".join(_parts(number, thing))


def _parts(number: int, thing: Distractor) -> list[str]:
    half = np.array(thing.size_m) / 2
    if not thing.standing:
        # A little above those before: what overlaps at the same height would flicker.
        level = _SHEET_M / 2 * (number + 1) / 8
        round_ = thing.kind == "coaster"
        flat = (half[0], _SHEET_M / 2) if round_ else (half[0], half[1], _SHEET_M / 2)
        parts = [_geom(thing, "cylinder" if round_ else "box", flat, level)]
        if thing.kind == "magazine":
            picture = (0.75 * half[0], 0.5 * half[1], _SHEET_M / 2)
            parts.append(_geom(thing, "box", picture, level + _SHEET_M / 16, thing.accent))
        return parts
    if thing.kind == "dome":  # its lower half is under the table
        return [_geom(thing, "ellipsoid", (half[0], half[1], 2 * half[2]), 0.0)]
    if thing.kind == "box":
        return [_geom(thing, "box", tuple(half), half[2])]
    parts = [_geom(thing, "cylinder", (half[0], half[2]), half[2])]
    if thing.kind == "cup":
        parts.append(_geom(thing, "cylinder", (0.85 * half[0], 0.0005), 2 * half[2], thing.accent))
    return parts


def _geom(
    thing: Distractor,
    shape: str,
    size: tuple[float, ...],
    z: float,
    color: tuple[int, int, int] | None = None,
) -> str:
    pose, touches = thing.pose, int(thing.standing)
    rgb = " ".join(f"{value / 255:.3f}" for value in color or thing.color)
    return f"""
    <geom type="{shape}" size="{" ".join(f"{side:.5f}" for side in size)}" pos="{pose.x:.5f} {pose.y:.5f} {z:.6f}"
        euler="0 0 {np.rad2deg(pose.yaw):.4f}" rgba="{rgb} 1" contype="{touches}" conaffinity="{touches}"/>"""
