"""What every arm must do, as a function, in the style of Gymnasium's `check_env`: run it against an arm of your own.

It also finds out whether an arm feels, on a firm thing of known height, and where its tool's x axis points. Where the
tool comes to rest does not tell: one that feels nothing rests on a hard thing, too, and presses. So it is sent a little
below the top again and again, and how long that takes is compared with as long a way through the air: an arm that feels
ends early, one that does not pushes on to the end.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from baggie.errors import ArmError, LimitError, ReachError
from baggie.geometry import PlanarPose, ToolPose, wrap_angle
from baggie.robot.arm import Arm
from baggie.robot.limits import GuardedArm

MIN_HEIGHT_M = 0.03
"""Of the firm thing: what an arm that feels nothing presses then is this, not the table."""
FORCE_N = 8.0
"""Asked for. Estimates of the force wander by 1 to 3 N."""
PRESS_M = 0.003
"""So far below where it met the thing the tool is sent at most. Firm is what gives way less under `FORCE_N`."""
NEAR_M_S = 0.02
"""On the way to the thing, in steps."""
SLOW_M_S = 0.005
STEP_M = 0.002
ABOVE_M = 0.01
"""The steps begin so high above where the fingertips could meet the thing."""
OFF_M = 0.004
"""How far off a height may be measured, and the arm be."""
HELD_M = 0.001
SANK_M = 0.0015
TOUCHES = 3
LONGEST_SHARE = 0.8
"""Of the time a touch may take of what as long a way through the air takes; half of both ways is air."""
SHORTEST_S = 0.5
"""What takes less in all is a fake, whose time says nothing."""
DIRECTION_OFF_RAD = math.radians(30)

_REMEDY = (
    "the arm feels nothing, or its force has the wrong sign (what pushes the hand up is positive); mend "
    "lower_until_contact before anything else is touched"
)


class FeelingError(ArmError):
    """An arm that does not feel as it must, or whose tool points another way than it says."""


def highest_m(arm: GuardedArm, hover_z_m: float) -> float:
    """The highest firm thing, metres, that fits under a tool at this height."""
    return hover_z_m - arm.limits.z_min_m - 2 * ABOVE_M


def touch_firm(arm: GuardedArm, at: PlanarPose, height_m: float, clock: Callable[[], float]) -> str:
    """Come down slowly on a firm thing that lies at `at`, with shut fingers, and rise again; what was found.

    `height_m`: of its top above the table. `clock`: seconds of the arm's own time. The tool begins and ends above the
    thing, where it is. It is sent at most `PRESS_M` below where it met the thing, twice that below the top, and never
    below `z_min_m`. The fingers may reach `z_min_m` beyond the tool. Raises `FeelingError` where the touch is not felt,
    or felt in the air; `LimitError` for a height of less than `MIN_HEIGHT_M`, or too high for where the tool is.
    """
    here, reach = arm.pose(), arm.limits.z_min_m
    highest = highest_m(arm, here.z)
    if not MIN_HEIGHT_M <= height_m <= highest + 1e-9:
        raise LimitError(
            f"expected a firm thing {1000 * MIN_HEIGHT_M:.0f} to {1000 * highest:.0f} mm high, got "
            f"{1000 * height_m:.0f} mm; nothing was moved"
        )
    arm.move_gripper(0.0)
    try:
        begin = arm.move_to(at.at_height(height_m + reach + ABOVE_M), NEAR_M_S)
        met = _meet(arm, begin, height_m)
        _check_ends_early(arm, met, clock)
    finally:
        arm.move_to(replace(here, x=at.x, y=at.y, yaw=at.yaw), NEAR_M_S)
    return f"felt {TOUCHES} times at z {1000 * met.z:.0f} mm, on a thing of {1000 * height_m:.0f} mm"


def _meet(arm: GuardedArm, begin: ToolPose, height_m: float) -> ToolPose:
    """Down in small steps until something stops the tool, so that nothing is pressed far; where."""
    lowest = max(height_m - PRESS_M, arm.limits.z_min_m)
    hangs = begin.z - (height_m + arm.limits.z_min_m + ABOVE_M)  # higher than it was sent
    target = begin.z - hangs
    while target > lowest:
        target = max(target - STEP_M, lowest)
        reached = _lower(arm, target, NEAR_M_S)
        if reached.z - target - hangs <= HELD_M:
            continue
        if reached.z > height_m + arm.limits.z_min_m + OFF_M:
            raise FeelingError(
                f"the way down ended at z {1000 * reached.z:.0f} mm, in the air above the thing of "
                f"{1000 * height_m:.0f} mm: its height is another, or the force is not compared with what it was "
                "before the way began, or has the wrong sign"
            )
        return reached
    raise FeelingError(
        f"the way down went on to z {1000 * lowest:.0f} mm, into the thing of {1000 * height_m:.0f} mm: it does not "
        f"lie under the hand, or gives way, or {_REMEDY}"
    )


def _check_ends_early(arm: GuardedArm, met: ToolPose, clock: Callable[[], float]) -> None:
    """Raise `FeelingError` unless what was met ends the way down each time, in good time and at the same place."""
    through_air = on_thing = 0.0
    for _ in range(TOUCHES):
        arm.move_to(replace(met, z=met.z + 3 * PRESS_M), NEAR_M_S)
        began = clock()
        _lower(arm, met.z + PRESS_M, SLOW_M_S)
        between = clock()
        reached = _lower(arm, max(met.z - PRESS_M, arm.limits.z_min_m), SLOW_M_S)
        through_air, on_thing = through_air + between - began, on_thing + clock() - between
        if reached.z < met.z - SANK_M:
            raise FeelingError(
                f"the thing was met at z {1000 * met.z:.0f} mm, and then pressed down to {1000 * reached.z:.0f} mm: "
                f"it is not firm, or {_REMEDY}"
            )
    if through_air > SHORTEST_S and on_thing > LONGEST_SHARE * through_air:
        raise FeelingError(
            f"the tool met the thing at z {1000 * met.z:.0f} mm and pushed on for as long as through the air "
            f"({on_thing:.1f} and {through_air:.1f} s): {_REMEDY}"
        )


def _lower(arm: GuardedArm, z_m: float, speed_m_s: float) -> ToolPose:
    try:
        return arm.lower_until_contact(z_m, speed_m_s, min(FORCE_N, arm.limits.max_contact_force_n))
    except ReachError as error:
        raise FeelingError(f"the robot stopped instead of feeling ({error}): {_REMEDY}") from None


def check_tool_x(seen_rad: float, yaw_rad: float) -> str:
    """What was found: raise `FeelingError` unless the tool's x axis is seen to point where its yaw says.

    Both are radians in the robot's base frame: 0 along x, away from the base, counterclockwise seen from above.
    """
    off = wrap_angle(seen_rad - yaw_rad)
    if not abs(off) <= DIRECTION_OFF_RAD:  # NaN is nowhere
        raise FeelingError(
            f"at yaw {_degrees(yaw_rad)} degrees the tool's x axis is seen to point at {_degrees(seen_rad)}, "
            f"{_degrees(abs(off))} off: turn what pose and move_to call yaw, or fix what is seen to the side where x "
            "points"
        )
    return f"at yaw {_degrees(yaw_rad)} degrees it is seen to point at {_degrees(seen_rad)}"


def _degrees(angle_rad: float) -> str:
    return f"{float(np.rint(np.degrees(wrap_angle(angle_rad)))) + 0.0:.0f}"  # no -0


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
    assert isinstance(arm, Arm), "an arm has every method of `baggie.robot.arm.Arm`"
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
