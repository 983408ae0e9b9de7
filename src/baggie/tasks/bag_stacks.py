"""Loose bags are stacked in a pattern at a site: `bag-tower`, `bag-pyramid` and `bag-layers`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from itertools import pairwise

import numpy as np

from baggie.errors import BaggieError
from baggie.geometry import FloatArray, PlanarPose, Rectangle
from baggie.seeds import first_fit
from baggie.sim.bag import Bag
from baggie.sim.cell import Color, rgb
from baggie.tasks.pattern import Pattern
from baggie.tasks.stacked import Stacked
from baggie.tasks.task import Scene, Setting, Task

WORKSPACE = Rectangle(0.29, 0.68, -0.36, 0.36)
"""Where bags are stacked: 3 by 4 bags side by side. The arm reaches all of it up to 35 cm above the table at any yaw,
and the camera of every cell sees bags at its edge whole.
"""
SPARE_STEPS = 3
"""Picks and places of an episode, beside one a bag: for what has to be laid anew."""
_SYMMETRY = 2
"""Half a turn comes to the same, and not a quarter, by which a bag looks the same, too: across a row the hand's fingers
have to open, so that a bag bridges the gap below it.
"""
_HUES = (358, 50, 210, 272, 25, 175, 90, 240)
"""Degrees: of bags by their number, well apart and none of them the goal card's or the paddle's."""
_SITE_GAP_M, _GAP_M = 0.02, 0.004
"""Between a pattern and what lies about it, and between two loose bags."""
_TRIES = 200


def colored_bags(count: int, one_color: bool = False) -> tuple[Bag, ...]:
    """So many bags, each of a colour of its own or all of one."""
    colors: list[Color] = [rgb(hue, 0.8, 0.78) for hue in _HUES]
    return tuple(Bag(name=f"bag {n + 1}", color=colors[0 if one_color else n]) for n in range(count))


def lay_about(
    bags: Sequence[Bag], pattern: Pattern, workspace: Rectangle, rng: np.random.Generator
) -> tuple[dict[str, PlanarPose], PlanarPose]:
    """Poses of loose bags, by name, and a site for a pattern, its own frame's pose; none overlap, at any height.

    The site, turned anyhow, has a strip across the workspace to itself. Each bag lies wholly in a cell of its own, of a
    grid over what is left on either side, so this ends after as many draws whatever comes. All middles are in the
    workspace. Raises `BaggieError` where it is too small.
    """
    side = max(max(bag.size_m[:2]) for bag in bags)
    half = min(min(bag.size_m[:2]) for bag in bags) / 2
    # A bag whose outline is in this area has its middle in the workspace.
    low, high = (
        np.array([workspace.x_min, workspace.y_min]) - half,
        np.array([workspace.x_max, workspace.y_max]) + half,
    )
    span = high - low

    def turned() -> tuple[float, FloatArray]:
        yaw = float(rng.uniform(-math.pi, math.pi))
        corners = pattern.at(PlanarPose(0.0, 0.0, yaw)).outlines(side, side)[..., :2].reshape(-1, 2)
        return yaw, np.array([corners.min(axis=0), corners.max(axis=0)])

    def room(box: FloatArray) -> float:
        """How long the rest of the area is, without the strip of the site."""
        return float(span[1] - (box[1] - box[0])[1] - 2 * _SITE_GAP_M)

    def fits(drawn: tuple[float, FloatArray]) -> bool:
        _, box = drawn
        smallest = min(_cell(len(bags), span[0], room(box)))
        return bool((box[1] - box[0])[0] <= span[0] and smallest >= side + _GAP_M)

    found = first_fit(turned, fits, _TRIES)
    if found is None:
        raise BaggieError(
            f"expected a workspace with room for {len(bags)} bags of {100 * side:.0f} cm beside their pattern, got "
            f"{workspace}; make it larger, or take a smaller pattern"
        )
    yaw, box = found
    rest = room(box)
    rows, columns = (
        round(total / each)
        for total, each in zip((span[0], rest), _cell(len(bags), span[0], rest), strict=True)
    )
    on_right = int(rng.integers(columns + 1))
    # No column need be longer than a bag at any yaw: the site lies anywhere that leaves each so much.
    least = min(rest / columns, side * math.sqrt(2) + _GAP_M)
    right = on_right * least + float(rng.uniform(0.0, max(rest - columns * least, 0.0)))
    site = PlanarPose(
        float(rng.uniform(low[0] - box[0, 0], high[0] - box[1, 0])),
        float(low[1] + right + _SITE_GAP_M - box[0, 1]),
        yaw,
    )
    edges = [
        *_edges(low[1], low[1] + right, on_right),
        *_edges(high[1] - (rest - right), high[1], columns - on_right),
    ]
    cells = [
        Rectangle(float(x0), float(x1), y0, y1)
        for x0, x1 in _edges(low[0], high[0], rows)
        for y0, y1 in edges
    ]
    chosen = rng.permutation(len(cells))[: len(bags)]
    poses = {bag.name: _within(cells[cell], bag, rng) for bag, cell in zip(bags, chosen, strict=True)}
    return poses, site


def _cell(count: int, length: float, width: float) -> tuple[float, float]:
    """The sides of the cells of a grid over `length` by `width`, at least `count` of them, none of them narrow."""
    grids = [(length / rows, width / math.ceil(count / rows)) for rows in range(1, count + 1)]
    return max(grids, key=min)


def _edges(start: float, end: float, count: int) -> list[tuple[float, float]]:
    """From where to where each of `count` equal parts of a stretch goes."""
    ends = np.linspace(start, end, count + 1).tolist()
    return list(pairwise(ends)) if count else []


def _within(cell: Rectangle, bag: Bag, rng: np.random.Generator) -> PlanarPose:
    """A pose of a bag that lies wholly in a cell, turned as far as there is room for."""
    room = np.array([cell.x_max - cell.x_min, cell.y_max - cell.y_min]) - _GAP_M

    def extent(yaw: float) -> FloatArray:
        return np.asarray(np.ptp(PlanarPose(0.0, 0.0, yaw).outline(*bag.size_m[:2]), axis=0))

    yaw = first_fit(
        lambda: float(rng.uniform(-math.pi, math.pi)), lambda yaw: bool((extent(yaw) <= room).all()), _TRIES
    )
    yaw = 0.0 if yaw is None else yaw
    middle = np.array([cell.x_max + cell.x_min, cell.y_max + cell.y_min]) / 2
    play = (room - extent(yaw)) / 2
    x, y = middle + rng.uniform(-play, play)
    return PlanarPose(float(x), float(y), yaw)


def _draw(pattern: Pattern, rng: np.random.Generator, setting: Setting) -> Scene:
    bags = tuple(thing for thing in setting.things if isinstance(thing, Bag))
    poses, site = lay_about(bags, pattern, setting.workspace, rng)
    stacked = Stacked(
        tuple(bag.name for bag in bags),
        pattern.at(site),
        setting.workspace,
        bags[0].symmetry,
        bags[0].fill,
    )
    return Scene(bags, poses, (stacked,))


_TOWER, _PYRAMID, _LAYERS = map(Pattern.parse, ("tower:3", "pyramid:3-2-1", "layers:2x2,2x2 turned"))

BAG_TOWER = Task(
    name="bag-tower",
    instruction="Stack three bean bags into a tower.",
    tool="hand",
    view="camera",
    things=colored_bags(len(_TOWER.slots)),
    draw_scene=partial(_draw, _TOWER),
    max_steps=len(_TOWER.slots) + SPARE_STEPS,
    object_symmetry=_SYMMETRY,
    workspace=WORKSPACE,
)
BAG_PYRAMID = Task(
    name="bag-pyramid",
    instruction="Stack six bean bags into a pyramid: three in a row below, two on them, one on top.",
    tool="hand",
    view="camera",
    things=colored_bags(len(_PYRAMID.slots)),
    draw_scene=partial(_draw, _PYRAMID),
    max_steps=len(_PYRAMID.slots) + SPARE_STEPS,
    object_symmetry=_SYMMETRY,
    workspace=WORKSPACE,
)
BAG_LAYERS = Task(
    name="bag-layers",
    instruction="Stack eight bean bags in two layers of two by two, the upper one turned by 45 degrees.",
    tool="hand",
    view="camera",
    things=colored_bags(len(_LAYERS.slots)),
    draw_scene=partial(_draw, _LAYERS),
    max_steps=len(_LAYERS.slots) + SPARE_STEPS,
    object_symmetry=_SYMMETRY,
    workspace=WORKSPACE,
)
