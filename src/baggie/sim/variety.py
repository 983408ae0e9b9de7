"""What a scene shows: which bag, which table, in which light, and what else is on it.

| | `plain` | `light` | `varied` | `unseen` | `two-bags` |
|---|---|---|---|---|---|
| bag: hue, degrees | 358 | as plain | 345..12, 42..58, 205..245, 262..282 | 20..34, 68..92, 172..195, 292..330 \
| as plain |
| size, cm | 12 | as plain | 10.5..13 | 9.5..10.5, 13..14.5 | as plain |
| shape | square | as plain | square; long, 1.25..1.5 | square; long, 1.5..1.8; round | as plain |
| fabric | weave | as plain | plain, weave, stripes | and checks, dots | as plain |
| fill | 1 | as plain | 0.93..1.07 | as varied | as plain |
| table | the cell's | as plain | wood, grey; lightness 110..200; grain 0.03..0.12 | dark, lightness 45..95, or tinted \
blue, green; grain 0.12..0.22 | as plain |
| lamps | the cell's | as unseen | 1 or 2, 1.6..2.2 m up | 1 to 3, 1.0..1.5 m up | as plain |
| brightness | the cell's | as unseen | 0.9..1.2 | 0.6..0.8, 1.25..1.4 | as plain |
| colour cast | 0 | as unseen | up to 4% | 7..14% | as plain |
| flat distractors | | | paper, tape; anywhere | magazines, coasters; anywhere | |
| standing distractors | | | boxes, cylinders; 14 cm outside the workspace | cups, domes; at most one inside it | |
| distractors in all | 0 | 0 | 0..4 | 1..5 | 0 |
| second bag | | | | | of another hue, 18 cm away |

A size is the side of a square bag, the diameter of a round one, the side of the square with a long one's area. In
`unseen-bag` the bag is as in `unseen` and all else as in `plain`. What varies from one picture to the next, exposure
and noise, varies in all. Hues: distractors and a second bag are at least 60 degrees from the bag's and 35 from those of
the goal card (133) and the calibration paddle (307), or grey: the colours by which bag, goal and paddle are found mean
one thing each.

Where bags are laid: clear of each other and of what stands on the table, with room left for a goal.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from baggie.errors import BaggieError
from baggie.geometry import PlanarPose, Rectangle
from baggie.options.values import Scenery
from baggie.seeds import first_fit
from baggie.sim.bag import Bag, Fabric, Shape
from baggie.sim.cell import ALL_HUES, UNSEEN, USUAL, Cell, Color, Hues, draw_light, hue_of, random_hue, rgb
from baggie.sim.clutter import CALM, STRANGE, Distractor, draw_distractors
from baggie.sim.sensor import Exposure

OBSTACLE_M = 0.16
"""Between the middles of a bag and of what stands there: an open hand is 10 cm to each side, a thing 4."""
BAGS_M = 0.18
"""Between the middles of two bags."""
_EDGE_M = 0.02
"""Between a bag's middle and the workspace's edge."""
_GOAL_M, _GOAL_EDGE_M = 0.20, 0.03
"""How far goals are from the bag and from the workspace's edge."""
_ROOM = 0.1
"""Of the places in the workspace, that a goal may have at least."""


def random_pose(workspace: Rectangle, rng: np.random.Generator) -> PlanarPose:
    """Anywhere in the workspace, at any angle."""
    x, y = workspace.sample(rng, margin=_EDGE_M)
    return PlanarPose(float(x), float(y), float(rng.uniform(-np.pi, np.pi)))


def lay_bags(
    workspace: Rectangle, obstacles: Sequence[PlanarPose], two: bool, rng: np.random.Generator
) -> tuple[PlanarPose, PlanarPose | None]:
    """Poses of a bag and, of `two`, of the second. The first try is taken where nothing is in the way.

    Raises `BaggieError` where there is no room.
    """

    def somewhere() -> tuple[PlanarPose, PlanarPose | None]:
        return random_pose(workspace, rng), random_pose(workspace, rng) if two else None

    def clear(laid: tuple[PlanarPose, PlanarPose | None]) -> bool:
        bag, second = laid
        if second is not None and bag.distance(second) < BAGS_M:
            return False
        bags = [bag] if second is None else [bag, second]
        if any(pose.distance(other) < OBSTACLE_M for pose in bags for other in obstacles):
            return False
        others = [*obstacles, *bags[1:]]
        return not others or _room(workspace, bag, others) >= _ROOM

    laid = first_fit(somewhere, clear)
    if laid is None:
        raise BaggieError(
            f"expected a workspace with room for a bag and its goal beside {len(obstacles)} things that stand there, "
            f"got {workspace}; make it larger"
        )
    return laid


def _room(workspace: Rectangle, bag: PlanarPose, others: Sequence[PlanarPose]) -> float:
    """The share of the workspace that is far enough from the bag and from all others for a goal."""
    x = np.linspace(workspace.x_min + _GOAL_EDGE_M, workspace.x_max - _GOAL_EDGE_M, 9)
    y = np.linspace(workspace.y_min + _GOAL_EDGE_M, workspace.y_max - _GOAL_EDGE_M, 17)
    places = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    free = np.hypot(*(places - bag.xy).T) >= _GOAL_M
    for other in others:
        free &= np.hypot(*(places - other.xy).T) >= OBSTACLE_M
    return float(free.mean())


