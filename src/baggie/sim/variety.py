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

Bags are laid clear of each other and of what stands on the table, with room left for a goal.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np

from baggie.errors import BaggieError
from baggie.geometry import PlanarPose, Rectangle
from baggie.options.values import Scenery
from baggie.seeds import first_fit
from baggie.sim.bag import Bag, Fabric, Shape
from baggie.sim.cell import ALL_HUES, UNSEEN, USUAL, Cell, Color, Hues, draw_light, hue_of, random_hue, rgb
from baggie.sim.sensor import Exposure

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
    """Which distractors may be drawn, and how many."""

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
    """Draw distractors of other hues than the bag's (degrees), or grey; those that stand are in view and apart."""
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
    """Draw a pose anywhere in the workspace, at any angle."""
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


def unseen_colors(count: int, rng: np.random.Generator) -> tuple[Color, ...]:
    """Draw so many colours of unseen hues: four in a row are of a band each, the next four of its other half."""
    bands, half = rng.permutation(np.array(UNSEEN_HUES)).tolist(), int(rng.integers(2))
    drawn = []
    for number in range(count):
        low, high = bands[number % len(bands)]
        width = (high - low) / 2
        start = low + width * ((number // len(bands) + half) % 2)
        drawn.append(_cloth_color(float(rng.uniform(start, start + width)), rng))
    return tuple(drawn)


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
