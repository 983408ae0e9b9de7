"""What every arm must do, as a function, in the style of Gymnasium's `check_env`: run it against an arm of your own."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from baggie.errors import LimitError, ReachError
from baggie.geometry import PlanarPose, ToolPose, wrap_angle
from baggie.workcell.arm import Arm
from baggie.workcell.firm_touch import FeelingError, check_tool_x, touch_firm
from baggie.workcell.limits import GuardedArm

POSITION_TOLERANCE_M = 0.002
YAW_TOLERANCE_RAD = 0.02
WIDTH_TOLERANCE_M = 0.003
TOOL_X_YAWS = (0.0, np.pi / 4)
"""Two, so that one that turns the wrong way shows, too."""


def check_arm(
    arm: GuardedArm,
    speed_m_s: float = 0.5,
    between_z_m: tuple[float, float] = (0.15, 0.25),
    *,
    firm_height_m: float | None = None,
    tool_x: Callable[[], float] | None = None,
    clock: Callable[[], float] = time.monotonic,
) -> list[str]:
    """Raise `AssertionError`, saying what is broken, unless an arm keeps the contract; what was found of the rest.

    Motions have to end where they were sent, and wild ones to be refused. The arm really moves: above the middle of its
    workspace, between two heights, the lower one first, at `speed_m_s`, with nothing in its hand and nothing there but,
    perhaps, a firm thing on the table.

    Args:
        arm: Behind the gate.
        speed_m_s: Of all motions but the touch, which is slower; less where arm or limits allow less.
        between_z_m: The two heights of the tool.
        firm_height_m: How high a firm thing is, metres (3 cm or more), that lies under the middle of the workspace: the
            tool comes down on it slowly, three times, and has to feel it. None leaves that out.
        tool_x: Asked with the arm at rest, at two yaws: where the tool's x axis is seen to point, radians in the base
            frame, 0 away from the robot's base. A person or a camera answers. None leaves that out.
        clock: Seconds of the arm's own time: another than the wall clock's where it is simulated.
    """
    assert isinstance(arm, Arm), "an arm has every method of `baggie.workcell.arm.Arm`"
    area, speed_m_s = arm.limits.workspace, arm.at_most(speed_m_s)
    center = PlanarPose((area.x_min + area.x_max) / 2, (area.y_min + area.y_max) / 2, 0.3)
    low_z, high_z = between_z_m
    target = center.at_height(high_z)
    reached = arm.move_to(target, speed_m_s)
    _check_there(reached, target, "move_to ends where it was sent")
    _check_there(arm.pose(), reached, "move_to returns the pose really reached")

    again = arm.move_to(replace(target, yaw=target.yaw + 4 * np.pi), speed_m_s)
    _check_there(again, target, "a yaw is taken modulo a turn")
    foreseen = arm.foresee([replace(target, yaw=4 * np.pi), target])
    assert abs(foreseen - 2 * target.yaw) < 2 * YAW_TOLERANCE_RAD, "foresee adds up the shorter turns"
    _check_there(arm.pose(), again, "foresee moves nothing")

    lowered = arm.lower_until_contact(low_z, speed_m_s, 20.0)
    _check_there(
        lowered, center.at_height(low_z), "lower_until_contact goes straight to z_min where nothing is"
    )

    widest = arm.info.max_width_m
    for asked in (0.4 * widest, widest):
        _check_width(arm.move_gripper(asked), asked, "move_gripper")
    _check_width(arm.grasp(10.0), 0.0, "grasp of nothing")
    _check_width(arm.gripper_width(), 0.0, "gripper_width after a grasp of nothing")

    before = arm.pose()
    for bad in (ToolPose(2.0, 0.0, 0.3), ToolPose(0.5, 0.0, -0.1), ToolPose(float("nan"), 0.0, 0.3)):
        _check_refused(partial(arm.move_to, bad, 0.2), f"move_to {bad}")
    _check_refused(lambda: arm.move_to(target, 100.0), "move_to at 100 m/s")
    _check_refused(lambda: arm.lower_until_contact(-0.1, 0.2, 10.0), "lower_until_contact below the table")
    _check_refused(lambda: arm.grasp(1e4), "grasp with 10 kN")
    _check_refused(lambda: arm.move_gripper(-0.01), "move_gripper to less than nothing")
    _check_there(arm.pose(), before, "what was refused moves nothing")
    return [
        _feeling(arm, center, firm_height_m, clock),
        _tool_x(arm, center.at_height(high_z), speed_m_s, tool_x),
    ]


def _feeling(arm: GuardedArm, at: PlanarPose, firm_height_m: float | None, clock: Callable[[], float]) -> str:
    if firm_height_m is None:
        return "force: not tried; lay a firm thing under the middle and give firm_height_m"
    try:
        return f"force: {touch_firm(arm, at, firm_height_m, clock)}"
    except FeelingError as error:
        raise AssertionError(f"a firm thing is felt: {error}") from None


def _tool_x(arm: GuardedArm, above: ToolPose, speed_m_s: float, tool_x: Callable[[], float] | None) -> str:
    if tool_x is None:
        return "tool x: not tried; give tool_x, which says where it is seen to point"
    found = []
    for yaw in TOOL_X_YAWS:
        arm.move_to(replace(above, yaw=yaw), speed_m_s)
        try:
            found.append(check_tool_x(tool_x(), yaw))
        except FeelingError as error:
            raise AssertionError(f"the tool's x axis points where its yaw says: {error}") from None
    return f"tool x: {' and '.join(found)}"


def _check_there(pose: ToolPose, expected: ToolPose, law: str) -> None:
    off_m = float(np.abs(pose.xyz - expected.xyz).max())
    off_rad = abs(wrap_angle(pose.yaw - expected.yaw))
    assert off_m < POSITION_TOLERANCE_M, f"{law}: {1000 * off_m:.1f} mm off"
    assert off_rad < YAW_TOLERANCE_RAD, f"{law}: {off_rad:.3f} rad off"


def _check_width(width_m: float, expected_m: float, name: str) -> None:
    off_m = abs(width_m - expected_m)
    assert off_m < WIDTH_TOLERANCE_M, f"{name}: {1000 * off_m:.1f} mm from {1000 * expected_m:.0f} mm"


def _check_refused(call: Callable[[], object], name: str) -> None:
    try:
        call()
    except (LimitError, ReachError):
        return
    raise AssertionError(f"{name} must be refused with LimitError or ReachError")
