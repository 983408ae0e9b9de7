"""What every task promises, as a function: call it with a task of your own. It is played in the simulator, too."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

import numpy as np

from baggie.collect.recording import Recording
from baggie.collect.scripted import demonstrate, size_of
from baggie.data import DatasetWriter, open_dataset
from baggie.geometry import PlanarPose
from baggie.tasks.conditions import InSlots
from baggie.tasks.task import Scene, Task
from baggie.types import Attempt, Outcome, PickPlace
from baggie.workcell.simulated import SimulatedWorkcell

_NOWHERE = np.full((4, 2), np.nan)
_TABLE_X_M, _TABLE_Y_M = (0.0, 1.0), (-0.7, 0.7)
"""Where things lie on the table, robot base frame."""


def check_task(task: Task, folder: Path, seeds: Sequence[int] = (0, 1, 2)) -> None:
    """Raise `AssertionError` where a task breaks its contract.

    Draws scenes, opens the simulated workcell with the task, carries out what a demonstrator would do, or, where the
    goal is given in the picture, one pick and place, records it in `folder`, which must be empty, and reads it back.
    """
    assert task.name == task.name.lower().replace(" ", "-"), f"names are words with dashes, got {task.name!r}"
    assert task.instruction, "a task is said in words"
    assert task.max_steps >= 1, f"an episode has a step, got {task.max_steps}"
    assert task.object_symmetry >= 0, f"a symmetry is 0 or more, got {task.object_symmetry}"
    names = [thing.name for thing in task.things]
    assert len(set(names)) == len(names), f"everything has a name of its own, got {names}"
    scenes = [task.draw(np.random.default_rng(seed)) for seed in seeds]
    for seed, scene in zip(seeds, scenes, strict=True):
        again = task.draw(np.random.default_rng(seed))
        same = (again.things, again.poses, again.conditions) == (scene.things, scene.poses, scene.conditions)
        assert same, "the same stream gives the same scene"
        _check_scene(task, scene)
    assert any(scene.poses != scenes[0].poses for scene in scenes[1:]), "another stream gives another scene"
    with closing(SimulatedWorkcell(0, task)) as cell:
        _check_played(cell, folder)


def _check_scene(task: Task, scene: Scene) -> None:
    names = {thing.name for thing in scene.things}
    assert set(scene.poses) == names, f"what plays a part has a pose, got {set(scene.poses)} for {names}"
    for name, pose in scene.poses.items():
        inside = _TABLE_X_M[0] < pose.x < _TABLE_X_M[1] and _TABLE_Y_M[0] < pose.y < _TABLE_Y_M[1]
        assert inside, f"{name} lies on the table, got {pose}"
    if task.has_goal:
        return
    assert scene.conditions, "something counts: a condition, or a goal in the picture"
    total = sum(condition.weight for condition in scene.conditions)
    assert np.isclose(total, 1.0), f"the weights of all conditions add up to 1, got {total}"
    movable = {thing.name for thing in scene.things if thing.movable}
    in_slots = [condition for condition in scene.conditions if isinstance(condition, InSlots)]
    for condition in in_slots:
        assert set(condition.blocks) <= movable, f"what has to be carried can be, got {condition.blocks}"
        assert len(condition.slots) >= len(condition.blocks) > 0, "each thing has a slot"
        frames = {slot.frame for slot in condition.slots} - {None}
        assert frames <= names, f"slots are in frames of things that are there, got {frames}"
    needed = sum(len(condition.blocks) for condition in in_slots)
    assert needed <= task.max_steps, f"{needed} things are carried within max_steps, {task.max_steps}"


def _check_played(cell: SimulatedWorkcell, folder: Path) -> None:
    cell.reset((7, 0))
    picture = cell.look().color
    cell.reset((7, 0))
    assert np.array_equal(cell.look().color, picture), "the same seed gives the same picture"
    shown = [_moved(cell)] if cell.task.has_goal else demonstrate(cell, cell.task, _recording(cell.task), 0)
    assert shown, "there is something to do at first"
    width, height = shown[0].before.size
    with DatasetWriter(
        folder,
        task=cell.task.instruction,
        robot_type="simulated",
        picture_size=(width, height),
        collection={},
    ) as writer:
        for attempt in shown:
            writer.append(attempt)
    kept = list(open_dataset(folder))
    assert len(kept) == len(shown), f"what was recorded is read back, got {len(kept)} of {len(shown)}"
    for recorded, attempt in zip(kept, shown, strict=True):
        assert recorded.task == cell.task.instruction
        assert np.array_equal(recorded.before.color, attempt.before.color), "pictures are kept exactly"
        assert np.array_equal(recorded.commanded.to_array(), attempt.commanded.to_array())
    if not cell.task.has_goal:
        earned = sum(attempt.reward or 0.0 for attempt in shown)
        assert earned > 0.0, f"what its demonstrator does counts, got {earned} of 1"


def _recording(task: Task) -> Recording:
    return Recording(task.instruction, seed=0, cell=0, size=size_of(task))


def _moved(cell: SimulatedWorkcell) -> Attempt:
    """One pick and place of what is carried, a hand's width aside, as an attempt."""
    before, lies = cell.look(), cell.truth()
    area = cell.settings.workspace
    y = lies.y + (-0.2 if lies.y > (area.y_min + area.y_max) / 2 else 0.2)
    action = PickPlace(PlanarPose(*area.nearest(lies.x, lies.y)), PlanarPose(*area.nearest(lies.x, y)))
    outcome: Outcome = cell.execute(action)
    assert outcome.failure is None, f"what lies there can be carried, got {outcome.failure}"
    return Attempt(
        attempt_id=0,
        task=cell.task.instruction,
        before=before,
        after=cell.look(),
        commanded=action,
        outcome=outcome,
        box_before=_NOWHERE,
        box_after=_NOWHERE,
        cell=0,
        seed=0,
        time=0.0,
        object_symmetry=cell.settings.object_symmetry,
    )
