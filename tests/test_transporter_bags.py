"""`transporter` on one camera's own pictures of bags: what it learns from, how it plans, when it cannot."""

import math
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from baggie.calibration.files import MAP_FILE
from baggie.calibration.image_to_robot.rectify import Rectifier
from baggie.data.files import CALIBRATION_FOLDER
from baggie.errors import BaggieError
from baggie.geometry import PlanarPose, wrap_angle
from baggie.learning import TransporterTraining, train
from baggie.learning.demonstrations import (
    read_demonstrations,
    rectified,
    rectifier_for,
    with_seen_symmetry,
    with_turns,
)
from baggie.learning.moved_maps import MovedMaps, Moves, rigid_move
from baggie.learning.split import RULE, Split
from baggie.learning.transporter import TransporterOptions, TransporterRecipe
from baggie.policies import TransporterPolicy, load_policy
from baggie.policies.base import check_policy
from baggie.policies.transporter.scores import Scores
from baggie.types import LAYER_M, Attempt, Goal, PickPlace
from helpers.synthetic import box_corners, carried, image_to_robot, make_stacking

SIZE = (640, 360)
QUARTER = math.pi / 2


@pytest.fixture(autouse=True)
def _one_thread():
    torch.set_num_threads(1)


def bag_attempt(number: int, before: PlanarPose | None = None, after: PlanarPose | None = None) -> Attempt:
    """In the middle of the table; the bag is put down square to it, as a collector does."""
    rng = np.random.default_rng([7, number])
    angle, distance = rng.uniform(-math.pi, math.pi), rng.uniform(0.09, 0.11)
    away = distance * np.array([math.cos(angle), math.sin(angle)])
    x, y = np.array([0.5, 0.0]) + rng.uniform(-0.02, 0.02, 2)
    before = before or PlanarPose(x + away[0], y + away[1], rng.uniform(-math.pi / 4, math.pi / 4))
    after = after or PlanarPose(x - away[0], y - away[1], 0.0)
    return carried(number, rng, before, after, SIZE, depth=False)


ATTEMPTS = [bag_attempt(number) for number in range(12)]


@pytest.fixture(scope="module")
def recording(tmp_path_factory) -> Path:
    """A folder with the map that a collector would have put there, of the camera's full pictures."""
    folder = tmp_path_factory.mktemp("recording")
    image_to_robot().save(folder / CALIBRATION_FOLDER / MAP_FILE)
    return folder


@pytest.fixture(scope="module")
def rectifier(recording):
    return rectifier_for(ATTEMPTS, recording)


def options(data: Path, out: Path, **changes) -> TransporterTraining:
    given = {"train": 8, "val": 2, "steps": 2, "device": "cpu", "save_every_s": 1e3}
    return TransporterTraining(data=data, out=out, **(given | changes))


def truth(attempt: Attempt) -> np.ndarray:
    """`(2, 2)` metres: where the bag was and where it ended."""
    assert attempt.truth is not None
    return np.array([attempt.truth.before.xy, attempt.truth.after.xy])


# --- what it learns from


def test_the_grid_holds_all_boxes_turned_as_they_may_be(rectifier):
    for attempt in ATTEMPTS:
        for box in (attempt.box_before, attempt.box_after):
            there = rectifier.to_grid(box)
            reach = np.linalg.norm(there - there.mean(axis=0), axis=1).max()
            assert (there.mean(axis=0) - reach >= 0).all()
            assert (there.mean(axis=0) + reach <= np.array(rectifier.grid.shape[::-1]) - 1).all()


def test_rectified_the_bag_and_its_goal_are_where_the_robot_has_them(rectifier):
    for attempt in ATTEMPTS:
        seen = rectified(attempt, rectifier)
        boxes = np.stack([seen.box_before, seen.box_after])
        assert boxes.mean(axis=1) == pytest.approx(rectifier.grid.to_pixels(truth(attempt)), abs=0.2)
        assert red_middle(seen.before.color) == pytest.approx(boxes[0].mean(axis=0), abs=1.5)


