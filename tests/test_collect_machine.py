import itertools
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from baggie import seeds
from baggie.calibration.files import CameraIdentity
from baggie.calibration.image_to_robot.map import ImageToRobot
from baggie.collect import machine
from baggie.collect import machine as detect
from baggie.collect.machine import (
    MARGIN_M,
    MAX_LOOKS,
    MAX_RESCUES,
    MAX_TRIES,
    MIN_DISTANCE_M,
    Phase,
    Stopped,
    Turn,
    false_45,
    grip_yaw,
    long_place_yaw,
    nearest_grip,
    random_place,
    run_turn,
)
from baggie.collect.recording import Recording
from baggie.collect.self_taught import STALL_AFTER, run_sitting
from baggie.commissioning.image_to_robot import grid
from baggie.errors import BaggieError
from baggie.geometry import PlanarPose, Rectangle
from baggie.operator import Nobody
from baggie.types import Outcome, PickPlace
from baggie.workcell.workcell import WorkcellSettings
from helpers.fake_workcell import FakeCell
from helpers.scripted import Scripted

SIZE = (640, 360)
RECORDING = Recording("put the bean bag on the goal", 0, 0, (320, 180))


@pytest.fixture(scope="module")
def image_to_robot() -> ImageToRobot:
    cell = FakeCell(size=SIZE)
    robot = grid(cell.settings.workspace, 0.03, (0.017,))
    return ImageToRobot.fit(cell.camera.project(robot), robot, CameraIdentity("top", *SIZE))


@pytest.fixture
def cell() -> FakeCell:
    return FakeCell(size=SIZE)


@pytest.fixture
def long_turn(image_to_robot: ImageToRobot) -> Turn:
    settings = WorkcellSettings(object_size_m=(0.15, 0.10, 0.03), object_symmetry=2)
    cell = FakeCell(settings, size=SIZE)
    return Turn(cell, image_to_robot, seeds.generator(0), Nobody())


@pytest.fixture
def turn(cell: FakeCell, image_to_robot: ImageToRobot) -> Turn:
    return Turn(cell, image_to_robot, seeds.generator(0), Nobody())


def seen(turn: Turn) -> Turn:
    machine.look(turn)
    machine.find(turn)
    return turn


# places


@given(st.floats(0.35, 0.65), st.floats(-0.3, 0.3), st.integers(0, 10**6))
def test_a_place_is_inside_with_a_margin_and_far_from_the_last(x, y, seed):
    workspace, last = Rectangle(0.35, 0.65, -0.3, 0.3), PlanarPose(x, y)
    place = random_place(workspace, last, np.random.default_rng(seed))
    assert workspace.contains(place.x, place.y, MARGIN_M)
    assert place.distance(last) >= MIN_DISTANCE_M
    assert place.yaw == 0.0


def test_places_cover_the_workspace():
    workspace, last, rng = Rectangle(0.35, 0.65, -0.3, 0.3), PlanarPose(0.5, 0.0), np.random.default_rng(0)
    spots = []
    for _ in range(400):
        last = random_place(workspace, last, rng)
        spots.append(last.xy)
    counts, _, _ = np.histogram2d(*np.array(spots).T, bins=(3, 6), range=[(0.38, 0.62), (-0.27, 0.27)])
    assert counts.min() > 5


def test_a_workspace_too_small_is_refused():
    with pytest.raises(BaggieError, match="make it larger"):
        random_place(Rectangle(0.4, 0.5, 0.0, 0.1), PlanarPose(0.45, 0.05), np.random.default_rng(0))


@given(st.floats(-math.pi / 4, math.pi / 4))
def test_the_gripper_follows_the_bag_except_for_a_first_reading_of_45_degrees(yaw):
    doubted = abs(yaw) > math.radians(38.001)
    assert false_45(yaw) or not doubted
    assert grip_yaw(yaw, believed=True) == yaw
    assert grip_yaw(yaw, believed=False) == (0.0 if false_45(yaw) else yaw)


