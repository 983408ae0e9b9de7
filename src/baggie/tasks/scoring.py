"""How much of a task is done: as Ravens counts it, and strictly.

Zeng et al., "Transporter Networks", CoRL 2020: a block counts where it is within 1 cm and 15 degrees of a slot. Poses
are `T_base_body` `(4, 4)` by name, of blocks and fixtures, as `World.poses` gives them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import linear_sum_assignment

from baggie.geometry import FloatArray, wrap_angle
from baggie.tasks.task import Stage

if TYPE_CHECKING:
    from baggie.sim.world import World

POSITION_M = 0.01
HEIGHT_M = 0.01
ANGLE_RAD = np.deg2rad(15.0)
STANDS_S = 2.0

Poses = Mapping[str, FloatArray]


class RavensScore:
    """The published reward, from one pick and place to the next.

    Each block of the current stage that counts for any of its slots earns its share of the stage's weight. As
    published, this knows nothing of height, several blocks may count for the same slot, what leaves its slot loses its
    share again, and a stage that was full once is never looked at again. At most one stage ends at a time.
    """

    def __init__(self, stages: Sequence[Stage]) -> None:
        self.total = 0.0
        """The reward so far, 1 for all of the task: the partial credit."""
        self._stages = tuple(stages)
        self._full = 0

    @property
    def done(self) -> bool:
        """Whether every stage has been full."""
        return self._full == len(self._stages)

    def count(self, poses: Poses) -> float:
        """How much the total has grown (or shrunk) since the last time, by where everything is now."""
        if self.done:
            return 0.0
        stage, before = self._stages[self._full], self.total
        slots = [slot.T_base_slot(poses) for slot in stage.slots]
        inside = sum(
            any(counts(poses[block], slot, stage.symmetry) for slot in slots) for block in stage.blocks
        )
        share = 0.0
        if inside == len(stage.blocks):
            self._full += 1
        else:
            share = stage.weight * inside / len(stage.blocks)
        # Of the sum of all weights, added up alike, so that all of the task is 1 exactly.
        self.total = (_weight(self._stages[: self._full]) + share) / _weight(self._stages)
        return self.total - before


def filled(stage: Stage, poses: Poses) -> dict[str, int]:
    """Which slot each block of a stage fills, strictly; no two fill the same, and those that fill none are left out."""
    slots = [slot.T_base_slot(poses) for slot in stage.slots]
    fits = np.array([[_fits(poses[block], slot, stage.symmetry) for slot in slots] for block in stage.blocks])
    pairs = np.transpose(linear_sum_assignment(fits, maximize=True)).tolist()
    return {stage.blocks[block]: slot for block, slot in pairs if fits[block, slot]}


def all_filled(stages: Sequence[Stage], poses: Poses) -> bool:
    """Whether every block of every stage is, upright and at the right height, in a slot of its own."""
    return all(len(filled(stage, poses)) == len(stage.blocks) for stage in stages)


def strict_success(stages: Sequence[Stage], world: World, stands_s: float = STANDS_S) -> bool:
    """Whether `all_filled` holds now and still does after `stands_s` seconds, which pass only if it does now."""
    if not all_filled(stages, world.poses()):
        return False
    world.advance(stands_s)
    return all_filled(stages, world.poses())


def counts(T_base_block: FloatArray, T_base_slot: FloatArray, symmetry: int) -> bool:
    """Whether a block counts for a slot as published: within 1 cm and 15 degrees of what looks the same."""
    near = np.hypot(*(T_base_block - T_base_slot)[:2, 3]) < POSITION_M
    turn = yaw_of(T_base_block) - yaw_of(T_base_slot)
    return bool(near and (symmetry == 0 or abs(wrap_angle(turn, 2 * np.pi / symmetry)) < ANGLE_RAD))


def _fits(T_base_block: FloatArray, T_base_slot: FloatArray, symmetry: int) -> bool:
    level = abs(T_base_block[2, 3] - T_base_slot[2, 3]) < HEIGHT_M
    upright = T_base_block[2, 2] > np.cos(ANGLE_RAD)
    return bool(level and upright and counts(T_base_block, T_base_slot, symmetry))


def _weight(stages: Sequence[Stage]) -> float:
    return sum(stage.weight for stage in stages)


def yaw_of(T: FloatArray) -> float:
    """Radians: which way the x axis points, seen from above."""
    return float(np.arctan2(T[1, 0], T[0, 0]))
