"""LeRobot's robots as an arm, on one that follows late, a little short, and not through things."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from baggie.errors import ArmError, BaggieError, ReachError
from baggie.geometry import FloatArray, ToolPose, wrap_angle
from baggie.robot.kinematics import load_arm_model
from baggie.robot.lerobot.arm import LeRobotArm
from baggie.robot.lerobot.link import open_robot
from baggie.robot.limits import GuardedArm
from baggie.workcell.workcell import WorkcellSettings
from helpers.lerobot_robot import FR3, JOINTS, WIDEST_M, NumbersRobot, RobotsClock, settings

LIMITS = WorkcellSettings().limits
HIGH = ToolPose(0.5, 0.0, 0.2)
RANGE_DEG = np.rad2deg(load_arm_model(FR3, JOINTS, tool="hand").jnt_range)


def opened(robot: NumbersRobot, **changes: Any) -> LeRobotArm:
    return LeRobotArm(robot, settings(**changes), RobotsClock(robot))


def test_it_stops_at_what_it_touches_and_presses_no_more() -> None:
    robot = NumbersRobot(floor_z=0.08)
    arm = opened(robot)
    arm.move_to(HIGH, 0.5)
    lowered = arm.lower_until_contact(0.02, 0.5, 5.0)
    assert lowered.z == pytest.approx(0.08, abs=0.005)
    assert (lowered.x, lowered.y) == pytest.approx((HIGH.x, HIGH.y), abs=0.005)
    robot.floor_z = -np.inf
    robot.advance(2.0)
    assert arm.pose().z == pytest.approx(lowered.z, abs=0.003), "it did not lean on what is gone"


def test_what_lies_just_above_the_lowest_height_is_felt_too() -> None:
    robot = NumbersRobot(floor_z=0.055)
    arm = opened(robot)
    arm.move_to(HIGH, 0.5)
    assert arm.lower_until_contact(0.05, 0.5, 1.0).z == pytest.approx(0.055, abs=0.003)
    lean_deg = np.abs(robot.target[:7] - robot.short_deg - robot.at[:7]).max()
    assert lean_deg < 3.0, "it does not press harder and harder"


def test_what_is_in_the_way_ends_a_motion_and_is_not_leant_on() -> None:
    robot = NumbersRobot(floor_z=0.3)
    arm = opened(robot, max_lag_deg=12)
    arm.move_to(ToolPose(0.5, 0.0, 0.4), 0.5)
    with pytest.raises(ReachError, match=r"fr3_joint\d was \d+ degrees behind"):
        arm.move_to(ToolPose(0.5, 0.0, 0.1), 0.3)
    assert np.abs(robot.target[:7] - robot.short_deg - robot.at[:7]).max() < 2.0


def test_a_robot_that_stays_short_for_good_is_there_all_the_same() -> None:
    arm = opened(NumbersRobot(short_deg=4.0))
    for target in (HIGH, replace(HIGH, y=0.2, yaw=0.5), HIGH):
        np.testing.assert_allclose(arm.move_to(target, 0.5).xyz, target.xyz, atol=0.002)


@dataclass
class Normalized(NumbersRobot):
    """Counts from -100 to 100 over each joint's range, the first joint the other way round."""

    def get_observation(self) -> dict[str, Any]:
        answer = super().get_observation()
        return answer | dict(zip(answer, self._counted(self.at[:7]).tolist(), strict=False))

    def send_action(self, action: dict[str, Any]) -> Mapping[str, Any]:
        counts = np.array([action[f"{name}.pos"] for name in JOINTS]) * [-1, 1, 1, 1, 1, 1, 1]
        degrees = RANGE_DEG.mean(axis=1) + counts / 200 * np.diff(RANGE_DEG)[:, 0]
        super().send_action(action | dict(zip(action, degrees.tolist(), strict=False)))
        return action

    @staticmethod
    def _counted(degrees: FloatArray) -> FloatArray:
        counts = 200 * (degrees - RANGE_DEG.mean(axis=1)) / np.diff(RANGE_DEG)[:, 0]
        return np.asarray(counts * [-1, 1, 1, 1, 1, 1, 1])


