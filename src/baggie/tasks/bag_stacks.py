"""Loose bags are stacked in a pattern at a site: `bag-tower`, `bag-pyramid` and `bag-layers`; at will: `bag-stack`.

In `bag-unstack` a stack stands there at first, and is taken apart.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np

from baggie.errors import BaggieError
from baggie.geometry import FloatArray, PlanarPose, Rectangle
from baggie.options.values import Scenery
from baggie.seeds import first_fit
from baggie.sim.bag import Bag
from baggie.sim.cell import Color, rgb
from baggie.sim.variety import Variety, draw_variety, unseen_colors
from baggie.tasks.pattern import PITCH_M, Pattern
from baggie.tasks.stacked import Stacked, Unstacked
from baggie.tasks.task import Scene, Setting, Task

WORKSPACE = Rectangle(0.29, 0.68, -0.36, 0.36)
"""Where bags are stacked: 3 by 4 bags side by side. The arm reaches all of it up to 35 cm above the table at any yaw,
and the camera of every cell sees bags at its edge whole.
"""
STEPS_A_BAG = 3
"""Picks and places of an episode for each bag: some have to be laid anew. Ravens gives its six blocks twenty."""
_SYMMETRY = 2
"""Half a turn comes to the same, and not a quarter, by which a bag looks the same, too: across a row the hand's fingers
have to open, so that a bag bridges the gap below it.
"""
_HUES = (358, 50, 210, 272, 90, 175, 25, 240)
"""Degrees: of bags by their number, well apart and none of them the goal card's or the paddle's."""
_SCENERIES: tuple[Scenery, ...] = ("plain", "light", "unseen-bag")
"""Those with nothing but bags on the table."""
_SITE_GAP_M, _GAP_M = 0.02, 0.004
"""Between a pattern and what lies about it, and between two loose bags."""
_ASKEW_M = 0.003
"""How far from their slots bags of a stack are laid that is to be taken apart; once settled the top is 1 cm off."""
_TURNED_RAD = math.radians(4.0)
_LOWEST_M, _RISE_M = 0.017, 0.034
"""How high the middle of the lowest bag is before it has settled, and how much higher each other one's."""
_APART = "bag-unstack"
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
    # What has its outline between these corners has its middle in the workspace.
    low = np.array([workspace.x_min, workspace.y_min]) - half
    high = np.array([workspace.x_max, workspace.y_max]) + half
    length, whole = (high - low).tolist()

    def turned() -> tuple[float, FloatArray]:
        """A yaw of the pattern, and the corners `(2, 2)` of the box along x and y that holds it then."""
        yaw = float(rng.uniform(-math.pi, math.pi))
        outlines = pattern.at(PlanarPose(0.0, 0.0, yaw)).outlines(side, side)[..., :2]
        return yaw, np.array([outlines.min(axis=(0, 1)), outlines.max(axis=(0, 1))])

    def rest_beside(box: FloatArray) -> float:
        """How wide what is left is, both sides together."""
        return float(whole - np.ptp(box[:, 1]) - 2 * _SITE_GAP_M)

    def fits(drawn: tuple[float, FloatArray]) -> bool:
        _, box = drawn
        rest = rest_beside(box)
        rows, columns = _grid(len(bags), length, rest)
        return bool(np.ptp(box[:, 0]) <= length and min(length / rows, rest / columns) >= side + _GAP_M)

    found = first_fit(turned, fits, _TRIES)
    if found is None:
        raise BaggieError(
            f"expected a workspace with room for {len(bags)} bags of {100 * side:.0f} cm beside their pattern, got "
            f"{workspace}; make it larger, or take a smaller pattern"
        )
    yaw, box = found
    rest = rest_beside(box)
    rows, columns = _grid(len(bags), length, rest)
    on_right = int(rng.integers(columns + 1))
    # No column need be wider than a bag at any yaw is: the site lies anywhere that leaves each so much.
    least = min(rest / columns, side * math.sqrt(2) + _GAP_M)
    right = on_right * least + float(rng.uniform(0.0, max(rest - columns * least, 0.0)))
    x, y = rng.uniform(low[0] - box[0, 0], high[0] - box[1, 0]), low[1] + right + _SITE_GAP_M - box[0, 1]
    left_edges = _edges(high[1] - (rest - right), high[1], columns - on_right)
    cells = [
        Rectangle(*along_x, *along_y)
        for along_x in _edges(low[0], high[0], rows)
        for along_y in [*_edges(low[1], low[1] + right, on_right), *left_edges]
    ]
    chosen = rng.permutation(len(cells))[: len(bags)]
    poses = {bag.name: _within(cells[cell], bag, rng) for bag, cell in zip(bags, chosen, strict=True)}
    return poses, PlanarPose(float(x), float(y), yaw)


def _grid(count: int, length: float, width: float) -> tuple[int, int]:
    """Rows and columns of at least `count` cells in `length` by `width`, their shorter sides as long as can be."""
    grids = [(rows, math.ceil(count / rows)) for rows in range(1, count + 1)]
    return max(grids, key=lambda grid: min(length / grid[0], width / grid[1]))


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


