from itertools import combinations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from baggie.errors import BaggieError
from baggie.geometry import FloatArray, Grid, PlanarPose, transform_points
from baggie.registry import TASKS
from baggie.sim.cell import draw_cell
from baggie.sim.objects import Block, Fixture, distance_m, extent_m
from baggie.tasks.conditions import InSlots, Score, Slot, State, all_hold, carry
from baggie.tasks.demonstrator import next_action
from baggie.tasks.layout import REACH
from baggie.tasks.task import Setting, Task
from baggie.types import PickPlace
from helpers.ideal_arm import carried, poses_of
from helpers.same import expect_same

MARGIN_M = 0.05
tasks = st.sampled_from([task for task in TASKS.all().values() if task.blocks])
seeds = st.integers(0, 2**32)
pyramid = TASKS["block-pyramid"]


def footprint(thing: Block | Fixture, T: FloatArray) -> FloatArray:
    """`(4, 2)` corners on the table of the smallest box in the thing's frame that holds it."""
    low, high = extent_m(thing)
    corners = [[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]]
    return transform_points(T, np.c_[corners, np.zeros(4)])[:, :2]


@given(task=tasks, seed=seeds)
def test_a_scene_is_its_seeds(task: Task, seed: int) -> None:
    first, second = (task.draw(np.random.default_rng(seed)) for _ in range(2))
    assert first == second
    assert first.poses != task.draw(np.random.default_rng(seed + 1)).poses


@pytest.mark.parametrize("task", TASKS.all().values(), ids=TASKS.names())
def test_a_scene_is_of_cell_0_unless_another_is_given(task: Task) -> None:
    expect_same(
        task.draw(np.random.default_rng(3)),
        task.draw(np.random.default_rng(3), Setting(task.things, draw_cell(0), task.workspace)),
    )


