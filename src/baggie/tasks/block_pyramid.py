"""Six blocks become a pyramid on a stand: Ravens' `stack-block-pyramid`."""

from __future__ import annotations

import numpy as np

from baggie.geometry import PlanarPose
from baggie.sim.objects import Block, stand
from baggie.tasks.conditions import InSlots, Slot
from baggie.tasks.layout import COLORS, radius_m, scatter
from baggie.tasks.task import Scene, Setting, Task

SIDE_M, SPACING_M, PLATE_M = 0.04, 0.05, 0.005
ROWS = (("purple", "blue", "green"), ("yellow", "orange"), ("red",))
WEIGHTS = (1 / 2, 1 / 3, 1 / 6)

_BLOCKS = tuple(Block(color, (SIDE_M,) * 3, COLORS[color]) for row in ROWS for color in row)
_STAND = stand(plate_m=(SPACING_M, SPACING_M, PLATE_M))
_RADII_M = {block.name: radius_m(block.size_m) for block in _BLOCKS} | {
    _STAND.name: radius_m((SPACING_M, 3 * SPACING_M))
}


def _row(level: int, width: int) -> tuple[Slot, ...]:
    """The slots of a row, from the stand's dark end to its light one."""
    height = PLATE_M + (level + 0.5) * SIDE_M
    along = SPACING_M * (np.arange(width) - (width - 1) / 2)
    return tuple(Slot(PlanarPose(0.0, float(y)), height, _STAND.name) for y in along)


_CONDITIONS = tuple(
    InSlots(row, _row(level, len(row)), weight)
    for level, (row, weight) in enumerate(zip(ROWS, WEIGHTS, strict=True))
)


def _draw(rng: np.random.Generator, _setting: Setting) -> Scene:
    return Scene((*_BLOCKS, _STAND), scatter(_RADII_M, rng), _CONDITIONS)


BLOCK_PYRAMID = Task(
    name="block-pyramid",
    instruction="Build a pyramid of six blocks on the stand: purple, blue and green below, yellow and orange on "
    "them, red on top.",
    tool="cup",
    view="height-map",
    things=(*_BLOCKS, _STAND),
    draw_scene=_draw,
    max_steps=12,
    object_symmetry=4,
)
