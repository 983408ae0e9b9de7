"""What every arm must do, as a function, in the style of Gymnasium's `check_env`: run it against an arm of your own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from baggie.errors import LimitError, ReachError
from baggie.geometry import PlanarPose, ToolPose, wrap_angle
from baggie.workcell.arm import Arm
from baggie.workcell.limits import GuardedArm

POSITION_TOLERANCE_M = 0.002
YAW_TOLERANCE_RAD = 0.02
WIDTH_TOLERANCE_M = 0.003


def check_arm(
    arm: GuardedArm, speed_m_s: float = 0.5, between_z_m: tuple[float, float] = (0.15, 0.25)
) -> None:
    """Raise `AssertionError`, saying what is broken, unless motions end where they were sent and wild ones are refused.

    The arm really moves: above the middle of its workspace, between two heights, the lower one first, at `speed_m_s`,
    with nothing there and nothing in its hand.
    """
    assert isinstance(arm, Arm), "an arm has every method of `baggie.workcell.arm.Arm`"
    area = arm.limits.workspace
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
