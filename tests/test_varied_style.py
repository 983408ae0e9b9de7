"""Demonstrations in the style of others: anywhere on a thing, in any order, with a step wasted now and then."""

from collections import Counter
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from baggie.geometry import PlanarPose, planar_pose, wrap_angle
from baggie.registry import TASKS
from baggie.seeds import STYLE, generator
from baggie.sim.objects import CUP_RADIUS_M, Block, distance_m, extent_m, reach_m
from baggie.tasks import demonstrator as module
from baggie.tasks.conditions import Score, State, all_hold, remaining
from baggie.tasks.demonstrator import (
    STRAY_M,
    WASTED,
    cup_rests,
    next_action,
    pick_point,
    varied_action,
)
from baggie.tasks.layout import REACH
from baggie.tasks.task import Task
from helpers.ideal_arm import away, carried, poses_of

BLOCK_TASKS = [task for task in TASKS.all().values() if task.blocks]
tasks = st.sampled_from(BLOCK_TASKS)
seeds = st.integers(0, 2**32)
DISC = np.concatenate(
    [
        radius * np.stack([np.cos(around), np.sin(around)], axis=1)
        for radius in np.linspace(0.0, CUP_RADIUS_M, 6)
        for around in [np.linspace(0, 2 * np.pi, 40, endpoint=False)]
    ]
)
"""`(N, 2)`: all over the cup's mouth, metres."""


def rightly(scene, poses, rng):
    """What is shown where no step is wasted."""
    with patch.object(module, "WASTED", 0.0):
        return varied_action(scene, State.of(poses), rng)


@settings(max_examples=40, deadline=None)
@given(task=tasks, seed=seeds)
def test_the_cup_lies_wholly_on_what_is_picked_and_the_thing_ends_in_its_slot(task: Task, seed: int) -> None:
    """Wherever it was picked, whatever looks the same: the thing lies as if it had been held by its middle."""
    rng = np.random.default_rng(seed)
    scene = task.draw(rng)
    poses, score = poses_of(scene), Score(scene.conditions)
    while (left := remaining(scene.conditions, State.of(poses))) is not None:
        action = rightly(scene, poses, rng)
        assert action.pick.yaw == 0.0
        assert REACH.contains(action.place.x, action.place.y)
        before, poses = poses, carried(action, scene, poses)
        (name,) = [each for each in poses if poses[each] is not before[each]]
        assert name in left.blocks
        block = next(block for block in scene.blocks if block.name == name)
        assert (away(block, before, action.pick.xy + DISC) < 1e-9).all()
        ends, slots = planar_pose(poses[name]), [planar_pose(slot.T_base_slot(poses)) for slot in left.slots]
        slot = min(slots, key=ends.distance)
        assert ends.distance(slot) < 1e-9
        if left.condition.symmetry:
            turn = 2 * np.pi / left.condition.symmetry
            assert wrap_angle(ends.yaw - slot.yaw, turn) == pytest.approx(0.0, abs=1e-9)
        assert score.count(State.of(poses)) > 0.0
    assert score.done
    assert all_hold(scene.conditions, State.of(poses))


@pytest.mark.parametrize("task", BLOCK_TASKS, ids=lambda task: task.name)
def test_picks_reach_as_near_to_the_rim_as_the_cup_allows(task: Task) -> None:
    rng = np.random.default_rng(0)
    scene = task.draw(rng)
    name = scene.conditions[0].blocks[0]
    block = next(block for block in scene.blocks if block.name == name)
    points = np.array([pick_point(block, poses_of(scene)[name], rng) for _ in range(200)])
    rim = extent_m(block) - np.array([[-1], [1]]) * (CUP_RADIUS_M + STRAY_M)
    np.testing.assert_allclose([points.min(axis=0), points.max(axis=0)], rim, atol=0.0025)
    off = np.linalg.norm(points, axis=1)
    assert np.median(off) > 0.004  # and in between, not at the middle


