"""Two blocks lie side by side on a tray."""

from __future__ import annotations

import numpy as np

from baggie.geometry import PlanarPose
from baggie.sim.objects import Block, Fixture, Part
from baggie.tasks.conditions import InSlots, Slot
from baggie.tasks.layout import COLORS, left_to_right, radius_m, scatter
from baggie.tasks.task import Scene, Setting, Task

SIDE_M, TRAY_M, HIGH_M = 0.04, (0.08, 0.14), 0.004
APART_M = 0.03
"""From the tray's middle to each of the slots."""

BLOCKS = tuple(Block(f"{color} block", (SIDE_M,) * 3, COLORS[color]) for color in ("blue", "orange"))
TRAY = Fixture("tray", (Part((*TRAY_M, HIGH_M), (90, 90, 90), (0.0, 0.0, HIGH_M / 2)),))
SLOTS = tuple(Slot(PlanarPose(0.0, y), HIGH_M + SIDE_M / 2, "tray") for y in (APART_M, -APART_M))
RADII_M = {block.name: radius_m(block.size_m) for block in BLOCKS} | {"tray": radius_m(TRAY_M)}


def _draw(rng: np.random.Generator, _setting: Setting) -> Scene:
    poses = scatter(RADII_M, rng)
    first = left_to_right([block.name for block in BLOCKS], poses)
    return Scene((*BLOCKS, TRAY), poses, (InSlots(tuple(first), SLOTS, weight=1.0),))


TWO_ON_A_TRAY = Task(
    name="two-on-a-tray",
    instruction="Put both blocks onto the tray, side by side.",
    tool="cup",
    view="height-map",
    things=(*BLOCKS, TRAY),
    draw_scene=_draw,
    max_steps=4,
    object_symmetry=4,
)