@given(st.floats(-math.pi / 2, math.pi / 2), st.integers(0, 10**6))
def test_a_long_object_is_put_down_along_an_axis_with_at_most_half_a_turn_of_the_wrist(yaw, seed):
    place = long_place_yaw(yaw, np.random.default_rng(seed))
    assert place in (0.0, math.pi / 2, -math.pi / 2)
    assert abs(place - yaw) <= math.pi / 2


def test_a_long_object_is_put_down_along_either_axis():
    rng = np.random.default_rng(0)
    assert 60 < sum(long_place_yaw(0.3, rng) == 0.0 for _ in range(200)) < 140


def test_the_nearest_grip_is_on_the_edge_or_nowhere():
    workspace = Rectangle(0.3, 0.7, -0.3, 0.3)
    assert nearest_grip(workspace, 0.5, 0.1, 0.04) == (0.5, 0.1)
    assert nearest_grip(workspace, 0.72, -0.31, 0.04) == (0.7, -0.3)
    assert nearest_grip(workspace, 0.75, 0.0, 0.04) is None


# each state alone


def test_look_takes_a_picture_with_the_arm_parked(turn):
    turn.cell.arm.move_to(PlanarPose(0.5, 0.0).at_height(0.2), 0.1)
    assert machine.look(turn) is Phase.FIND
    assert turn.before is not None
    assert turn.cell.arm.pose() == turn.cell.arm.park()


def test_find_gives_the_pose_in_the_robots_frame(turn):
    machine.look(turn)
    assert machine.find(turn) is Phase.PLAN
    assert turn.pose.distance(turn.cell.bag) < 0.005


def test_find_without_a_bag_recovers(turn):
    turn.cell.hidden = True
    machine.look(turn)
    assert machine.find(turn) is Phase.RECOVER
    assert "not in sight" in turn.trouble


def test_plan_squares_the_bag_and_carries_it_far(turn):
    turn.cell.bag = PlanarPose(0.5, 0.0, 0.3)
    assert machine.plan(seen(turn)) is Phase.MOVE
    assert turn.action.pick.yaw == pytest.approx(0.3, abs=0.05)
    assert turn.action.place.yaw == 0.0
    assert turn.action.place.distance(turn.action.pick) >= MIN_DISTANCE_M
    assert not turn.doubted


def test_plan_doubts_45_degrees_once(turn):
    turn.cell.bag = PlanarPose(0.5, 0.0, math.pi / 4)
    machine.plan(seen(turn))
    assert turn.doubted
    assert turn.action.pick.yaw == 0.0
    turn.doubted_before = True
    machine.plan(turn)
    assert not turn.doubted
    assert abs(turn.action.pick.yaw) > math.radians(38)


@pytest.mark.parametrize("doubted_before", [False, True])
@pytest.mark.parametrize("degrees", [45, 0])
def test_after_a_miss_the_other_reading_of_45_degrees_is_tried(
    turn: Turn, monkeypatch: pytest.MonkeyPatch, degrees: int, doubted_before: bool
) -> None:
    """A hard square goes into a hand that lies along its sides alone, however its outline is read."""
    turn.cell.bag = PlanarPose(0.5, 0.0, math.radians(degrees))
    turn.doubted_before = doubted_before
    carry, tried = turn.cell.execute, []

    def execute(action: PickPlace) -> Outcome:
        tried.append(action)
        off = math.remainder(action.pick.yaw - turn.cell.bag.yaw, math.pi / 2)
        return carry(action) if abs(off) < math.radians(10) else Outcome(action, failure="missed-grasp")

    monkeypatch.setattr(turn.cell, "execute", execute)
    read = detect.detect

    def as_if_at_45(*args: Any) -> Any:
        found, pose = read(*args)
        return found, replace(pose, yaw=math.pi / 4)

    monkeypatch.setattr(machine, "detect", as_if_at_45)
    run_turn(turn)
    assert turn.tries == (1 if doubted_before == (degrees == 45) else 2)
    assert turn.outcome is not None
    assert turn.outcome.failure != "missed-grasp"