def test_how_a_robot_counts_makes_no_difference() -> None:
    plain, normalized = NumbersRobot(), Normalized()
    joints = [{"name": JOINTS[0], "sign": -1}, *JOINTS[1:]]
    park = normalized._counted(plain.at[:7]).tolist()
    arms = opened(plain), opened(normalized, units="normalized", joints=joints, park=park)
    for target in (HIGH, ToolPose(0.4, -0.2, 0.1, -0.6)):
        for arm in arms:
            arm.move_to(target, 0.5)
        np.testing.assert_allclose(normalized.at, plain.at, atol=1e-6)


@dataclass
class Clipping(NumbersRobot):
    """Takes no more than 2 degrees beyond where it is, as LeRobot's `max_relative_target`."""

    def send_action(self, action: dict[str, Any]) -> Mapping[str, Any]:
        asked = np.array(list(action.values()))
        taken = dict(zip(action, np.clip(asked, self.at - 2.0, self.at + 2.0).tolist(), strict=True))
        super().send_action(taken)
        return taken


def test_it_goes_on_from_what_was_really_sent() -> None:
    robot = Clipping(short_deg=0.0)
    arm = opened(robot, speed=0.1)
    target = ToolPose(0.45, 0.1, 0.3)
    np.testing.assert_allclose(arm.move_to(target, 0.5).xyz, target.xyz, atol=0.002)


places = st.builds(
    ToolPose, st.floats(0.35, 0.6), st.floats(-0.3, 0.3), st.floats(0.05, 0.4), st.floats(-1, 1)
)


@hypothesis_settings(max_examples=8, deadline=None)
@given(
    st.lists(places, min_size=1, max_size=3), st.floats(0.1, 1.0), st.floats(0.0, 4.0), st.floats(-0.1, 0.3)
)
def test_no_step_sent_is_larger_than_allowed(
    targets: list[ToolPose], speed: float, short_deg: float, floor_z: float
) -> None:
    robot = NumbersRobot(short_deg=short_deg, floor_z=floor_z)
    arm = opened(robot, speed=speed, rate_hz=25, joint_speed_deg_s=100)
    start = robot.at
    for target in targets:
        for move in (
            lambda target=target: arm.move_to(target, 1.0),
            lambda: arm.lower_until_contact(0.03, 0.5, 2.0),
            arm.park,
        ):
            try:
                move()
            except ReachError:
                continue
    steps = np.abs(np.diff([start, *robot.sent], axis=0))
    assert steps[:, :7].max() <= 100 * speed / 25 + 1e-6


@given(st.floats(-7, 7), st.floats(-7, 7))
@example(3.0, 5.5)
@hypothesis_settings(max_examples=8, deadline=None)
def test_a_yaw_is_a_yaw_however_often_it_goes_round(start: float, end: float) -> None:
    robot = NumbersRobot()
    arm = opened(robot)
    for yaw in (start, end):
        before, here = len(robot.sent), arm.pose().yaw
        try:
            foreseen = arm.foresee([replace(HIGH, yaw=yaw)])
            assert len(robot.sent) == before
            reached = arm.move_to(replace(HIGH, yaw=yaw), 1.0)
        except ReachError:  # neither way round keeps to the line
            assert len(robot.sent) == before
            assert max(abs(wrap_angle(here)), abs(wrap_angle(yaw))) > 1.0
        else:
            assert abs(wrap_angle(reached.yaw - yaw)) < 0.02
            shorter = abs(wrap_angle(yaw - here))
            assert min(abs(foreseen - shorter), abs(foreseen - 2 * np.pi + shorter)) < 0.02


@pytest.mark.parametrize("target", [ToolPose(1.1, 0.0, 0.2), ToolPose(0.05, 0.0, 0.02)])
def test_where_it_cannot_reach_nothing_is_sent(target: ToolPose) -> None:
    robot = NumbersRobot()
    with pytest.raises(ReachError):
        opened(robot).move_to(target, 0.5)
    assert not robot.sent


def test_a_tilted_tool_is_parked_before_it_goes_along_lines() -> None:
    robot = NumbersRobot()
    robot.at[5] -= 40.0
    arm = opened(robot)
    with pytest.raises(ReachError, match=r"tilted by 40 degrees.* park the arm first"):
        arm.move_to(HIGH, 0.5)
    assert not robot.sent
    arm.park()
    assert arm.move_to(HIGH, 0.5).z == pytest.approx(HIGH.z, abs=0.002)