@pytest.mark.parametrize("task", [task for task in TASKS.all().values() if not task.has_goal])
def test_no_cell_is_drawn_for_a_task_that_looks_at_none(task: Task, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = task.draw(np.random.default_rng(3))
    monkeypatch.setattr(Setting, "cell", property(lambda _: pytest.fail("looked at the cell")))
    assert task.draw(np.random.default_rng(3)) == scene


@given(task=tasks, seed=seeds)
def test_a_scene_is_without_collisions_in_view_and_in_reach(task: Task, seed: int) -> None:
    scene = task.draw(np.random.default_rng(seed))
    poses = poses_of(scene)
    outlines = [footprint(thing, poses[thing.name]) for thing in scene.things]
    for a, b in combinations(outlines, 2):
        area, _ = cv2.intersectConvexConvex((1000 * a).astype(np.float32), (1000 * b).astype(np.float32))
        assert area == 0.0
    grid = Grid()
    for low, high, axis in ((*grid.x, 0), (*grid.y, 1)):
        along = np.concatenate(outlines)[:, axis]
        assert low + MARGIN_M <= along.min()
        assert along.max() <= high - MARGIN_M
    ends = [slot.T_base_slot(poses) for stage in scene.conditions for slot in stage.slots]
    starts = [poses[block.name] for block in scene.blocks]
    assert all(REACH.contains(T[0, 3], T[1, 3]) for T in ends + starts)


@given(task=tasks, seed=seeds)
def test_a_scene_has_what_its_task_promises(task: Task, seed: int) -> None:
    scene = task.draw(np.random.default_rng(seed))
    assert sum(stage.weight for stage in scene.conditions) == pytest.approx(1.0)
    assert {thing.name for thing in scene.things} <= {thing.name for thing in task.things}
    assert set(scene.poses) == {thing.name for thing in scene.things}
    for stage in scene.conditions:
        assert len(stage.slots) >= len(stage.blocks) > 0
        assert set(stage.blocks) <= set(scene.poses)
    assert sum(len(stage.blocks) for stage in scene.conditions) <= task.max_steps


@settings(max_examples=30, deadline=None)  # draws a scene and plays it to its end
@given(task=tasks, seed=seeds)
def test_the_demonstrator_needs_one_step_a_block_and_turns_the_wrist_little(task: Task, seed: int) -> None:
    scene = task.draw(np.random.default_rng(seed))
    poses, score, steps, heights = poses_of(scene), Score(scene.conditions), 0, [0.0]
    while (action := next_action(scene.conditions, State.of(poses))) is not None:
        assert action.pick.yaw == 0.0
        assert abs(action.place.yaw) <= np.pi / task.object_symmetry + 1e-9
        before, poses = poses, carried(action, scene, poses)
        (moved,) = [name for name in poses if poses[name] is not before[name]]
        heights.append(poses[moved][2, 3])
        assert score.count(State.of(poses)) > 0.0
        steps += 1
    assert steps == sum(len(stage.blocks) for stage in scene.conditions)
    assert heights == sorted(heights)  # nothing goes where nothing is yet to rest on
    assert score.done
    assert score.total == 1.0
    assert all_hold(scene.conditions, State.of(poses))


def test_stages_count_by_their_weights() -> None:
    scene = pyramid.draw(np.random.default_rng(0))
    poses, score, rewards = poses_of(scene), Score(scene.conditions), []
    while (action := next_action(scene.conditions, State.of(poses))) is not None:
        poses = carried(action, scene, poses)
        rewards.append(score.count(State.of(poses)))
    np.testing.assert_allclose(rewards, [1 / 6] * 5 + [1 / 6])
    np.testing.assert_allclose([stage.weight for stage in scene.conditions], [1 / 2, 1 / 3, 1 / 6])


STAGE = InSlots(("a", "b"), (Slot(PlanarPose(0.4, 0.0, 0.3), 0.02), Slot(PlanarPose(0.4, 0.2), 0.02)), 1.0)
FAR = PlanarPose(0.6, -0.3).upright(0.02)
SLOT = PlanarPose(0.4, 0.0, 0.3)


def reward_at(T: FloatArray, symmetry: int = 4) -> float:
    stage = InSlots(STAGE.blocks, STAGE.slots, 1.0, symmetry)
    return Score([stage]).count(State.of({"a": T, "b": FAR}))


@given(
    turns=st.integers(-4, 4),
    symmetry=st.sampled_from([1, 2, 4]),
    off_deg=st.floats(-44.0, 44.0),
    off_m=st.floats(0.0, 0.02),
    towards=st.floats(-3.0, 3.0),
)
def test_a_block_counts_within_a_centimetre_and_fifteen_degrees_of_what_looks_the_same(
    turns: int, symmetry: int, off_deg: float, off_m: float, towards: float
) -> None:
    yaw = SLOT.yaw + turns * 2 * np.pi / symmetry + np.deg2rad(off_deg)
    at = PlanarPose(SLOT.x + off_m * np.cos(towards), SLOT.y + off_m * np.sin(towards), yaw)
    if min(abs(abs(off_deg) - 15.0), 1e3 * abs(off_m - 0.01)) < 1e-3:
        return  # on the edge
    inside = off_m < 0.01 and abs(off_deg) < 15.0
    assert reward_at(at.upright(0.02), symmetry) == (0.5 if inside else 0.0)
    assert reward_at(at.upright(0.02), symmetry=0) == (0.5 if off_m < 0.01 else 0.0)


def test_what_ravens_does_not_see_is_no_strict_success() -> None:
    good = {"a": SLOT.upright(0.02), "b": PlanarPose(0.4, 0.2).upright(0.02)}
    assert STAGE.filled(good) == {"a": 0, "b": 1}
    on_its_side = good["a"].copy()
    on_its_side[:3, :3] = on_its_side[:3, :3] @ [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    for wrong in (
        {"a": SLOT.upright(0.06)},  # it stands on something
        {"a": on_its_side},
        {"b": PlanarPose(SLOT.x + 0.005, SLOT.y, SLOT.yaw).upright(0.02)},  # two in one slot
    ):
        score = Score([STAGE])
        assert score.count(State.of(good | wrong)) == 1.0
        assert score.done
        assert not STAGE.holds(State.of(good | wrong))
    assert STAGE.holds(State.of(good))


def test_two_near_one_slot_are_shared_out_where_that_is_possible() -> None:
    near = (Slot(PlanarPose(0.4, 0.0), 0.02), Slot(PlanarPose(0.4, 0.012), 0.02))
    stage = InSlots(("a", "b"), near, 1.0)
    poses = {"a": PlanarPose(0.4, 0.006).upright(0.02), "b": PlanarPose(0.4, -0.004).upright(0.02)}
    assert stage.filled(poses) == {"a": 1, "b": 0}


def test_what_leaves_its_slot_is_taken_back_until_the_stage_is_full() -> None:
    score = Score([STAGE])
    at, beside = {"a": SLOT.upright(0.02), "b": FAR}, {"a": FAR, "b": FAR}
    assert score.count(State.of(at)) == 0.5
    assert score.count(State.of(at)) == 0.0
    assert score.count(State.of(beside)) == -0.5
    assert score.count(State.of({"a": SLOT.upright(0.02), "b": PlanarPose(0.4, 0.2).upright(0.02)})) == 1.0
    assert score.done
    assert score.count(State.of(beside)) == 0.0
    assert score.total == 1.0


def test_a_block_of_another_stage_earns_nothing_in_a_slot() -> None:
    scene = pyramid.draw(np.random.default_rng(1))
    poses = poses_of(scene)
    bottom, middle = (
        scene.conditions[0].slots[0].T_base_slot(poses),
        scene.conditions[1].slots[0].T_base_slot(poses),
    )
    assert Score(scene.conditions).count(State.of(poses | {"red": bottom})) == 0.0
    assert Score(scene.conditions).count(State.of(poses | {"purple": middle})) == 0.0
    assert Score(scene.conditions).count(State.of(poses | {"purple": bottom})) == pytest.approx(1 / 6)


def test_a_box_may_lie_either_way_round_in_the_corner() -> None:
    scene = TASKS["align-box-corner"].draw(np.random.default_rng(3))
    poses, (stage,) = poses_of(scene), scene.conditions
    (box,) = scene.blocks
    # One of its corners is as near to the marked one as the gap allows, its sides along the bars.
    for slot in stage.slots:
        for turn in (0.0, np.pi):
            T = slot.T_base_slot(poses) @ PlanarPose(0.0, 0.0, turn).upright(0.0)
            assert stage.filled(poses | {"box": T})
            in_corner = np.linalg.inv(poses["corner"]) @ np.c_[footprint(box, T), np.zeros(4), np.ones(4)].T
            np.testing.assert_allclose(in_corner[:2].min(axis=1), 0.002, atol=1e-9)
    quarter = stage.slots[0].T_base_slot(poses) @ PlanarPose(0.0, 0.0, np.pi / 2).upright(0.0)
    assert not stage.filled(poses | {"box": quarter})


def test_the_l_lies_in_its_outline_with_three_millimetres_of_play_one_way_round() -> None:
    scene = TASKS["block-insertion"].draw(np.random.default_rng(3))
    poses, (stage,) = poses_of(scene), scene.conditions
    (ell,), (outline,) = scene.blocks, scene.fixtures
    (slot,) = stage.slots
    T = slot.T_base_slot(poses)
    axes = np.meshgrid(*np.linspace(*(extent_m(outline) * 1.2), 281).T)
    grid = np.stack(axes, axis=-1)  # half a millimetre apart
    of_ell, of_outline = (
        distance_m(thing, grid.reshape(-1, 2)).reshape(281, 281) for thing in (ell, outline)
    )
    assert of_outline[of_ell == 0.0].min() == pytest.approx(0.003, abs=5e-4)
    _, parts = cv2.connectedComponents((of_outline > 0.0).astype(np.uint8), connectivity=4)
    assert len(set(parts[of_ell == 0.0])) == 1  # it lies in one room
    assert parts[0, 0] not in parts[of_ell == 0.0]  # which has no way out
    for turn, off, fits in ((0.0, 0.009, True), (0.25, 0.0, True), (0.0, 0.011, False), (0.27, 0.0, False)):
        ends = {"ell": T @ PlanarPose(off, 0.0, turn).upright(0.0)}
        assert bool(stage.filled(poses | ends)) is fits
    for quarter in (1, 2, 3):
        ends = {"ell": T @ PlanarPose(0.0, 0.0, quarter * np.pi / 2).upright(0.0)}
        assert not stage.filled(poses | ends)


def test_bowls_hold_a_block_at_any_yaw() -> None:
    action = carry(
        PlanarPose(0.5, 0.1, 2.0).upright(0.02), PlanarPose(0.4, -0.1, 1.0).upright(0.025), symmetry=0
    )
    assert action == PickPlace(PlanarPose(0.5, 0.1), PlanarPose(0.4, -0.1, 0.0))


def test_what_looks_alike_is_taken_from_left_to_right() -> None:
    for seed in range(20):
        scene = TASKS["place-red-in-green"].draw(np.random.default_rng(seed))
        (stage,) = scene.conditions
        for names in (stage.blocks, [slot.frame for slot in stage.slots]):
            along = [scene.poses[name].y for name in names if name]
            assert along == sorted(along, reverse=True)


def test_an_unknown_task_is_one_line() -> None:
    with pytest.raises(BaggieError, match=r"a task among bag-place, .*got 'tower'"):
        TASKS["tower"]
