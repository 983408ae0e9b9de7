"""A demonstrator in the style of others: picks anywhere on a thing, keeps to no order, wastes a step now and then.

The scripted demonstrator: what to do next, by the simulator's truth.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from baggie.geometry import FloatArray, PlanarPose, planar_pose, wrap_angle
from baggie.seeds import first_fit
from baggie.sim.objects import CUP_RADIUS_M, Block, Fixture, distance_m, extent_m, reach_m
from baggie.tasks.layout import find_room
from baggie.tasks.scoring import ANGLE_RAD, filled, yaw_of
from baggie.tasks.task import Scene, Slot, Stage, Tool
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


def next_action(
    stages: Sequence[Stage], poses: Mapping[str, FloatArray], tool: Tool = "cup"
) -> PickPlace | None:
    """The next pick and place, or None when every block is in its slot, strictly.

    Of the first stage that is not full it takes the first block that fills no slot, by its middle, a cup at yaw 0 and a
    hand along the block, to the lowest free slot, the first of equally low ones. A stage lists both in an order that a
    picture decides, so that what is demonstrated can be learned. Of the yaws that come to the same it chooses the one
    that turns the wrist least.
    `poses`: `T_base_body` `(4, 4)` of blocks and fixtures by name.
    """
    left = remaining(stages, poses)
    if left is None:
        return None
    T_base_block, symmetry = poses[left.blocks[0]], left.stage.symmetry
    action = carry(T_base_block, left.slots[0].T_base_slot(poses), symmetry)
    if tool == "cup" or symmetry == 0:
        return action
    along = wrap_angle(yaw_of(T_base_block), 2 * np.pi / symmetry)
    pick, place = action.pick, action.place
    return PickPlace(replace(pick, yaw=along), replace(place, yaw=wrap_angle(along + place.yaw)))


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


WASTED = 0.08
"""The share of steps that bring nothing nearer to its slot."""
STRAY_M = 0.0015
"""The arm and the block it last put down are within this of where they were sent."""
_RIM = CUP_RADIUS_M * np.stack(
    [f(np.linspace(0, 2 * np.pi, 64, endpoint=False)) for f in (np.cos, np.sin)], 1
)


def varied_action(
    scene: Scene, poses: Mapping[str, FloatArray], rng: np.random.Generator
) -> PickPlace | None:
    """The next pick and place, drawn from a stream; or None when every block is in its slot, strictly.

    Any block that the first stage that is not full still has to move, picked anywhere where the cup's lip lies wholly
    on it, goes to any of its free slots, by any of the turns that come to the same. Of `WASTED` of all steps, half take
    the block somewhere free on the table, and half go down beside everything. `poses`: `T_base_body` `(4, 4)` of blocks
    and fixtures by name.
    """
    left = remaining(scene.stages, poses)
    if left is None:
        return None
    name = left.blocks[int(rng.integers(len(left.blocks)))]
    slot = left.slots[int(rng.integers(len(left.slots)))]
    block = next(block for block in scene.blocks if block.name == name)
    at = pick_point(block, poses[name], rng)
    alike = int(rng.integers(max(left.stage.symmetry, 1)))
    right = carry(poses[name], slot.T_base_slot(poses), left.stage.symmetry, at, alike)
    if rng.random() >= WASTED:
        return right
    if rng.random() < 1 / 2:
        bare = _free(scene, poses, CUP_RADIUS_M, rng)
        return right if bare is None else replace(right, pick=replace(bare, yaw=0.0))
    aside = _free(scene, poses, reach_m(block), rng)
    return right if aside is None else carry(poses[name], aside.upright(0.0), 1, at)


def pick_point(block: Block, T_base_block: FloatArray, rng: np.random.Generator) -> FloatArray:
    """`(2,)` metres in a block's frame: uniformly from where the cup's lip lies wholly on its top.

    Its middle where that is nowhere, or where it lies on another side.
    """
    middle = np.zeros(2)
    if T_base_block[2, 2] < np.cos(ANGLE_RAD):
        return middle
    low, high = extent_m(block)
    point = first_fit(lambda: rng.uniform(low, high), lambda each: cup_rests(block, each, STRAY_M))
    return middle if point is None else point


def cup_rests(block: Block, at: FloatArray, margin_m: float = 0.0) -> bool:
    """Whether the cup's lip about `at` `(2,)` lies wholly on a block, `margin_m` inside its rim; metres, its frame."""
    return bool((distance_m(block, at + _RIM * (1 + margin_m / CUP_RADIUS_M)) < 1e-9).all())


def _free(
    scene: Scene, poses: Mapping[str, FloatArray], radius_m: float, rng: np.random.Generator
) -> PlanarPose | None:
    """Where the table is free for a disc; None where no try found that."""
    things: list[Block | Fixture] = [*scene.blocks, *scene.fixtures]
    taken = {thing.name: planar_pose(poses[thing.name]) for thing in things}
    return find_room(radius_m, taken, {thing.name: reach_m(thing) for thing in things}, rng)