def test_on_what_is_narrower_than_the_cup_or_lies_on_its_side_it_is_set_in_the_middle() -> None:
    rng = np.random.default_rng(0)
    upright = PlanarPose(0.5, 0.0, 0.3).upright(0.02)
    assert pick_point(Block("rod", (0.1, 0.015, 0.02)), upright, rng).tolist() == [0.0, 0.0]
    fallen = upright.copy()
    fallen[:3, :3] = upright[:3, :3] @ [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    assert pick_point(Block("box", (0.1, 0.06, 0.02)), fallen, rng).tolist() == [0.0, 0.0]


@given(st.floats(-0.05, 0.12), st.floats(-0.05, 0.12))
def test_the_cup_rests_where_all_of_its_mouth_is_on_the_thing(x: float, y: float) -> None:
    (ell,) = TASKS["block-insertion"].blocks
    at = np.array([x, y])
    beside = distance_m(ell, at + DISC).max()
    if cup_rests(ell, at):
        assert beside < 5e-4  # between the points of either, nothing is known more exactly
    if beside == 0.0:
        assert cup_rests(ell, at, -5e-4)


def test_any_block_of_a_stage_goes_to_any_of_its_slots_by_any_turn_that_looks_the_same() -> None:
    scene = TASKS["block-pyramid"].draw(np.random.default_rng(0))
    poses, seen = poses_of(scene), Counter()
    for seed in range(300):
        action = rightly(scene, poses, np.random.default_rng(seed))
        after = carried(action, scene, poses)
        (name,) = [each for each in after if after[each] is not poses[each]]
        slots = [planar_pose(slot.T_base_slot(poses)) for slot in scene.conditions[0].slots]
        slot = min(range(3), key=lambda each: slots[each].distance(planar_pose(after[name])))
        least = next(
            turn
            for turn in (action.place.yaw + k * np.pi / 2 for k in range(-3, 4))
            if abs(turn) <= np.pi / 4
        )
        seen[name, slot, round((action.place.yaw - least) / (np.pi / 2)) % 4] += 1
    assert len(seen) == 3 * 3 * 4
    assert max(seen.values()) < 5 * 300 / len(seen)


def test_a_step_is_wasted_now_and_then_on_the_bare_table_or_by_putting_a_thing_aside() -> None:
    scene = TASKS["place-red-in-green"].draw(np.random.default_rng(1))
    poses, kinds = poses_of(scene), Counter()
    things = (*scene.blocks, *scene.fixtures)
    for seed in range(1500):
        action = varied_action(scene, State.of(poses), generator(STYLE, 0, seed, 0))
        score = Score(scene.conditions)
        after = carried(action, scene, poses)
        moved = [name for name in after if after[name] is not poses[name]]
        if score.count(State.of(after)) > 0.0:
            kinds["right"] += 1
        elif moved:
            kinds["aside"] += 1
            ends = planar_pose(after[moved[0]])
            others = [thing for thing in things if thing.name != moved[0]]
            assert min(
                ends.distance(planar_pose(poses[thing.name])) - reach_m(thing) for thing in others
            ) > reach_m(next(block for block in scene.blocks if block.name == moved[0]))
            assert remaining(scene.conditions, State.of(after)) is not None
        else:
            kinds["bare"] += 1
            assert min(distance_to(thing, poses, action.pick) for thing in things) > CUP_RADIUS_M
    assert kinds["aside"] + kinds["bare"] == pytest.approx(1500 * WASTED, rel=0.3)
    assert kinds["aside"] > 1500 * WASTED / 4
    assert kinds["bare"] > 1500 * WASTED / 4


def distance_to(thing, poses, point: PlanarPose) -> float:
    at = planar_pose(poses[thing.name]).inverse() @ point
    return float(distance_m(thing, at.xy[None])[0])


@settings(max_examples=25, deadline=None)
@given(task=tasks, seed=seeds)
def test_whatever_is_wasted_whoever_shows_it_goes_on_to_the_end(task: Task, seed: int) -> None:
    scene = task.draw(np.random.default_rng(seed))
    poses = poses_of(scene)
    with patch.object(module, "WASTED", 0.5):
        for step in range(100):
            action = varied_action(scene, State.of(poses), generator(STYLE, seed, 0, step))
            if action is None:
                break
            poses = carried(action, scene, poses)
    assert all_hold(scene.conditions, State.of(poses))
    assert next_action(scene.conditions, State.of(poses)) is None