VARIED_HUES: Hues = ((345.0, 372.0), (42.0, 58.0), (205.0, 245.0), (262.0, 282.0))
UNSEEN_HUES: Hues = ((20.0, 34.0), (68.0, 92.0), (172.0, 195.0), (292.0, 330.0))
"""Bands of the bag's hue, degrees; disjoint."""
_STREAM = 0x5CE7E5  # keeps what is drawn here apart from what else is drawn with the same seed


@dataclass(frozen=True)
class Variety:
    """One scene's bag, table, light and distractors."""

    cell: Cell
    """With the table and the lamps of this scene; camera and lens are the cell's own."""
    bag: Bag
    exposure: Exposure = Exposure()  # noqa: RUF009 -- frozen, too
    """Of its pictures on the average."""
    distractors: tuple[Distractor, ...] = ()
    second: Bag | None = None
    """A bag that is to stay, if there is one."""


@dataclass(frozen=True)
class _BagRange:
    hues: Hues
    sizes_m: tuple[tuple[float, float], ...]
    shapes: tuple[Shape, ...]
    aspect: tuple[float, float]
    fabrics: tuple[Fabric, ...]


_VARIED = _BagRange(
    VARIED_HUES, ((0.105, 0.13),), ("square", "long"), (1.25, 1.5), ("plain", "weave", "stripes")
)
_UNSEEN = _BagRange(
    UNSEEN_HUES,
    ((0.095, 0.105), (0.13, 0.145)),
    ("square", "long", "round"),
    (1.5, 1.8),
    ("plain", "weave", "stripes", "checks", "dots"),
)


def draw_variety(
    scenery: Scenery, cell: Cell, bag: Bag, workspace: Rectangle, seed: Sequence[int]
) -> Variety:
    """The scene that these integers name, always the same one.

    `cell` and `bag` are what a plain scene shows; `workspace`, metres in the robot's base frame, is where bags lie.
    """
    rng = np.random.default_rng([_STREAM, *seed])
    if scenery == "plain":
        return Variety(cell, bag)
    if scenery == "light":
        lit, exposure = draw_light(cell, UNSEEN, rng)
        return Variety(lit, bag, exposure)
    if scenery == "two-bags":
        hue = random_hue(rng, ALL_HUES, unlike=hue_of(bag.color))
        return Variety(cell, bag, second=replace(bag, color=_cloth_color(hue, rng), name="second"))
    if scenery == "unseen-bag":
        return Variety(cell, _draw_bag(_UNSEEN, rng))
    usual = scenery == "varied"
    drawn = _draw_bag(_VARIED if usual else _UNSEEN, rng)
    table = _usual_table(cell, rng) if usual else _unseen_table(cell, rng)
    lit, exposure = draw_light(table, USUAL if usual else UNSEEN, rng)
    things = draw_distractors(CALM if usual else STRANGE, lit, workspace, hue_of(drawn.color), rng)
    return Variety(lit, drawn, exposure, things)


def _draw_bag(bags: _BagRange, rng: np.random.Generator) -> Bag:
    low, high = bags.sizes_m[rng.integers(len(bags.sizes_m))]
    size = float(rng.uniform(low, high))
    shape = bags.shapes[rng.integers(len(bags.shapes))]
    aspect = float(rng.uniform(*bags.aspect)) if shape == "long" else 1.0
    color = _cloth_color(random_hue(rng, bags.hues, reserved=()), rng)
    shade = rng.uniform(0.55, 0.75)
    return Bag(
        length_m=size * aspect**0.5,
        width_m=size / aspect**0.5,
        fill=float(rng.uniform(0.93, 1.07)),
        mass_kg=float(0.2 * (size / 0.12) ** 2 * rng.uniform(0.9, 1.1)),
        color=color,
        weave=float(rng.uniform(0.06, 0.18)),
        shape=shape,
        fabric=bags.fabrics[rng.integers(len(bags.fabrics))],
        accent=(round(shade * color[0]), round(shade * color[1]), round(shade * color[2])),
        repeat_m=float(rng.uniform(0.02, 0.045)),
    )


def _cloth_color(hue: float, rng: np.random.Generator) -> Color:
    """A dyed cloth of this hue, degrees: never so dark or so pale that the hue is not clear."""
    return rgb(hue, rng.uniform(0.74, 0.9), rng.uniform(0.6, 0.85))


def _usual_table(cell: Cell, rng: np.random.Generator) -> Cell:
    """Wood or grey."""
    red, green, blue = rng.uniform(110, 200) * np.array(
        [1.0, rng.uniform(0.88, 1.0), rng.uniform(0.72, 0.98)]
    )
    return _with_table(cell, (int(red), int(green), int(blue)), rng.uniform(0.03, 0.12), rng)


def _unseen_table(cell: Cell, rng: np.random.Generator) -> Cell:
    """Dark, or tinted."""
    if rng.random() < 0.5:
        color = rgb(rng.uniform(0, 360), rng.uniform(0.0, 0.15), rng.uniform(45, 95) / 255)
    else:
        color = rgb(rng.uniform(150, 230), rng.uniform(0.12, 0.3), rng.uniform(110, 190) / 255)
    return _with_table(cell, color, rng.uniform(0.12, 0.22), rng)


def _with_table(cell: Cell, color: Color, grain: float, rng: np.random.Generator) -> Cell:
    return replace(
        cell, table_color=color, table_grain=float(grain), table_pattern=int(rng.integers(1, 2**31))
    )
