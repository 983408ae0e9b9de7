"""Draws what lies and stands about on a table."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from baggie.geometry import PlanarPose, Rectangle
from baggie.seeds import first_fit
from baggie.sim.cell import Cell
from baggie.sim.colors import ALL_HUES, Color, random_hue, rgb
from baggie.sim.distractors import Distractor, Kind

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