@settings(deadline=None, max_examples=20)
@given(st.floats(-math.pi, math.pi), st.floats(-20, 20), st.floats(-20, 20), st.integers(0, 11))
def test_moved_scenes_carry_the_yaw_of_pick_and_place_along(rectifier, turn, right, down, number):
    """The bag's sides and the goal's, found in the moved map itself, are as the labels say."""
    attempt = ATTEMPTS[number]
    exact = replace(attempt, commanded=attempt.outcome.executed)
    shown = read_demonstrations([rectified(exact, rectifier)], 4)
    rows, columns = rectifier.grid.shape
    moved = MovedMaps(shown, Moves()).moved(0, rigid_move(turn, np.array([right, down]), (columns, rows)))
    for color, yaw, place in zip((RED, GREEN), moved.yaws, moved.places, strict=True):
        found, middle = sides(moved.color, color)
        if not ((middle > 30) & (middle < [columns - 30, rows - 30])).all():
            return  # cut off by the map's edge
        assert abs(math.degrees(wrap_angle(found - yaw, QUARTER))) < 8  # a grasp is some degrees off
        assert middle == pytest.approx(place, abs=3)


def test_turned_on_the_spot_bags_and_goals_take_their_labels_along(rectifier):
    seen = [rectified(replace(a, commanded=a.outcome.executed), rectifier) for a in ATTEMPTS]
    both = with_turns(seen, np.random.default_rng(0))
    assert both[: len(seen)] == seen
    goal_turns, bag_turns = [], []
    for before, after in zip(seen, both[len(seen) :], strict=True):
        shown = read_demonstrations([after], 4)
        for color, pose in ((RED, after.commanded.pick), (GREEN, after.commanded.place)):
            found, middle = sides(shown.colors[0], color)
            assert abs(math.degrees(wrap_angle(found - pose.yaw, QUARTER))) < 8
            assert middle == pytest.approx(rectifier.grid.to_pixels(pose.xy)[0], abs=3)
        bag_turns.append(wrap_angle(after.commanded.pick.yaw - before.commanded.pick.yaw, QUARTER))
        goal_turns.append(wrap_angle(after.commanded.place.yaw - before.commanded.place.yaw, QUARTER))
    assert np.std(goal_turns) > 0.2
    assert 0 < np.count_nonzero(np.abs(bag_turns) > 0.05) < len(seen)


def test_most_boxes_say_how_often_a_turn_a_bag_looks_the_same(rectifier):
    square = [rectified(attempt, rectifier) for attempt in ATTEMPTS]
    flat = np.array([[0.0, 0.0], [20.0, 0.0], [20.0, 10.0], [0.0, 10.0]])
    long = [replace(each, box_before=flat) for each in square]
    for attempts, symmetry in ((square, 4), (long, 2), ([*square, *long[:3]], 4)):  # squeezed now and then
        assert {each.object_symmetry for each in with_seen_symmetry(attempts)} == {symmetry}
    told = [replace(square[0], object_symmetry=0), *long]
    assert [each.object_symmetry for each in with_seen_symmetry(told)] == [0] + [2] * len(long)


# --- what comes of it


@pytest.fixture(scope="module")
def run(recording, tmp_path_factory) -> Path:
    torch.set_num_threads(1)
    out = tmp_path_factory.mktemp("run")
    train(options(recording, out), ATTEMPTS)
    return out


def test_it_trains_on_a_camera_s_pictures_and_keeps_the_contract(run):
    policy = load_policy(run)
    assert isinstance(policy, TransporterPolicy)
    attempt = ATTEMPTS[-1]
    check_policy(policy, attempt.before, Goal(attempt.box_after))
    assert policy.picture_size == SIZE
    config = policy.network.config
    assert (config.pick_yaw, config.symmetry) == (True, 4)
    plan = policy.plan(attempt.before, Goal(attempt.box_after))
    assert policy.grid.contains([plan.action.pick.xy, plan.action.place.xy]).all()


def test_it_learns_from_and_is_measured_on_the_attempts_that_keypoint_is(run):
    split, keypoint = load_policy(run).training["split"], Split.of(ATTEMPTS, 8, 2)
    assert split["train"] == [attempt.attempt_id for attempt in keypoint.train]
    assert split["val"] == [attempt.attempt_id for attempt in keypoint.val]
    assert split["rule"] == RULE


