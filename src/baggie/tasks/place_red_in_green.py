"""Red blocks go into green bowls, among blocks and bowls of other colours: Ravens' `place-red-in-green`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from baggie.geometry import PlanarPose
from baggie.sim.objects import Block, Color, Fixture, Part
from baggie.tasks.conditions import InSlots, Slot
from baggie.tasks.layout import COLORS, left_to_right, radius_m, scatter
from baggie.tasks.task import Scene, Setting, Task

SIDE_M, MOST = 0.04, 3
BOWL_M, WALL_M, BOTTOM_M, RIM_M = 0.09, 0.005, 0.005, 0.02  # side, walls, bottom, height of the rim
_OTHERS = [color for name, color in COLORS.items() if name not in ("red", "green")]


def bowl(name: str, color: Color) -> Fixture:
    """A square bowl."""
    high, at = RIM_M - BOTTOM_M, (BOWL_M - WALL_M) / 2
    z, inner = BOTTOM_M + high / 2, BOWL_M - 2 * WALL_M
    parts = [Part((BOWL_M, BOWL_M, BOTTOM_M), color, (0.0, 0.0, BOTTOM_M / 2))]
    parts += [Part((WALL_M, BOWL_M, high), color, (side * at, 0.0, z)) for side in (-1, 1)]
    parts += [Part((inner, WALL_M, high), color, (0.0, side * at, z)) for side in (-1, 1)]
    return Fixture(name, tuple(parts))


_RED = tuple(Block(f"red{number}", (SIDE_M,) * 3, COLORS["red"]) for number in range(MOST))
_GREEN = tuple(bowl(f"green{number}", COLORS["green"]) for number in range(MOST))
_OTHER_BLOCKS = tuple(Block(f"block{number}") for number in range(MOST))
_OTHER_BOWLS = tuple(bowl(f"bowl{number}", _OTHERS[0]) for number in range(MOST))


def _draw(rng: np.random.Generator, _setting: Setting) -> Scene:
    """One to three green bowls, at most as many red blocks, and one to three blocks and bowls that are neither."""
    bowls = rng.integers(1, MOST + 1)
    red, green = _RED[: rng.integers(1, bowls + 1)], _GREEN[:bowls]
    other_blocks = _OTHER_BLOCKS[: rng.integers(1, MOST + 1)]
    other_bowls = _OTHER_BOWLS[: rng.integers(1, MOST + 1)]
    blocks = red + tuple(replace(each, color=_other(rng)) for each in other_blocks)
    fixtures = green + tuple(bowl(each.name, _other(rng)) for each in other_bowls)
    radii = {block.name: radius_m(block.size_m) for block in blocks}
    poses = scatter(radii | {each.name: radius_m((BOWL_M, BOWL_M)) for each in fixtures}, rng)
    slots = tuple(
        Slot(PlanarPose(0.0, 0.0), BOTTOM_M + SIDE_M / 2, name)
        for name in left_to_right([each.name for each in green], poses)
    )
    condition = InSlots(
        tuple(left_to_right([block.name for block in red], poses)), slots, weight=1.0, symmetry=0
    )
    return Scene((*blocks, *fixtures), poses, (condition,))


def _other(rng: np.random.Generator) -> Color:
    return _OTHERS[rng.integers(len(_OTHERS))]


PLACE_RED_IN_GREEN = Task(
    name="place-red-in-green",
    instruction="Put each red block into a green bowl of its own.",
    tool="cup",
    view="height-map",
    things=_RED + _OTHER_BLOCKS + _GREEN + _OTHER_BOWLS,
    draw_scene=_draw,
    max_steps=10,
    object_symmetry=4,
)
