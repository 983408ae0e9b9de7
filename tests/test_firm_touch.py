"""An arm that feels nothing, feels the wrong way round, or points another way than it says is found out."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from baggie.commissioning.health import see_tool_x
from baggie.commissioning.image_to_robot import color_finder
from baggie.errors import LimitError, ReachError
from baggie.geometry import PlanarPose, ToolPose, wrap_angle
from baggie.robot.contract import PRESS_M, FeelingError, check_arm, check_tool_x, touch_firm
from baggie.robot.limits import GuardedArm
from baggie.workcell.workcell import WorkcellSettings
from helpers.fake_workcell import FakeArm, FakeCell
from helpers.recording_arm import RecordingArm

LIMITS = WorkcellSettings().limits
MIDDLE = PlanarPose(0.49, 0.0, 0.3)
HOVER_M = 0.15
N_PER_M = 30_000.0
"""With which the arm pushes on to where it was sent: of the simulated FR3."""


class FeelingArm(RecordingArm):
    """Stiff, over something at `top_z` that gives by a share `gives` of what is pressed into it; with a clock.

    What it takes for the force is `sign` times that, and `drift_n` more on the way down.
    """

    def __init__(
        self, top_z: float, *, gives: float = 0.0, sign: float = 1.0, drift_n: float = 0.0, fake: bool = False
    ) -> None:
        super().__init__(width=0.0)
        self.at = MIDDLE.at_height(HOVER_M)
        self.top_z, self.gives, self.sign, self.drift_n, self.fake = top_z, gives, sign, drift_n, fake
        self.time, self.lowest = 0.0, math.inf

    def clock(self) -> float:
        return self.time

    def move_to(self, target: ToolPose, speed_m_s: float) -> ToolPose:
        self._pass(math.dist(self.at.xyz, target.xyz), speed_m_s)
        return super().move_to(target, speed_m_s)

    def lower_until_contact(self, z_min: float, speed_m_s: float, force_n: float) -> ToolPose:
        sent = start = self.at.z
        self.speeds.append(speed_m_s)
        while sent > z_min:
            sent = max(sent - 0.0002, z_min)
            self._pass(0.0002, speed_m_s)
            pressed = N_PER_M * (1 - self.gives) * max(self.top_z - sent, 0.0)
            if self.sign * pressed + self.drift_n * (sent < start) > force_n:
                break
        self.lowest = min(self.lowest, sent)
        measured = max(sent, self.top_z - self.gives * max(self.top_z - sent, 0.0))
        self.at = replace(self.at, z=measured)
        return self.at

    def _pass(self, way_m: float, speed_m_s: float) -> None:
        self.time += 0.0 if self.fake else way_m / speed_m_s


def touched(arm: FeelingArm, height_m: float) -> str:
    return touch_firm(GuardedArm(arm, LIMITS), MIDDLE, height_m, arm.clock)


@given(st.floats(0.03, 0.115), st.floats(0.0, 0.012), st.sampled_from([0.0, 0.3]), st.booleans())
def test_an_arm_that_feels_passes_whatever_lies_there_and_wherever_its_fingers_end(
    height: float, beyond: float, gives: float, fake: bool
) -> None:
    arm = FeelingArm(height + beyond, gives=gives, fake=fake)
    assert touched(arm, height).startswith("felt 3 times at z")
    assert max(arm.speeds) <= 0.02
    assert arm.at.z == pytest.approx(HOVER_M), "it rises again"


@given(
    st.floats(0.03, 0.115),
    st.floats(0.0, 0.012),
    st.sampled_from([0.0, 0.5, 1.0]),
    st.sampled_from([0.0, -1.0]),
)
def test_one_that_feels_nothing_or_the_wrong_way_round_is_found_out_and_presses_little(
    height: float, beyond: float, gives: float, sign: float
) -> None:
    arm = FeelingArm(height + beyond, gives=gives, sign=sign)
    with pytest.raises(FeelingError, match="feels nothing, or its force has the wrong sign"):
        touched(arm, height)
    assert arm.lowest >= max(height - 2 * PRESS_M, LIMITS.z_min_m) - 1e-9
    if gives == 0:
        assert arm.lowest >= arm.top_z - PRESS_M - 1e-9, "not far below where it met the thing"
    assert arm.at.z == pytest.approx(HOVER_M), "it rises again"


def test_one_that_feels_something_in_the_air_is_found_out() -> None:
    with pytest.raises(FeelingError, match=r"ended at z 6[0-9] mm, in the air above the thing of 40 mm"):
        touched(FeelingArm(0.049, drift_n=9.0), 0.04)


def test_a_robot_that_stops_by_itself_does_not_feel() -> None:
    class Protected(FeelingArm):
        def lower_until_contact(self, z_min: float, speed_m_s: float, force_n: float) -> ToolPose:
            if z_min < self.top_z:
                raise ReachError("protective stop")
            return super().lower_until_contact(z_min, speed_m_s, force_n)

    with pytest.raises(FeelingError, match=r"stopped instead of feeling \(protective stop\)"):
        touched(Protected(0.049), 0.04)


@pytest.mark.parametrize("height", [0.0, 0.029, 0.13, math.nan])
def test_a_thing_too_low_or_too_high_is_refused_before_anything_moves(height: float) -> None:
    arm = FeelingArm(0.049)
    with pytest.raises(LimitError, match="expected a firm thing 30 to 118 mm high"):
        touched(arm, height)
    assert not arm.log


def test_the_contract_says_what_was_felt_and_what_was_not_tried() -> None:
    arm = FeelingArm(0.049)
    guarded = GuardedArm(arm, LIMITS)
    untried = check_arm(guarded)
    assert [line.split("; ")[0] for line in untried] == ["force: not tried", "tool x: not tried"]
    force, tool_x = check_arm(guarded, firm_height_m=0.04, tool_x=lambda: arm.at.yaw, clock=arm.clock)
    assert force == "force: felt 3 times at z 49 mm, on a thing of 40 mm"
    assert tool_x.startswith("tool x: at yaw 0 degrees it is seen to point at 0 and at yaw 45")


@pytest.mark.parametrize("sign", [0.0, -1.0])
def test_the_contract_is_broken_by_an_arm_that_does_not_feel(sign: float) -> None:
    arm = FeelingArm(0.049, sign=sign)
    with pytest.raises(AssertionError, match=r"a firm thing is felt: .* the wrong sign"):
        check_arm(GuardedArm(arm, LIMITS), firm_height_m=0.04, clock=arm.clock)


@pytest.mark.parametrize(
    "seen", [lambda yaw: yaw + math.pi, lambda yaw: -yaw, lambda yaw: yaw + math.pi / 2, lambda yaw: math.nan]
)
def test_the_contract_is_broken_by_a_tool_that_points_elsewhere(seen: Callable[[float], float]) -> None:
    arm = FeelingArm(0.0)
    with pytest.raises(AssertionError, match="the tool's x axis points where its yaw says"):
        check_arm(GuardedArm(arm, LIMITS), tool_x=lambda: seen(arm.at.yaw))


class TurnedArm(FakeArm):
    """Its yaw is `off` from what it says; turns the other way round with `sense` -1."""

    def __init__(self, off: float = 0.0, sense: float = 1.0, ends_rad: float = 10.0) -> None:
        super().__init__()
        self.off, self.sense, self.ends_rad = off, sense, ends_rad

    def at_most(self, speed_m_s: float) -> float:
        return speed_m_s

    def pose(self) -> ToolPose:
        return replace(self.tool, yaw=self.sense * (self.tool.yaw - self.off))

    def move_to(self, target: ToolPose, speed_m_s: float) -> ToolPose:
        yaw = wrap_angle(self.sense * target.yaw + self.off)
        if abs(yaw) > self.ends_rad:
            raise ReachError("the wrist ends there")
        super().move_to(replace(target, yaw=yaw), speed_m_s)
        return self.pose()


def seen_of(arm: TurnedArm, *, paddle: bool = True) -> float | None:
    cell = FakeCell()
    cell.arm, cell.paddle, cell.hidden = arm, paddle, True
    return see_tool_x(cell, color_finder(cell.settings.marker.color), 0.2)  # type: ignore[arg-type]


@pytest.mark.parametrize("off", [0.0, 0.7, math.pi / 2, 2.5, math.pi, -1.2])
def test_where_the_tools_x_axis_truly_points_is_seen_without_a_calibration(off: float) -> None:
    seen = seen_of(TurnedArm(off))
    assert seen is not None
    assert abs(wrap_angle(seen - off)) < math.radians(15)


def test_a_wrist_that_does_not_turn_to_both_sides_will_do() -> None:
    seen = seen_of(TurnedArm(math.pi, ends_rad=math.pi - 0.3))
    assert seen is not None
    assert abs(wrap_angle(seen - math.pi)) < math.radians(15)


def test_a_tool_that_turns_the_other_way_round_is_seen_to_point_elsewhere() -> None:
    seen = seen_of(TurnedArm(sense=-1.0))
    assert seen is not None
    with pytest.raises(FeelingError, match="turn what pose and move_to call yaw"):
        check_tool_x(seen, 0.0)


def test_without_a_marker_in_the_hand_nothing_is_seen() -> None:
    assert seen_of(TurnedArm(), paddle=False) is None
