"""What was as right as each recorded step of a task of the simulator, told by its scene, which is drawn again."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from baggie.data import Dataset
from baggie.geometry import FloatArray, PlanarPose, planar_pose
from baggie.seeds import COLLECTION, generator
from baggie.sim.objects import Block, distance_m
from baggie.tasks.conditions import InSlots, Score, State, counts, remaining
from baggie.tasks.task import Scene, Task
from baggie.types import PickPlace

_SAME_REWARD = 1e-3
"""Rewards are recorded as float32."""


@dataclass(frozen=True)
class SceneChoices:
    """What was as right as one recorded step."""

    blocks: Sequence[tuple[Block, PlanarPose]]
    """Those still to be moved in this condition, and where they are."""
    slots: Sequence[PlanarPose]
    """Those of the condition that are still free."""
    symmetry: int
    """How often a turn the condition's blocks look the same; 0 for at any angle."""

    def pick_counts(self, planned: PickPlace) -> bool:
        """Whether it picks one of the blocks, anywhere."""
        block, pose = self._nearest(planned.pick)
        return _away_m(block, pose, planned.pick) == 0.0

    def place_counts(self, planned: PickPlace) -> bool:
        """Whether the block that is picked, or the nearest one, comes to lie within 1 cm and 15 degrees of a slot.

        Held where it is picked and turned as planned; turned, too, by what looks the same.
        """
        _, pose = self._nearest(planned.pick)
        ends = planned.carry(pose).upright(0.0)
        return any(counts(ends, slot.upright(0.0), self.symmetry) for slot in self.slots)

    def _nearest(self, pick: PlanarPose) -> tuple[Block, PlanarPose]:
        return min(self.blocks, key=lambda each: _away_m(each[0], each[1], pick))


def choices_of_scene(dataset: Dataset, task: Task) -> dict[int, SceneChoices]:
    """By attempt id, of every step of a task of ours until which the recording says where things were."""
    found: dict[int, SceneChoices] = {}
    numbers, failures = dataset.numbers(), dataset.failures
    for episode in np.unique(dataset.episodes):
        rows = np.flatnonzero(dataset.episodes == episode)
        rows = rows[np.argsort(numbers["step"][rows])]
        # The scene was drawn from this stream: drawn again, it says where everything was.
        scene = task.draw(generator(COLLECTION, dataset.collection["seed"], int(episode)))
        done = [
            Done(PickPlace.from_array(numbers["executed"][row]), failures[row], float(numbers["reward"][row]))
            for row in rows
        ]
        found |= dict(zip(map(int, dataset.attempt_ids[rows]), replayed(scene, done), strict=False))
    return found


@dataclass(frozen=True)
class Done:
    """What is recorded of one step."""

    executed: PickPlace
    failure: str | None
    """What went wrong, if anything."""
    reward: float
    """What it earned."""


def replayed(scene: Scene, steps: Sequence[Done]) -> Iterator[SceneChoices]:
    """What was as right as each of these steps, from the scene's beginning; it ends where the steps no longer tell.

    What is picked goes where it is carried. Where that does not earn what was recorded, things went otherwise.
    """
    blocks = {block.name: block for block in scene.blocks}
    poses = {
        name: pose.upright(blocks[name].size_m[2] / 2 if name in blocks else 0.0)
        for name, pose in scene.poses.items()
    }
    score = Score(scene.conditions)
    for step in steps:
        left = remaining(scene.conditions, State.of(poses))
        # What is soft does not end as it is carried.
        if left is None or not blocks.keys() >= set(left.blocks):
            return
        yield SceneChoices(
            [(blocks[name], planar_pose(poses[name])) for name in left.blocks],
            [planar_pose(slot.T_base_slot(poses)) for slot in left.slots],
            left.condition.symmetry,
        )
        if step.failure != "missed-grasp":
            moved = _moved(scene, poses, step.executed) if step.failure is None else None
            if moved is None:
                return
            poses |= moved
        if not abs(score.count(State.of(poses)) - step.reward) < _SAME_REWARD:  # nor where nobody counted
            return


def _moved(
    scene: Scene, poses: Mapping[str, FloatArray], executed: PickPlace
) -> dict[str, FloatArray] | None:
    """What was carried, by name, and where it is now, `T_base_block` `(4, 4)`; None where nothing was under the cup."""
    under = [
        block
        for block in scene.blocks
        if _away_m(block, planar_pose(poses[block.name]), executed.pick) == 0.0
    ]
    if not under:
        return None
    block = max(under, key=lambda each: float(poses[each.name][2, 3]))
    ends = executed.carry(planar_pose(poses[block.name]))
    slots = [
        (slot.T_base_slot(poses), condition.symmetry)
        for condition in scene.conditions
        if isinstance(condition, InSlots) and block.name in condition.blocks
        for slot in condition.slots
    ]
    # In a slot it is as high as the slot is, elsewhere on the table.
    heights = [T[2, 3] for T, symmetry in slots if counts(ends.upright(0.0), T, symmetry)]
    return {block.name: ends.upright(max(heights, default=block.size_m[2] / 2))}


def _away_m(block: Block, pose: PlanarPose, point: PlanarPose) -> float:
    """Metres from a block at `pose`, seen from above, to a point; 0 upon it."""
    at = pose.inverse() @ point
    return float(distance_m(block, at.xy[None])[0])