@pytest.mark.parametrize("degrees", range(-90, 90, 15))
def test_plan_grips_a_long_bag_across_its_narrow_side_at_any_angle(long_turn, degrees):
    long_turn.cell.bag = PlanarPose(0.52, -0.13, math.radians(degrees))
    assert machine.plan(seen(long_turn)) is Phase.MOVE
    # The fingers close along the tool's y, so its x is along the bag.
    off = math.remainder(long_turn.action.pick.yaw - math.radians(degrees), math.pi)
    assert abs(off) < math.radians(4)
    assert not long_turn.doubted  # a long rectangle has no second reading at 45 degrees
    assert math.remainder(long_turn.action.place.yaw, math.pi / 2) == 0.0


def test_plan_grips_a_bag_just_outside_by_its_near_side(turn):
    limits = turn.cell.settings.limits.workspace
    turn.cell.bag = PlanarPose(limits.x_max + 0.02, 0.0)
    assert machine.plan(seen(turn)) is Phase.MOVE
    assert turn.action.pick.x == limits.x_max


def test_plan_grips_what_is_hard_by_its_middle_or_not_at_all(turn: Turn) -> None:
    limits = turn.cell.settings.limits.workspace
    turn.cell.settings = replace(turn.cell.settings, object_hard=True)
    turn.cell.bag = PlanarPose(limits.x_max - 0.02, 0.0)
    assert machine.plan(seen(turn)) is Phase.MOVE
    turn.cell.bag = PlanarPose(limits.x_max + 0.02, 0.0)
    assert machine.plan(seen(turn)) is Phase.ASK


def test_plan_asks_for_a_bag_out_of_reach(turn):
    turn.cell.bag = PlanarPose(turn.cell.settings.limits.workspace.x_max + 0.1, 0.0)
    assert machine.plan(seen(turn)) is Phase.ASK
    assert "out of reach" in turn.trouble


@pytest.mark.parametrize(
    ("event", "after", "failure"),
    [
        (None, Phase.CHECK, None),
        ("missed-grasp", Phase.RETRY, "missed-grasp"),
        ("unreachable", Phase.RETRY, "unreachable"),
        ("dropped", Phase.CHECK, "dropped"),
    ],
)
def test_move_reports_what_happened(turn, event, after, failure):
    turn.cell.script = [event]
    machine.plan(seen(turn))
    assert machine.move(turn) is after
    assert turn.outcome.failure == failure
    assert turn.tries == 1


def test_retry_looks_again_up_to_three_tries(turn):
    turn.looks = 2
    for tries in range(1, MAX_TRIES):
        turn.tries = tries
        assert machine.retry(turn) is Phase.LOOK
    turn.tries = MAX_TRIES
    assert machine.retry(turn) is Phase.CHECK
    assert turn.looks == 0


def test_recover_looks_again_and_then_asks(turn):
    turn.looks = MAX_LOOKS - 1
    assert machine.recover(turn) is Phase.LOOK
    turn.looks = MAX_LOOKS
    assert machine.recover(turn) is Phase.ASK


def test_a_cell_helps_itself_a_few_times_and_then_nobody_does(turn):
    for _ in range(MAX_RESCUES):
        assert machine.ask(turn) is Phase.LOOK
    assert machine.ask(turn) is Phase.STOPPED
    assert turn.cell.rescues == MAX_RESCUES


def test_a_person_is_asked_where_the_cell_does_not_help_itself_as_long_as_anybody_answers(turn):
    turn.operator = person = Scripted(*[""] * 9)
    turn.cell.helps, turn.trouble = False, "the bag is gone"
    for _ in range(9):
        assert machine.ask(turn) is Phase.LOOK
    assert machine.ask(turn) is Phase.STOPPED
    assert person.asked == ["the bag is gone"] * 10


