"""The scripted demonstrator: what to do next, by the simulator's truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from baggie.geometry import FloatArray, PlanarPose, wrap_angle
from baggie.sim.tasks.scoring import filled, yaw_of
from baggie.sim.tasks.task import Stage
from baggie.types import PickPlace


def next_action(stages: Sequence[Stage], poses: Mapping[str, FloatArray]) -> PickPlace | None:
    """The next pick and place, or None when every block is in its slot, strictly.

    Of the first stage that is not full it takes the first block that fills no slot, by its middle and at yaw 0, to the
    lowest free slot, the first of equally low ones. A stage lists both in an order that a picture decides, so that what
    is demonstrated can be learned. Of the yaws that come to the same it chooses the one that turns the wrist least.
    `poses`: `T_base_body` `(4, 4)` of blocks and fixtures by name.
    """
    for stage in stages:
        at = filled(stage, poses)
        waiting = [block for block in stage.blocks if block not in at]
        if not waiting:
            continue
        free = [slot for number, slot in enumerate(stage.slots) if number not in at.values()]
        slot = min(free, key=lambda each: each.height_m)
        return carry(poses[waiting[0]], slot.T_base_slot(poses), stage.symmetry)
    return None


def carry(T_base_block: FloatArray, T_base_slot: FloatArray, symmetry: int) -> PickPlace:
    """From where a block is to where it has to go, `(4, 4)` both; `symmetry` as in `Stage`."""
    turn = 0.0
    if symmetry:
        turn = wrap_angle(yaw_of(T_base_slot) - yaw_of(T_base_block), 2 * np.pi / symmetry)
    (from_x, from_y), (to_x, to_y) = T_base_block[:2, 3].tolist(), T_base_slot[:2, 3].tolist()
    return PickPlace(PlanarPose(from_x, from_y), PlanarPose(to_x, to_y, turn))
