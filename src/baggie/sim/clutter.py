"""Draws what lies and stands about on a table.

What else may be on the table: flat things that lie there, and small things that stand there and do not move.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np

from baggie.geometry import PlanarPose, Rectangle
from baggie.seeds import first_fit
from baggie.sim.cell import ALL_HUES, Cell, Color, random_hue, rgb

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


BESIDE_M = 0.14
"""Between the workspace and the middle of what stands beside it: a hand at its edge is 10 cm to each side."""
APART_M = 0.12
"""Between the middles of two things that stand."""
_TABLE = Rectangle(0.25, 0.88, -0.62, 0.62)
"""Where things are put: on the table, in front of the robot."""
_IN_VIEW_SHARE = 1 / 32
"""Of the picture's width, by which what stands is inside the picture."""
_TRIES = 200


@dataclass(frozen=True)
class Clutter:
    """What may be there."""

    flat: tuple[Kind, ...]
    standing: tuple[Kind, ...]
    count: tuple[int, int]
    inside: int
    """How many may stand in the workspace, at most."""


CALM = Clutter(("paper", "tape"), ("box", "cylinder"), (0, 4), inside=0)
STRANGE = Clutter(("magazine", "coaster"), ("cup", "dome"), (1, 5), inside=1)


def draw_distractors(
    clutter: Clutter, cell: Cell, workspace: Rectangle, bag_hue: float, rng: np.random.Generator
) -> tuple[Distractor, ...]:
    """Things of other hues than the bag's (degrees), or grey; those that stand are in view and apart."""
    things: list[Distractor] = []
    inside = int(rng.integers(clutter.inside + 1))
    for _ in range(rng.integers(clutter.count[0], clutter.count[1] + 1)):
        kinds = clutter.standing if rng.random() < 0.5 else clutter.flat
        kind = kinds[rng.integers(len(kinds))]
        size, color, accent = _size(kind, rng), _color(rng, bag_hue), _color(rng, bag_hue)
        within = kinds is clutter.standing and inside > 0
        inside -= within
        area = workspace if within else _TABLE
        thing = first_fit(
            partial(_somewhere, area, rng, Distractor(kind, PlanarPose(0.0, 0.0), size, color, accent)),
            partial(_fits, others=things, cell=cell, workspace=workspace, within=within),
            _TRIES,
        )
        if thing is not None:
            things.append(thing)
    return tuple(things)


def _somewhere(area: Rectangle, rng: np.random.Generator, thing: Distractor) -> Distractor:
    x, y = area.sample(rng)
    return replace(thing, pose=PlanarPose(float(x), float(y), float(rng.uniform(-np.pi, np.pi))))


def _fits(
    thing: Distractor, others: list[Distractor], cell: Cell, workspace: Rectangle, within: bool
) -> bool:
    if not thing.standing:
        return True
    pose, standing = thing.pose, [other for other in others if other.standing]
    pixel = cell.project(np.array([[pose.x, pose.y, thing.size_m[2]]]))[0]
    size = np.array(cell.lens.size)
    margin = _IN_VIEW_SHARE * size[0]
    in_view = (pixel > margin).all() and (pixel < size - margin).all()
    beside = not workspace.contains(pose.x, pose.y, -BESIDE_M)
    return bool(
        in_view and (within or beside) and all(pose.distance(other.pose) >= APART_M for other in standing)
    )


def _size(kind: Kind, rng: np.random.Generator) -> tuple[float, float, float]:
    """Length, width and height, metres."""
    low, high = {
        "paper": ((0.10, 0.07, 0.0), (0.21, 0.15, 0.0)),
        "tape": ((0.05, 0.015, 0.0), (0.15, 0.025, 0.0)),
        "magazine": ((0.18, 0.13, 0.0), (0.28, 0.21, 0.0)),
        "coaster": ((0.08, 0.08, 0.0), (0.11, 0.11, 0.0)),
        "box": ((0.04, 0.04, 0.04), (0.08, 0.07, 0.08)),
        "cylinder": ((0.04, 0.04, 0.04), (0.07, 0.07, 0.08)),
        "cup": ((0.06, 0.06, 0.05), (0.08, 0.08, 0.08)),
        "dome": ((0.05, 0.05, 0.04), (0.08, 0.08, 0.06)),
    }[kind]
    length, width, height = rng.uniform(low, high).tolist()
    return length, (length if kind in ("coaster", "cylinder", "cup", "dome") else width), height


def _color(rng: np.random.Generator, bag_hue: float) -> Color:
    """Grey to white one time of three; else of a hue of its own."""
    if rng.random() < 1 / 3:
        return rgb(rng.uniform(0, 360), 0.06, rng.uniform(0.2, 0.92))
    return rgb(random_hue(rng, ALL_HUES, bag_hue), rng.uniform(0.4, 0.9), rng.uniform(0.3, 0.85))