def test_views_are_hot_over_the_picture_where_it_picks(run):
    policy, attempt = load_policy(run), ATTEMPTS[-1]
    plan = policy.plan(attempt.before, Goal(attempt.box_after))
    view = plan.views["pick"]
    assert view.max() == 1
    v, u = np.unravel_index(view.argmax(), view.shape)
    scale = SIZE[0] / view.shape[1]
    pick = policy.rectifier.from_grid(policy.grid.to_pixels(plan.action.pick.xy))[0]
    assert (np.array([u, v]) + 0.5) * scale - 0.5 == pytest.approx(pick, abs=4 * scale)


def test_saved_policies_plan_the_same(run, tmp_path):
    policy, attempt = load_policy(run), ATTEMPTS[-1]
    policy.save_pretrained(tmp_path)
    again = load_policy(tmp_path)
    assert again.config() == policy.config()
    one, other = (each.plan(attempt.before, Goal(attempt.box_after)) for each in (policy, again))
    assert np.array_equal(one.action.to_array(), other.action.to_array())
    assert all(np.array_equal(one.views[name], other.views[name]) for name in one.views)


@given(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3))
@settings(deadline=None, max_examples=5)
def test_the_same_picture_in_another_robot_s_frame_is_the_same_plan_there(run, x, y):
    policy, attempt = load_policy(run), ATTEMPTS[-1]
    here, grid = policy.rectifier, policy.grid
    there = replace(grid, x=(grid.x[0] + x, grid.x[1] + x), y=(grid.y[0] + y, grid.y[1] + y))
    plane = here.plane @ PlanarPose(x, y).inverse().matrix()
    moved = TransporterPolicy(
        policy.network, there, policy.cell, policy.goal_input, Rectifier(here.lens, plane, there)
    )
    one, other = (each.plan(attempt.before, Goal(attempt.box_after)).action for each in (policy, moved))
    assert (other.to_array() - one.to_array()).tolist() == pytest.approx([x, y, 0, x, y, 0], abs=1e-3)


def test_finer_pictures_of_the_same_camera_give_nearly_the_same_plan(run):
    policy, attempt = load_policy(run), ATTEMPTS[-1]
    goal = Goal(attempt.box_after)
    finer = replace(attempt.before, color=attempt.before.color.repeat(2, 0).repeat(2, 1), intrinsics=None)
    one, other = policy.plan(attempt.before, goal), policy.plan(finer, goal.scaled(2, 2))
    assert other.action.to_array() == pytest.approx(one.action.to_array(), abs=1e-5)


def test_what_it_cannot_do_is_one_clear_line(run, recording, tmp_path):
    policy, attempt = load_policy(run), ATTEMPTS[-1]
    goal = Goal(attempt.box_after)
    corner = Goal(np.array([[5.0, 5], [25, 5], [25, 25], [5, 25]]))
    square = replace(attempt.before, color=attempt.before.color[:, :360], intrinsics=None)
    for make, message in (
        (lambda: policy.plan(attempt.before), "expected a goal"),
        (lambda: policy.plan(attempt.before, corner), "goal on the part of the table"),
        (lambda: policy.plan(square, Goal(np.clip(goal.corners, 0, 300))), "belongs to another camera"),
        (lambda: train(options(tmp_path, tmp_path / "run"), ATTEMPTS), "map from the picture to the robot"),
    ):
        with pytest.raises(BaggieError, match=message) as error:
            make()
        assert "\n" not in str(error.value)


@pytest.fixture(scope="module")
def taught(recording, tmp_path_factory) -> TransporterPolicy:
    torch.set_num_threads(1)
    out = tmp_path_factory.mktemp("taught")

    def recipe(attempts):
        to = rectifier_for(attempts, recording)
        seen = with_turns([rectified(attempt, to) for attempt in attempts], np.random.default_rng(0))
        return TransporterRecipe(read_demonstrations(seen, 4), TransporterOptions(batch=2), to)

    shown = [bag_attempt(number) for number in range(40)]
    train(options(recording, out, train=40, val=0, steps=200), shown, recipe)
    return load_policy(out)


