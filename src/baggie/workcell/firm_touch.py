"""Whether an arm feels what it touches, on a firm thing of known height; and where its tool's x axis points.

Where the tool comes to rest does not tell: one that feels nothing rests on a hard thing, too, and presses. So it is
sent a little below the top again and again, and how long that takes is compared with as long a way through the air: an
arm that feels ends early, one that does not pushes on to the end.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from baggie.errors import ArmError, LimitError, ReachError
from baggie.geometry import PlanarPose, ToolPose, wrap_angle
from baggie.workcell.limits import GuardedArm

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