@pytest.mark.parametrize(
    ("where", "failure"),
    [("place", None), ("start", "stalled"), ("elsewhere", "dropped"), ("nowhere", "lost-bag")],
)
def test_check_looks_where_the_bag_came_to_lie(turn, where, failure):
    machine.plan(seen(turn))
    start, place = turn.cell.bag, turn.action.place
    elsewhere = PlanarPose((start.x + place.x) / 2, (start.y + place.y) / 2)
    turn.cell.bag = {"place": place, "start": start, "elsewhere": elsewhere}.get(where, start)
    turn.cell.hidden = where == "nowhere"
    turn.outcome, turn.tries = Outcome(turn.action), 2
    assert machine.check(turn) is Phase.RECORD
    assert turn.outcome.failure == failure
    assert turn.outcome.tries == 2
    assert turn.after is not None


def test_check_keeps_a_failure_known_already(turn):
    machine.plan(seen(turn))
    turn.outcome = Outcome(turn.action, "dropped")
    machine.check(turn)
    assert turn.outcome.failure == "dropped"


# whole turns


def test_a_missed_grasp_is_retried_after_a_fresh_look(turn):
    turn.cell.script = ["missed-grasp", "missed-grasp", None]
    run_turn(turn)
    assert turn.outcome.success
    assert turn.outcome.tries == 3
    picks = [action.pick for action in turn.cell.executed]
    assert len(picks) == 3
    assert len({pick.x for pick in picks}) == 3  # another picture, another noise, another estimate


def test_three_misses_are_one_failed_attempt(turn):
    turn.cell.script = ["missed-grasp"] * 3 + [None]
    run_turn(turn)
    assert (turn.outcome.failure, turn.outcome.tries) == ("missed-grasp", 3)


def test_a_lost_bag_is_asked_for_and_the_turn_goes_on(turn):
    turn.cell.hidden = True
    run_turn(turn)
    assert turn.cell.rescues == 1
    assert turn.outcome.success


def test_nobody_to_help_stops_with_a_line(turn):
    turn.cell.hidden, turn.cell.helps = True, False
    with pytest.raises(Stopped, match="not in sight"):
        run_turn(turn)


# sittings


def test_a_sitting_is_ten_numbered_attempts(cell, image_to_robot):
    attempts = list(run_sitting(cell, image_to_robot, RECORDING, 3, operator=Nobody()))
    assert [attempt.attempt_id for attempt in attempts] == list(range(30, 40))
    for attempt in attempts:
        assert attempt.before.size == RECORDING.size
        assert attempt.outcome.success
        assert attempt.commanded.place.yaw == 0.0
        assert np.isfinite(attempt.box_before).all()
        assert attempt.truth.before.distance(attempt.commanded.pick) < 0.006
        assert attempt.truth.after.distance(attempt.commanded.place) < 0.02
    for before, after in itertools.pairwise(attempts):
        assert before.truth.after == after.truth.before
        assert abs(math.remainder(after.truth.before.yaw, math.pi / 2)) < 0.2  # squared up by the turn before


def test_long_bags_are_squared_up_along_either_axis(long_turn):
    attempts = list(run_sitting(long_turn.cell, long_turn.image_to_robot, RECORDING, 2, operator=Nobody()))
    assert all(attempt.outcome.success for attempt in attempts)
    yaws = [math.remainder(attempt.truth.after.yaw, math.pi) for attempt in attempts]
    assert all(abs(math.remainder(yaw, math.pi / 2)) < 0.2 for yaw in yaws)
    assert len({abs(yaw) > math.pi / 4 for yaw in yaws}) == 2