def planned(policy: TransporterPolicy, before: PlanarPose, after: PlanarPose) -> PickPlace:
    seen = carried(0, np.random.default_rng(3), before, after, SIZE, depth=False)
    return policy.plan(seen.before, Goal(box_corners(after, SIZE))).action


@pytest.mark.slow
def test_plans_move_with_the_scene_in_robot_coordinates(taught):
    """Shifted and turned on the table: in the picture, that is another perspective of the bag and of the goal."""
    bag, goal, middle = PlanarPose(0.43, -0.03, 0.2), PlanarPose(0.55, 0.06, 0.0), PlanarPose(0.5, 0.0)
    moves = [(0, 0, 0), (0.03, 0, 0), (-0.02, 0.03, 0), (0, 0, 1.0), (0.01, 0, -2.2)]
    for move in (PlanarPose(*move) for move in moves):
        moved = middle @ move @ middle.inverse()
        action = planned(taught, moved @ bag, moved @ goal)
        assert 1000 * action.pick.distance(moved @ bag) < 15
        assert 1000 * action.place.distance(moved @ goal) < 20  # a few steps taught it


RED, GREEN = 0, 1


def red_middle(color):
    return sides(color, RED)[1]


def sides(color, channel):
    """The direction of the sides of what is of a colour, modulo a quarter turn, and its middle `(2,)` (u, v)."""
    others = np.delete(color.astype(int), channel, axis=2).max(axis=2)
    mask = (color[..., channel] > others + 60).astype(np.uint8)
    points = cv2.findNonZero(mask)
    (u, v), _, degrees = cv2.minAreaRect(points)
    return math.radians(degrees), np.array([u, v])


# --- stacks

STACKED = make_stacking(12, 0, SIZE)


@pytest.fixture(scope="module")
def stacked_run(recording, tmp_path_factory) -> Path:
    torch.set_num_threads(1)
    out = tmp_path_factory.mktemp("stacked")
    train(options(recording, out), STACKED)
    return out


def test_what_is_learned_from_stacks_is_where_each_bag_appears(recording):
    assert any(attempt.pick_layer for attempt in STACKED)
    to = rectifier_for(STACKED, recording)
    for attempt in STACKED:
        seen = rectified(attempt, to)
        for box, pose, true in (
            (seen.box_before, seen.commanded.pick, attempt.truth.before),
            (seen.box_after, seen.commanded.place, attempt.truth.after),
        ):
            assert to.grid.contains([pose.xy]).all()
            scatter = pose.distance(true)  # of labels, and by how much it leans
            assert np.linalg.norm(to.grid.to_robot(box.mean(axis=0)) - pose.xy) < 0.01, scatter
    flat = [replace(attempt, pick_layer=0, place_layer=0) for attempt in STACKED]
    assert rectifier_for(flat, recording).leaning is None


def test_a_bag_in_a_stack_is_not_turned_on_the_spot_and_its_goal_is(recording):
    to = rectifier_for(STACKED, recording)
    seen = [rectified(attempt, to) for attempt in STACKED]
    for before, after in zip(seen, with_turns(seen, np.random.default_rng(0))[len(seen) :], strict=True):
        assert not np.array_equal(before.box_after, after.box_after)
        if before.pick_layer:
            assert np.array_equal(before.before.color, after.before.color)
            assert before.commanded.pick == after.commanded.pick


@pytest.mark.parametrize("layers", [(0, 0), (0, 2), (1, 3)])
def test_a_layer_moves_what_is_planned_to_where_the_robot_has_it(stacked_run, layers):
    policy, attempt = load_policy(stacked_run), STACKED[-1]
    assert policy.knows_layers
    assert policy.wants_goal
    goal = Goal(attempt.box_after, object_at=tuple(attempt.box_before.mean(axis=0)))
    flat = policy.plan(attempt.before, goal).action
    below, under = layers
    action = policy.plan(attempt.before, replace(goal, object_layer=below, layer=under)).action
    leaning = policy.rectifier.leaning
    assert leaning.seen(action.pick, below).xy == pytest.approx(flat.pick.xy, abs=1e-9)
    assert leaning.seen(action.place, under).xy == pytest.approx(flat.place.xy, abs=1e-9)
    assert (action.pick.yaw, action.place.yaw) == (flat.pick.yaw, flat.place.yaw)
    assert (action.pick_on_m, action.place_on_m) == (below * LAYER_M, under * LAYER_M)