def _bags(rng: np.random.Generator, setting: Setting) -> tuple[tuple[Bag, ...], Variety | None]:
    """The bags of a scene, square and of one size, as its scenery has them, and what else that changes, if anything.

    Raises `BaggieError` for a scenery in which other things stand about, for which stacks leave no room.
    """
    usual = tuple(thing for thing in setting.things if isinstance(thing, Bag))
    if setting.scenery == "plain":
        return usual, None
    if setting.scenery not in _SCENERIES:
        raise BaggieError(
            f"expected one of the sceneries {', '.join(_SCENERIES)} for stacks of bags, got {setting.scenery!r}; in "
            "others things lie about where bags are stacked"
        )
    variety = draw_variety(setting.scenery, setting.cell, usual[0], setting.workspace, setting.seed)
    if variety.bag == usual[0]:
        return usual, variety
    side = math.sqrt(variety.bag.length_m * variety.bag.width_m)
    like = replace(variety.bag, length_m=side, width_m=side, shape="square")
    one_color = len({bag.color for bag in usual}) == 1
    colors = [like.color] * len(usual) if one_color else unseen_colors(len(usual), rng)
    return tuple(
        replace(like, name=bag.name, color=color) for bag, color in zip(usual, colors, strict=True)
    ), variety


def _draw(pattern: Pattern, rng: np.random.Generator, setting: Setting) -> Scene:
    bags, variety = _bags(rng, setting)
    poses, site = lay_about(bags, pattern, setting.workspace, rng)
    stacked = Stacked(
        tuple(bag.name for bag in bags),
        pattern.at(site),
        setting.workspace,
        bags[0].symmetry,
        bags[0].fill,
    )
    return Scene(bags, poses, (stacked,), variety=variety)


def _task(pattern: Pattern, *, name: str, instruction: str, one_color: bool = False) -> Task:
    return Task(
        name=name,
        instruction=instruction,
        tool="hand",
        view="camera",
        things=colored_bags(len(pattern.slots), one_color),
        draw_scene=partial(_standing if name == _APART else _draw, pattern),
        max_steps=STEPS_A_BAG * len(pattern.slots),
        object_symmetry=_SYMMETRY,
        pattern=pattern,
        workspace=WORKSPACE,
    )


def _standing(pattern: Pattern, rng: np.random.Generator, setting: Setting) -> Scene:
    """A stack that stands, askew as a hand builds it, and free places for all but its lowest bags."""
    bags, variety = _bags(rng, setting)
    above = [bag for bag, slot in zip(bags, pattern.slots, strict=True) if slot.layer]
    if not above:
        raise BaggieError(
            "expected a pattern of more than one layer to take apart, got all of it on the table"
        )
    roomy = [
        replace(bag, length_m=max(bag.length_m, PITCH_M), width_m=max(bag.width_m, PITCH_M)) for bag in above
    ]
    free, site = lay_about(roomy, pattern, setting.workspace, rng)
    standing = pattern.at(site)
    poses, heights_m = {}, {}
    for bag, slot in zip(bags, standing.slots, strict=True):
        off_m, towards = _ASKEW_M * math.sqrt(rng.random()), rng.uniform(-math.pi, math.pi)
        turned = math.pi / 2 * rng.integers(4) + rng.uniform(-_TURNED_RAD, _TURNED_RAD)
        off = PlanarPose(off_m * math.cos(towards), off_m * math.sin(towards), turned)
        poses[bag.name] = slot.pose @ off
        heights_m[bag.name] = (_LOWEST_M + _RISE_M * slot.layer) * bag.fill
    unstacked = Unstacked(
        tuple(bag.name for bag in bags),
        standing,
        tuple(free[bag.name] for bag in above),
        setting.workspace,
        bags[0].symmetry,
        bags[0].fill,
    )
    return Scene(bags, poses, (unstacked,), heights_m, variety)


def _lie_about(rng: np.random.Generator, setting: Setting) -> Scene:
    bags, variety = _bags(rng, setting)
    poses, _ = lay_about(bags, Pattern.parse("tower:1"), setting.workspace, rng)
    return Scene(bags, poses, variety=variety)


BAG_STACK = Task(
    name="bag-stack",
    instruction="Lay the bean bag onto the goal, on the table or on other bags.",
    tool="hand",
    view="camera",
    things=colored_bags(6),
    draw_scene=_lie_about,
    max_steps=STEPS_A_BAG,
    object_symmetry=_SYMMETRY,
    has_goal=True,
    workspace=WORKSPACE,
)
"""What the robot teaches itself: it builds towers and pyramids of six bags, and takes them apart."""


def stacking(task: Task, pattern: Pattern | None = None, one_color: bool = False) -> Task:
    """A task that stacks bags, with another pattern to stack as many bags in as it has slots, or bags of one colour."""
    own = task.pattern if pattern is None else pattern
    assert own is not None, f"{task.name} stacks no bags"
    return _task(own, name=task.name, instruction=task.instruction, one_color=one_color)


# By keyword, as the commands' help reads names and instructions from this text.
BAG_TOWER = _task(
    Pattern.parse("tower:3"),
    name="bag-tower",
    instruction="Stack three bean bags into a tower.",
)
BAG_PYRAMID = _task(
    Pattern.parse("pyramid:3-2-1"),
    name="bag-pyramid",
    instruction="Stack six bean bags into a pyramid: three in a row below, two on them, one on top.",
)
BAG_LAYERS = _task(
    Pattern.parse("layers:2x2,2x2 turned"),
    name="bag-layers",
    instruction="Stack eight bean bags in two layers of two by two, the upper one turned by 45 degrees.",
)
BAG_UNSTACK = _task(
    Pattern.parse("tower:3"),
    name="bag-unstack",
    instruction="Take a tower of three bean bags apart, bag by bag, each to a place of its own.",
)