@dataclass
class After:
    """The robot's clock, on which something happens at a time."""

    robot: NumbersRobot
    at_s: float
    happens: Callable[[], None] = lambda: None
    now: float = 0.0

    def monotonic(self) -> float:
        return self.now

    def sleep(self, seconds: float, /) -> None:
        self.now += seconds
        self.robot.advance(seconds)
        if self.now >= self.at_s:
            self.at_s = np.inf
            self.happens()


def test_a_robot_that_falls_silent_is_said_so_and_found_again() -> None:
    robot = NumbersRobot()
    clock = After(robot, at_s=0.3)
    arm = LeRobotArm(robot, settings(), clock)

    def pull_the_cable() -> None:
        robot.cable = False

    clock.happens = pull_the_cable
    with pytest.raises(ArmError, match=r"the link to numbers_follower was lost.*check its power, its cable"):
        GuardedArm(arm, LIMITS).move_to(HIGH, 0.2)
    with pytest.raises(ArmError, match="could not open port"):
        arm.pose()
    robot.cable = True
    assert arm.move_to(HIGH, 0.5).z == pytest.approx(HIGH.z, abs=0.002)


def test_stopped_it_sends_nothing_more_until_it_is_told_to() -> None:
    robot = NumbersRobot()
    clock = After(robot, at_s=0.3)
    arm = LeRobotArm(robot, settings(), clock)
    clock.happens = arm.stop
    with pytest.raises(ArmError, match="was stopped"):
        arm.move_to(HIGH, 0.2)
    sent = len(robot.sent)
    assert sent == pytest.approx(0.3 * 30, abs=2)
    robot.advance(2.0)
    assert len(robot.sent) == sent
    assert arm.move_to(HIGH, 0.5).z == pytest.approx(HIGH.z, abs=0.002)


@given(st.floats(0.0, 0.06), st.floats(2.0, 10.0))
@hypothesis_settings(max_examples=8, deadline=None)
def test_fingers_close_on_what_is_there_and_squeeze(thing_m: float, force_n: float) -> None:
    robot = NumbersRobot(thing_m=thing_m)
    arm = opened(robot, grip_n=0.5)
    arm.move_gripper(WIDEST_M)
    assert arm.grasp(force_n) == pytest.approx(thing_m, abs=0.001)
    assert robot.at[7] - robot.target[7] == pytest.approx(min(force_n / 0.5, robot.at[7]), abs=0.5)
    arm.move_to(HIGH, 0.5)
    assert arm.gripper_width() == pytest.approx(thing_m, abs=0.001), "it does not let go on its way"


def test_an_uncalibrated_robot_is_refused() -> None:
    robot = NumbersRobot(is_calibrated=False)
    with pytest.raises(ArmError, match="numbers_follower is not calibrated; run lerobot-calibrate"):
        opened(robot).pose()
    assert not robot.connected


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"gripper": "jaw"}, r"expected a robot with jaw\.pos, numbers_follower has fr3_joint1\.pos, "),
        ({"tool": "flange"}, r"has no site, body or link 'flange'; it has .*hand"),
        ({"model": Path("nowhere.xml")}, r"nowhere\.xml is no model of an arm"),
        (
            {"joints": [*JOINTS[:6], {"name": JOINTS[6], "model": "wrist"}]},
            r"no joint 'wrist'; it has fr3_joint1",
        ),
        (
            {"park": [0, 0, 0, -90, 0, 0, 0]},
            r"a parking position with the tool pointing down, .* by 90 degrees",
        ),
        ({"park": [0.0] * 6}, r"park needs 7 numbers, one a joint, got 6"),
        ({"widths": [(0, 0.0)]}, r"widths needs two or more pairs"),
        ({"widths": [(0, 0.05), (100, 0.0)]}, r"widths needs two or more pairs, both numbers rising"),
    ],
)
def test_settings_that_do_not_fit_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises((BaggieError, ValueError), match=message):
        opened(NumbersRobot(), **changes)


def test_without_lerobot_one_line_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "lerobot.robots", None)
    with pytest.raises(BaggieError, match=r"pip install 'lerobot\[feetech\]'$") as raised:
        open_robot("so101_follower", {"port": "/dev/ttyACM0"})
    assert "\n" not in str(raised.value)