def test_boxes_are_in_the_pixels_of_the_recorded_picture(cell, image_to_robot):
    attempt = next(iter(run_sitting(cell, image_to_robot, RECORDING, 0, operator=Nobody())))
    pose = attempt.truth.before
    true = cell.camera.project(np.array([[pose.x, pose.y, 0.015]]))[0]
    assert np.linalg.norm(attempt.box_before.mean(axis=0) - ((true + 0.5) / 2 - 0.5)) < 2


@settings(max_examples=5, deadline=None)
@given(number=st.integers(0, 1000))
def test_a_sitting_does_not_depend_on_what_the_cell_did_before(image_to_robot, number):
    fresh, used = FakeCell(size=SIZE), FakeCell(size=SIZE)
    for _ in zip(
        range(2), run_sitting(used, image_to_robot, RECORDING, number + 1, operator=Nobody()), strict=False
    ):
        pass
    pairs = zip(
        range(2),
        run_sitting(fresh, image_to_robot, RECORDING, number, operator=Nobody()),
        run_sitting(used, image_to_robot, RECORDING, number, operator=Nobody()),
        strict=False,
    )
    for _, a, b in pairs:
        assert np.array_equal(a.before.color, b.before.color)
        assert a.commanded == b.commanded
        assert a.time == b.time


@pytest.mark.parametrize("failure", ["dropped", "lost-bag", "missed-grasp", "unreachable"])
def test_each_failure_is_recorded_and_the_sitting_goes_on(cell, image_to_robot, failure):
    repeats = 3 if failure in ("missed-grasp", "unreachable") else 1
    sitting = run_sitting(cell, image_to_robot, RECORDING, 1, operator=Nobody())
    first = next(sitting)
    cell.script = [failure] * repeats
    second, third = next(sitting), next(sitting)
    assert [a.outcome.failure for a in (first, second, third)] == [None, failure, None]
    assert np.isnan(second.box_after).all() == (failure == "lost-bag")


def test_an_unmoved_bag_after_a_success_is_a_stall_that_is_asked_about(cell, image_to_robot):
    person = Scripted("")
    sitting = run_sitting(cell, image_to_robot, RECORDING, 1, operator=person)
    cell.reset((0,))
    cell.helps = False
    next(sitting)
    cell.script = ["stalled"]
    assert next(sitting).outcome.failure == "stalled"
    assert next(sitting).outcome.success
    assert "still where it was" in person.asked[0]


def test_a_frozen_camera_stalls(cell, image_to_robot):
    cell.helps = False
    sitting = run_sitting(cell, image_to_robot, RECORDING, 1, operator=Nobody())
    next(sitting)
    cell.frozen = cell.look()
    assert next(sitting).outcome.failure == "stalled"
    with pytest.raises(Stopped, match="camera is live"):
        next(sitting)


def test_where_the_arm_does_not_get_there_again_and_again_its_own_words_are_passed_on(cell, image_to_robot):
    cell.helps = False
    sitting = run_sitting(cell, image_to_robot, RECORDING, 1, operator=Nobody())
    cell.script = ["unreachable"] * MAX_TRIES * STALL_AFTER
    with pytest.raises(
        Stopped, match=r"in a row failed.*unreachable: the arm did not get there \(.+\): put the"
    ):
        list(sitting)


def test_many_failures_in_a_row_stop_it_where_only_the_cell_helps_once(cell, image_to_robot):
    person = Scripted()
    sitting = run_sitting(cell, image_to_robot, RECORDING, 1, operator=person)
    cell.script = ["dropped"] * 2 * STALL_AFTER
    seen_failures = []
    with pytest.raises(Stopped, match="in a row failed") as caught:
        seen_failures.extend(attempt.outcome.failure for attempt in sitting)
    assert seen_failures == ["dropped"] * (2 * STALL_AFTER)
    assert (cell.rescues, len(person.asked)) == (1, 1)
    assert "\n" not in str(caught.value)
