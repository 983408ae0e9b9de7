"""The scripted demonstrator: what to do next, by the simulator's truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from baggie.geometry import FloatArray, PlanarPose, wrap_angle
from baggie.sim.tasks.scoring import filled, yaw_of
from baggie.sim.tasks.task import Slot, Stage
from baggie.types import PickPlace


@dataclass(frozen=True)
class Remaining:
    """What is left to do of the first stage that is not full."""

    stage: Stage
    blocks: Sequence[str]
    """Those that fill no slot, in the stage's order."""
    slots: Sequence[Slot]
    """The lowest of those that are free, in the stage's order: nothing goes where nothing is yet to rest on."""


def remaining(stages: Sequence[Stage], poses: Mapping[str, FloatArray]) -> Remaining | None:
    """What is left to do, or None when every block is in its slot, strictly.

    `poses`: `T_base_body` `(4, 4)` of blocks and fixtures by name.
    """
    for stage in stages:
        at = filled(stage, poses)
        waiting = [block for block in stage.blocks if block not in at]
        if waiting:
            free = [slot for number, slot in enumerate(stage.slots) if number not in at.values()]
            lowest = min(slot.height_m for slot in free)
            return Remaining(stage, waiting, [slot for slot in free if slot.height_m == lowest])
    return None


def next_action(stages: Sequence[Stage], poses: Mapping[str, FloatArray]) -> PickPlace | None:
    """The next pick and place, or None when every block is in its slot, strictly.

    Of the first stage that is not full it takes the first block that fills no slot, by its middle and at yaw 0, to the
    lowest free slot, the first of equally low ones. A stage lists both in an order that a picture decides, so that what
    is demonstrated can be learned. Of the yaws that come to the same it chooses the one that turns the wrist least.
    `poses`: `T_base_body` `(4, 4)` of blocks and fixtures by name.
    """
    left = remaining(stages, poses)
    if left is None:
        return None
    return carry(poses[left.blocks[0]], left.slots[0].T_base_slot(poses), left.stage.symmetry)


def carry(
    T_base_block: FloatArray,
    T_base_slot: FloatArray,
    symmetry: int,
    at: ArrayLike = (0.0, 0.0),
    alike: int = 0,
) -> PickPlace:
    """From where a block is to where it has to go, `(4, 4)` both; `symmetry` as in `Stage`.

    `at` `(2,)`: where it is picked, in its own frame, metres. `alike`: which of the turns that come to the same, of
    `symmetry`; 0 is the least.
    """
    turn = 0.0
    if symmetry:
        turn = wrap_angle(yaw_of(T_base_slot) - yaw_of(T_base_block), 2 * np.pi / symmetry)
        turn = wrap_angle(turn + 2 * np.pi * alike / symmetry) if alike else turn
    beside = T_base_block[:2, :2] @ np.asarray(at, float)
    (from_x, from_y), (to_x, to_y) = (
        T_base_block[:2, 3] + beside,
        T_base_slot[:2, 3] + PlanarPose(0.0, 0.0, turn).matrix()[:2, :2] @ beside,
    )
    return PickPlace(PlanarPose(float(from_x), float(from_y)), PlanarPose(float(to_x), float(to_y), turn))