def test_of_several_bags_the_one_that_is_pointed_at_is_picked(stacked_run):
    policy, attempt = load_policy(stacked_run), STACKED[-1]
    whole = policy.plan(attempt.before, Goal(attempt.box_after))
    for other in STACKED[-4:]:
        at = other.box_before.mean(axis=0)
        plan = policy.plan(attempt.before, Goal(attempt.box_after, object_at=tuple(at)))
        there = policy.grid.to_robot(policy.rectifier.to_grid(at[None]))[0]
        assert np.linalg.norm(plan.action.pick.xy - there) < 0.055
        shown, all_shown = (np.count_nonzero(each.views["pick"]) for each in (plan, whole))
        assert (
            shown >= all_shown
        )  # the whole heat map, whoever points; where nobody does, nothing under the goal
    hidden = Goal(STACKED[-1].box_before)
    pick = policy.rectifier.to_grid(hidden.corners)
    action = policy.plan(attempt.before, hidden).action
    u, v = policy.grid.to_pixels(action.pick.xy)[0]
    assert cv2.pointPolygonTest(pick.astype(np.float32), (u, v), True) < 2


def test_layers_are_told_again_by_what_was_saved_and_not_by_an_older_run(stacked_run, run, tmp_path):
    policy, attempt = load_policy(stacked_run), STACKED[-1]
    goal = Goal(attempt.box_after, layer=2)
    policy.save_pretrained(tmp_path / "again")
    one, other = (each.plan(attempt.before, goal) for each in (policy, load_policy(tmp_path / "again")))
    assert np.array_equal(one.action.to_array(), other.action.to_array())
    config = yaml.safe_load((tmp_path / "again" / "config.yaml").read_text())
    del config["model"]["camera"]["leaning"]
    (tmp_path / "again" / "config.yaml").write_text(yaml.safe_dump(config))
    assert "leaning" not in load_policy(run).config()["model"]["camera"]
    for known in (load_policy(tmp_path / "again"), load_policy(run)):
        with pytest.raises(
            BaggieError, match="got a transporter policy that knows the table only; collect bag"
        ):
            known.plan(attempt.before, goal)


def test_what_cannot_be_done_in_stacks_is_one_clear_line(stacked_run):
    policy, attempt = load_policy(stacked_run), STACKED[-1]
    goal = Goal(attempt.box_after)
    for changed, message in (
        (replace(goal, object_at=(3.0, 3.0)), "expected a bag pointed at on the part of the table"),
        (replace(goal, layer=60), "expected a layer below the camera, 1.00 m above the table, got layer 60"),
    ):
        with pytest.raises(BaggieError, match=message) as error:
            policy.plan(attempt.before, changed)
        assert "\n" not in str(error.value)


def test_where_one_is_pointed_at_and_none_is_seen_it_says_so(stacked_run, monkeypatch):
    policy, attempt = load_policy(stacked_run), STACKED[-1]
    at = attempt.box_before.mean(axis=0)
    u, v = np.round(policy.rectifier.to_grid(at[None])[0]).astype(int)

    def bright_there(scene, about):
        logits = torch.zeros(1, 1, *scene.maps.shape[-2:])
        logits[..., v, u] = 20.0
        return Scores(logits, torch.zeros_like(about.place), 1, 1)

    monkeypatch.setattr(policy.network, "config", replace(policy.network.config, preset="paper"))  # no turns
    monkeypatch.setattr(policy.network.picks[0], "forward", bright_there)
    plan = policy.plan(attempt.before, Goal(attempt.box_after, object_at=tuple(at)))
    assert policy.grid.to_pixels(plan.action.pick.xy)[0] == pytest.approx([u, v], abs=0.1)
    message = "no bag in sight where one was pointed at: the heat map there is at 0.0% of its peak"
    with pytest.raises(BaggieError, match=message) as error:
        policy.plan(attempt.before, Goal(attempt.box_after, object_at=(at[0] + 80, at[1])))
    assert "\n" not in str(error.value)
