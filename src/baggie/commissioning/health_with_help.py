"""What can be wrong with an arm that shows only when somebody lays something under the hand, or fixes something to it.

Checks as in `health.py`, and with a helper besides. One that raises `NotTriedError` found nothing out.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from baggie.commissioning.assistant import Helper
from baggie.commissioning.health import SLOW_M_S, high, middle
from baggie.commissioning.points import color_finder, marker_finder
from baggie.commissioning.printed import HAND_MARKER
from baggie.commissioning.tool_direction import first_of, see_tool_x
from baggie.errors import BaggieError
from baggie.geometry import PlanarPose
from baggie.vision.targets import Marker, parse_target
from baggie.workcell.firm_touch import MIN_HEIGHT_M, check_tool_x, highest_m, touch_firm
from baggie.workcell.workcell import Workcell


class NotTriedError(BaggieError):
    """Nobody did what the check needs."""


HelpedCheck = Callable[[Workcell, Helper], str]


def force(cell: Workcell, helper: Helper) -> str:
    """The arm feels a firm thing, with the right sign."""
    at = _go_above(cell)
    heights = (MIN_HEIGHT_M, highest_m(cell.arm, high(cell)))
    height = helper.lay_firm(heights, "lay a firm thing (a block of wood, a book) under the hand")
    if height is None:
        raise NotTriedError("nobody laid a firm thing under the hand: whether the arm feels is not known")
    try:
        return touch_firm(cell.arm, at, height, helper.clock)
    finally:
        helper.put_away()


def tool_x(cell: Workcell, helper: Helper) -> str:
    """The tool's x axis points where its yaw says."""
    _go_above(cell)
    marker = parse_target(HAND_MARKER)
    assert isinstance(marker, Marker)
    helper.hold(
        None,
        "fix the printed hand-marker or the coloured paddle in front of the fingertips, on the side where the tool's x "
        "axis points, facing up; nobody comes near the arm. Or leave it out",
    )
    try:
        find = first_of(marker_finder(marker), color_finder(cell.settings.marker.color))
        seen = see_tool_x(cell, find, high(cell))
        by = "by the marker in the hand"
        if seen is None:
            seen, by = _asked(cell, helper), "as somebody says"
        return f"{check_tool_x(seen, 0.0)}, {by}"
    finally:
        helper.put_away()
        cell.arm.park()


def _asked(cell: Workcell, helper: Helper) -> float:
    """Radians; somebody looks at the hand at yaw 0."""
    _go_above(cell)
    away = helper.confirm(
        "no marker is seen to move with the hand. It is at yaw 0 now: does the side where the tool's x axis is to be "
        "(its front, where a marker would be) point away from the robot's base?"
    )
    if away is None:
        raise NotTriedError(
            "no marker was seen to move with the hand, and nobody said where its x axis points"
        )
    return 0.0 if away else math.pi


def _go_above(cell: Workcell) -> PlanarPose:
    """Above the middle of the workspace, at yaw 0."""
    at = PlanarPose(*middle(cell))
    cell.arm.move_to(at.at_height(high(cell)), cell.arm.at_most(SLOW_M_S))
    return at


HELPED: Mapping[str, HelpedCheck] = {"force": force, "tool x": tool_x}
"""Moves the arm, slowly, and needs somebody."""
