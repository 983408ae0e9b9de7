"""The scripted demonstrator: what to do next, by who knows where everything is.

In the style of others it picks anywhere on a thing, keeps to no order, and wastes a step now and then.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from baggie.geometry import FloatArray, PlanarPose
from baggie.seeds import first_fit
from baggie.sim.objects import CUP_RADIUS_M, Block, Fixture, distance_m, extent_m, reach_m
from baggie.tasks.conditions import ANGLE_RAD, Condition, State, Tool, carry, remaining
from baggie.tasks.layout import find_room
from baggie.tasks.task import Scene
from baggie.types import PickPlace


def next_action(conditions: Sequence[Condition], state: State, tool: Tool = "cup") -> PickPlace | None:
    """The next pick and place, or None when every condition holds, strictly.

    What the first condition that does not hold says.
    """
    left = next((condition for condition in conditions if not condition.holds(state)), None)
    return None if left is None else left.next_action(state, tool)


WASTED = 0.08
"""The share of steps that bring nothing nearer to its slot."""
STRAY_M = 0.0015
"""The arm and the block it last put down are within this of where they were sent."""
_RIM = CUP_RADIUS_M * np.stack(
    [f(np.linspace(0, 2 * np.pi, 64, endpoint=False)) for f in (np.cos, np.sin)], 1
)


def varied_action(scene: Scene, state: State, rng: np.random.Generator) -> PickPlace | None:
    """The next pick and place, drawn from a stream; or None when every block is in its slot, strictly.

    Any block that the first condition that does not hold still has to move, picked anywhere where the cup's lip lies
    wholly on it, goes to any of its free slots, by any of the turns that come to the same. Of `WASTED` of all steps,
    half take the block somewhere free on the table, and half go down beside everything. A condition without slots is
    made so as it says itself.
    """
    poses = state.poses
    left = remaining(scene.conditions, state)
    if left is None:
        return next_action(scene.conditions, state)
    name = left.blocks[int(rng.integers(len(left.blocks)))]
    slot = left.slots[int(rng.integers(len(left.slots)))]
    block = next(block for block in scene.blocks if block.name == name)
    at = pick_point(block, poses[name], rng)
    alike = int(rng.integers(max(left.condition.symmetry, 1)))
    right = carry(poses[name], slot.T_base_slot(poses), left.condition.symmetry, at, alike)
    if rng.random() >= WASTED:
        return right
    if rng.random() < 1 / 2:
        bare = _free(scene, state, CUP_RADIUS_M, rng)
        return right if bare is None else replace(right, pick=replace(bare, yaw=0.0))
    aside = _free(scene, state, reach_m(block), rng)
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


def _free(scene: Scene, state: State, radius_m: float, rng: np.random.Generator) -> PlanarPose | None:
    """Where the table is free for a disc; None where no try found that."""
    things: list[Block | Fixture] = [*scene.blocks, *scene.fixtures]
    taken = {thing.name: state.places[thing.name] for thing in things}
    return find_room(radius_m, taken, {thing.name: reach_m(thing) for thing in things}, rng)
