"""However a carry is said, it is one motion: the one that turns the hand least, within what the wrist reaches."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import cast

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from baggie.cameras.camera import Camera
from baggie.errors import LimitError, ReachError
from baggie.geometry import PlanarPose, ToolPose, nearest_angle, wrap_angle
from baggie.robot.primitives import Handling
from baggie.sim.arm import BLOCK_HANDLING, SEALED_WIDTH_M
from baggie.types import Outcome, PickPlace
from baggie.workcell.workcell import WorkcellSettings
from helpers.recording_arm import RecordingArm, TimelessCell

# Narrower than it opens, so that letting go is told from opening.
SETTINGS = WorkcellSettings(handling=Handling(release_width_m=0.05))
PICK, PLACE = PlanarPose(0.45, 0.12, 0.3), PlanarPose(0.55, -0.15)
TURN = 2 * math.pi
CLOSE_RAD = 0.02  # the least turn is found as exactly as an arm foresees turns


class WristArm(RecordingArm):
    """Its wrist turns from `low` to `high` radians and no further; now it is at `wrist`."""

    def __init__(self, low: float, high: float, wrist: float = 0.0) -> None:
        super().__init__()
        self.low, self.high, self.wrist, self.turned = low, high, wrist, 0.0
        self.at = replace(self.at, yaw=wrap_angle(wrist))

    def foresee(self, way: Sequence[ToolPose]) -> float:
        wrist, turned = self.wrist, 0.0
        for target in way:
            after = self._after(wrist, target)
            wrist, turned = after, turned + abs(after - wrist)
        return turned

    def move_to(self, target: ToolPose, speed_m_s: float) -> ToolPose:
        wrist = self._after(self.wrist, target)
        self.turned += abs(wrist - self.wrist)
        self.wrist = wrist
        return super().move_to(replace(target, yaw=wrap_angle(wrist)), speed_m_s)

    def anew(self) -> WristArm:
        return WristArm(self.low, self.high, self.wrist)

    def _after(self, wrist: float, target: ToolPose) -> float:
        shorter = nearest_angle(target.yaw, wrist)
        for yaw in (shorter, shorter - math.copysign(TURN, shorter - wrist)):
            if self.low - 1e-6 <= yaw <= self.high + 1e-6:  # or rounding would decide
                return yaw
        raise ReachError("the wrist does not turn so far")


def carry(arm: RecordingArm, action: PickPlace, symmetry: int = 4, **settings: object) -> Outcome:
    changed = replace(SETTINGS, object_symmetry=symmetry, **settings)  # type: ignore[arg-type]
    return TimelessCell(arm, cast(Camera, None), changed).execute(action)


def said(pick_yaw: float, place_yaw: float) -> PickPlace:
    return PickPlace(replace(PICK, yaw=pick_yaw), replace(PLACE, yaw=place_yaw))


def turns(symmetry: int) -> list[float]:
    """After which an object looks the same, within a turn; some of them for what is round."""
    return (
        [TURN * k / symmetry for k in range(-symmetry, symmetry + 1)] if symmetry else [-4.0, -0.7, 0.0, 1.3]
    )


def equal_sayings(action: PickPlace, symmetry: int) -> list[PickPlace]:
    return [
        said(action.pick.yaw + of_pick + half, action.place.yaw + of_place + half)
        for of_pick in turns(symmetry)
        for of_place in turns(symmetry)
        for half in (0.0, math.pi)
    ]


def turned_by(arm: WristArm, action: PickPlace) -> float:
    """Radians that the wrist turns to carry it out as it is said; infinite where it cannot."""
    yaws = [action.pick.yaw, action.place.yaw]
    try:
        return arm.foresee([ToolPose(0.5, 0.0, 0.2, yaw) for yaw in yaws])
    except ReachError:
        return math.inf


yaws = st.floats(-7.0, 7.0)
symmetries = st.sampled_from([0, 1, 2, 3, 4])
wrists = st.builds(WristArm, st.floats(-4.0, -1.0), st.floats(1.0, 4.0), st.floats(-1.0, 1.0))


@given(wrists, yaws, yaws, symmetries, st.integers(0, 10**6))
@example(WristArm(-2.2, 3.8), 0.3, 0.0, 4, 117)
def test_equal_sayings_are_one_motion(
    arm: WristArm, pick_yaw: float, place_yaw: float, symmetry: int, other: int
) -> None:
    action = said(pick_yaw, place_yaw)
    equal = equal_sayings(action, symmetry)
    seen = []
    for each in (action, equal[other % len(equal)]):
        moved = arm.anew()
        try:
            carry(moved, each, symmetry)
        except ReachError:
            assert not moved.log
        seen.append([(pose.xyz.tolist(), pose.yaw) for pose in moved.poses])
    assert len(seen[0]) == len(seen[1])
    for (xyz, yaw), (other_xyz, other_yaw) in zip(*seen, strict=True):
        assert xyz == other_xyz
        assert abs(wrap_angle(yaw - other_yaw)) < 1e-6


@given(wrists, yaws, yaws, symmetries)
def test_the_hand_turns_least_and_to_what_was_meant_or_nothing_moves(
    arm: WristArm, pick_yaw: float, place_yaw: float, symmetry: int
) -> None:
    action = said(pick_yaw, place_yaw)
    least = 0.0  # the hand need not turn at all for what is round
    if symmetry:
        least = min(turned_by(arm, each) for each in equal_sayings(action, symmetry))
    moved = arm.anew()
    if math.isinf(least):
        with pytest.raises(ReachError):
            carry(moved, action, symmetry)
        assert not moved.log
        return
    executed = carry(moved, action, symmetry).executed
    assert moved.turned <= least + CLOSE_RAD
    off = executed.pick.yaw - pick_yaw, executed.place.yaw - place_yaw
    alike = TURN / symmetry if symmetry else 0.01
    assert any(all(abs(wrap_angle(each + half, alike)) < 0.01 for each in off) for half in (0.0, math.pi))


@given(yaws)
def test_a_cup_is_turned_at_the_pick_where_the_wrist_could_not_turn_so_far_at_the_place(turn: float) -> None:
    """It holds alike at any angle: only the turn between both has to be what was said."""
    arm = WristArm(-2.2, 2.2)
    arm.info = replace(arm.info, tool_symmetry=0)
    executed = carry(arm, said(0.0, turn), symmetry=1).executed
    assert wrap_angle(executed.place.yaw - executed.pick.yaw - turn) == pytest.approx(0.0, abs=1e-6)
    if abs(turn) < 2.1:
        assert executed.pick.yaw == 0.0


@given(st.floats(-math.pi / 4 + 0.01, math.pi / 4 - 0.01), st.floats(-math.pi / 4 + 0.01, math.pi / 4 - 0.01))
def test_what_turns_least_is_carried_out_to_the_bit_as_it_is_said(pick_yaw: float, turn: float) -> None:
    action = said(pick_yaw, pick_yaw + turn)
    assert carry(RecordingArm(), action).executed == action


@pytest.mark.parametrize("yaw", [1e9, -1e9, 1e12])
@pytest.mark.parametrize("symmetry", [1, 4])
def test_a_yaw_however_large_is_an_angle(yaw: float, symmetry: int) -> None:
    arm = WristArm(-2.8, 2.8)
    carry(arm, said(yaw, -yaw), symmetry)
    assert arm.turned <= math.pi / 2 + math.pi + CLOSE_RAD


@pytest.mark.parametrize("yaw", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("end", ["pick", "place"])
def test_a_yaw_that_is_no_number_is_refused_in_one_line(yaw: float, end: str) -> None:
    arm = RecordingArm()
    action = said(yaw, 0.0) if end == "pick" else said(0.0, yaw)
    with pytest.raises(LimitError, match=rf"^{end} pose .* is not finite; nothing was moved$"):
        carry(arm, action)
    assert not arm.log


def test_an_arm_that_does_not_foresee_turns_the_shorter_way() -> None:
    arm = RecordingArm()
    executed = carry(arm, said(0.3 + 3 * math.pi, -3 * math.pi), 1).executed
    assert executed.pick.yaw == pytest.approx(0.3)
    assert executed.place.yaw == pytest.approx(0.0)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"handling": replace(SETTINGS.handling, carry_m_s=1.5)}, r"speed 1\.5 m/s is outside"),
        ({"handling": replace(SETTINGS.handling, travel_z_m=0.8)}, r"height 0\.800 m is outside"),
        ({"handling": replace(SETTINGS.handling, land_force_n=50.0)}, r"contact force 50 N is outside"),
        ({"limits": replace(SETTINGS.limits, max_step_m=0.25)}, r"a motion of 0\.\d+ m .* longer than 0\.25"),
    ],
)
def test_what_the_gate_would_refuse_on_the_way_is_refused_before_the_pick(
    change: dict[str, object], message: str
) -> None:
    arm = RecordingArm()
    arm.at = PICK.at_height(0.2)
    with pytest.raises(LimitError, match=message):
        carry(arm, PickPlace(PICK, PLACE), **change)
    assert not arm.log


class RefusingArm(RecordingArm):
    """Is refused once what would bring it, with something in its hand, to the place or down there."""

    def __init__(self, error: Exception, going_down: bool, width: float = 0.01) -> None:
        super().__init__(width)
        self.errors, self.going_down = [error], going_down

    def move_to(self, target: ToolPose, speed_m_s: float) -> ToolPose:
        self._refuse(not self.going_down and target.planar.distance(PLACE) < 0.01)
        return super().move_to(target, speed_m_s)

    def lower_until_contact(self, z_min: float, speed_m_s: float, force_n: float) -> ToolPose:
        self._refuse(self.going_down and self.at.planar.distance(PLACE) < 0.01)
        return super().lower_until_contact(z_min, speed_m_s, force_n)

    def _refuse(self, there: bool) -> None:
        if there and self.width == self._held and self.errors:
            raise self.errors.pop()


@pytest.mark.parametrize("error", [LimitError("too far"), ReachError("a reflex")])
@pytest.mark.parametrize("going_down", [False, True])
@pytest.mark.parametrize("tool", ["hand", "cup"])
def test_what_cannot_be_placed_is_put_back_where_it_was(
    error: Exception, going_down: bool, tool: str
) -> None:
    handling = SETTINGS.handling if tool == "hand" else replace(BLOCK_HANDLING, pick_z_m=0.02, place_z_m=0.02)
    arm = RefusingArm(error, going_down, 0.01 if tool == "hand" else SEALED_WIDTH_M)
    with pytest.raises(type(error), match=str(error)):
        carry(arm, PickPlace(PICK, PLACE), handling=handling)
    assert arm.at.planar == PICK
    assert arm.width == handling.release_width_m
    assert arm.log[arm.log.index("grasp") :].count(f"gripper {handling.release_width_m:.3f}") == 1


@pytest.mark.parametrize("error", [LimitError("too high"), ReachError("a reflex")])
@pytest.mark.parametrize("tool", ["hand", "cup"])
def test_what_cannot_be_lifted_is_put_down_where_it_is(error: Exception, tool: str) -> None:
    errors = [error]

    class Heavy(RecordingArm):
        def move_to(self, target: ToolPose, speed_m_s: float) -> ToolPose:
            if self.width == self._held and errors:
                raise errors.pop()
            return super().move_to(target, speed_m_s)

    handling = SETTINGS.handling if tool == "hand" else replace(BLOCK_HANDLING, pick_z_m=0.02, place_z_m=0.02)
    arm = Heavy(0.01 if tool == "hand" else SEALED_WIDTH_M)
    with pytest.raises(type(error), match=str(error)):
        carry(arm, PickPlace(PICK, PLACE), handling=handling)
    assert arm.width == handling.release_width_m
    assert arm.at.planar == PICK


def test_what_fails_once_it_was_let_go_moves_it_no_more() -> None:
    class Stuck(RecordingArm):
        def move_to(self, target: ToolPose, speed_m_s: float) -> ToolPose:
            if self.width == SETTINGS.handling.release_width_m:
                raise ReachError("a reflex")
            return super().move_to(target, speed_m_s)

    arm = Stuck()
    with pytest.raises(ReachError, match="a reflex"):
        carry(arm, PickPlace(PICK, PLACE))
    assert arm.at.planar == PLACE
