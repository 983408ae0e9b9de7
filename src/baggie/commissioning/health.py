"""What can be wrong with a workcell: one function a check, those that move nothing apart from those that do.

A check returns what it found. It raises `Doubt` for what a person should look at, `NotTriedError` where it found
nothing out, and any other `BaggieError` for what has to be mended first. Some need somebody who lays something under
the hand, or fixes something to it.
"""

from __future__ import annotations

import math
import shutil
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from baggie.commissioning.image_to_robot import Find, color_finder, marker_finder, marker_middle
from baggie.commissioning.session import Helper
from baggie.errors import ArmError, BaggieError, CameraError, ReachError
from baggie.geometry import FloatArray, PlanarPose, rotation
from baggie.options.values import HAND_MARKER
from baggie.robot.contract import MIN_HEIGHT_M, check_tool_x, highest_m, touch_firm
from baggie.types import Image
from baggie.vision.targets import ArucoMarker, parse_target
from baggie.workcell.workcell import Workcell

SLOW_M_S = 0.1
FEEL_M_S = 0.05
FEEL_N = 8.0
LIES_M = 0.008
"""Touched so much earlier than the lowest the tool may go, something lies there, or the table is higher than said."""
WIDTH_OFF_M = 0.005
DARK, BRIGHT = 40, 250
"""Levels, of 255: darker on the whole is too dark, brighter in all three colours is burnt out."""
BURNT_SHARE = 0.05
FREE_GB = 5.0
"""A night's recording, and more."""


class Doubt(BaggieError):
    """It may work, but a person should look."""


Check = Callable[[Workcell], str]


def pictures(cell: Workcell) -> str:
    """The camera gives new pictures."""
    began = time.monotonic()
    first, second = (cell.camera.look().color for _ in range(2))
    took_ms = 1000 * (time.monotonic() - began) / 2
    if np.array_equal(first, second):
        raise CameraError(
            f"{cell.camera.name} shows the same picture twice: it is frozen; unplug it and plug it in again"
        )
    width, height = cell.camera.size
    return f"{cell.camera.name}: {width} x {height}, a new picture in {took_ms:.0f} ms"


def light(cell: Workcell) -> str:
    """Neither too dark nor burnt out."""
    color = cell.camera.look().color
    mean, burnt = float(color.mean()), float((color >= BRIGHT).all(axis=2).mean())
    found = f"mean level {mean:.0f} of 255, {100 * burnt:.1f}% burnt out"
    if mean < DARK:
        raise Doubt(f"{found}: too dark; more light, or a longer exposure_ms")
    if burnt > BURNT_SHARE:
        raise Doubt(f"{found}; less light, or a shorter exposure_ms")
    return found


def arm_state(cell: Workcell) -> str:
    """The arm answers, and the tool is where it may be."""
    began = time.monotonic()
    pose, width = cell.arm.pose(), cell.arm.gripper_width()
    took_ms = 1000 * (time.monotonic() - began)
    found = (
        f"{cell.arm.info.name} answers in {took_ms:.0f} ms: tool at x {pose.x:.3f}, y {pose.y:.3f}, z {pose.z:.3f} m, "
        f"fingers {1000 * width:.0f} mm apart"
    )
    if not all(np.isfinite([pose.x, pose.y, pose.z, pose.yaw, width])):
        raise ArmError(f"{found}: not a pose; restart the arm")
    if pose.z < cell.arm.limits.z_min_m:
        raise Doubt(f"{found}: lower than it may go; raise it by hand")
    return found


def calibrations(cell: Workcell) -> str:
    """Which calibrations there are; open_workcell has checked that they are of this camera."""
    known = cell.calibrations
    there = [name for name in ("intrinsics", "image_to_robot", "camera_to_robot") if getattr(known, name)]
    if not there:
        raise Doubt("none; a real arm collects with one: baggie calibrate image-to-robot")
    return ", ".join(there)


def view(cell: Workcell) -> str:
    """The camera sees all of the workspace."""
    to_robot = cell.calibrations.image_to_robot
    if to_robot is None:
        raise Doubt("not known without image_to_robot")
    area = cell.settings.workspace
    corners = [(x, y) for x in (area.x_min, area.x_max) for y in (area.y_min, area.y_max)]
    pixels = to_robot.for_size(cell.camera.size).to_pixels(corners)
    outside = [
        f"x {x:.2f}, y {y:.2f} m"
        for (x, y), pixel in zip(corners, pixels, strict=True)
        if not ((pixel >= 0) & (pixel < cell.camera.size)).all()
    ]
    if outside:
        raise CameraError(
            f"the camera does not see the workspace's corner at {outside[0]}; turn it, or make the workspace smaller"
        )
    return f"all of the workspace ({area}) is in the picture"


def disk(cell: Workcell) -> str:
    """There is room for a recording."""
    free = shutil.disk_usage(Path.cwd()).free / 1e9
    if free < FREE_GB:
        raise Doubt(f"{free:.1f} GB free here; 300 attempts take about one")
    return f"{free:.0f} GB free here"


def gripper(cell: Workcell) -> str:
    """The fingers go where they are sent, and meet when nothing is between them."""
    widest = cell.arm.info.max_width_m
    for asked in (widest / 2, widest):
        reached = cell.arm.move_gripper(asked)
        if abs(reached - asked) > WIDTH_OFF_M:
            raise ArmError(
                f"fingers sent to {1000 * asked:.0f} mm are {1000 * reached:.0f} mm apart; home them"
            )
    closed = cell.arm.grasp(cell.settings.handling.grasp_force_n)
    cell.arm.move_gripper(widest)
    if closed > min(cell.settings.handling.empty_width_m, WIDTH_OFF_M):
        raise ArmError(
            f"closed on nothing the fingers are {1000 * closed:.1f} mm apart; home them, clean them"
        )
    return f"opens to {1000 * widest:.0f} mm, closes to {1000 * closed:.1f} mm"


def corners(cell: Workcell) -> str:
    """The arm gets everywhere above the workspace."""
    area, off = cell.settings.workspace, []
    here = cell.arm.pose()
    cell.arm.move_to(replace(here, z=max(here.z, high(cell))), cell.arm.at_most(SLOW_M_S))
    ring = [
        (area.x_min, area.y_min),
        (area.x_max, area.y_min),
        (area.x_max, area.y_max),
        (area.x_min, area.y_max),
    ]
    for x, y in [*ring, middle(cell)]:
        target = PlanarPose(x, y).at_height(high(cell))
        off.append(
            float(np.linalg.norm(cell.arm.move_to(target, cell.arm.at_most(SLOW_M_S)).xyz - target.xyz))
        )
    return f"four corners and the middle, at most {1000 * max(off):.1f} mm off"


def touch(cell: Workcell) -> str:
    """The table is where it is said to be, and nothing lies in the middle."""
    limits, lowest = cell.arm.limits, cell.settings.handling.pick_z_m
    x, y = middle(cell)
    cell.arm.move_to(PlanarPose(x, y).at_height(high(cell)), cell.arm.at_most(SLOW_M_S))
    reached = cell.arm.lower_until_contact(
        lowest, cell.arm.at_most(FEEL_M_S), min(FEEL_N, limits.max_contact_force_n)
    )
    cell.arm.move_to(replace(reached, z=high(cell)), cell.arm.at_most(SLOW_M_S))
    if reached.z > lowest + LIES_M:
        raise ArmError(
            f"something was touched at z {1000 * reached.z:.0f} mm, {1000 * (reached.z - lowest):.0f} mm too early; "
            "clear the middle of the table, or the table is higher than the robot's base"
        )
    return f"nothing touched down to {1000 * reached.z:.0f} mm above the table"


def park(cell: Workcell) -> str:
    """The arm gets out of the camera's way."""
    pose = cell.arm.park()
    return f"parked at x {pose.x:.2f}, y {pose.y:.2f}, z {pose.z:.2f} m"


def high(cell: Workcell) -> float:
    """Where the tool moves to and fro, metres: above whatever may lie on the table, and where every arm gets to."""
    return cell.settings.handling.travel_z_m


def middle(cell: Workcell) -> tuple[float, float]:
    """Of the workspace, metres."""
    area = cell.settings.workspace
    return (area.x_min + area.x_max) / 2, (area.y_min + area.y_max) / 2


STILL: Mapping[str, Check] = {
    "pictures": pictures,
    "light": light,
    "arm": arm_state,
    "calibrations": calibrations,
    "view": view,
    "disk": disk,
}
"""Moves nothing."""
MOVING: Mapping[str, Check] = {"gripper": gripper, "corners": corners, "touch": touch, "park": park}
"""Moves the arm, slowly, over the whole workspace."""


TURN_RAD = 0.6
"""To either side, where the wrist can."""
FIRST_YAWS = (0.0, math.pi / 2, -math.pi / 2)
"""The hand begins at the first of these where the marker is seen: the arm may cover it, wherever it truly is."""
SHARE = 0.2
"""Of the workspace's length and width, which the hand moves to either side."""
_SPEED_M_S = 0.1
_ENOUGH = 4
"""Of five places, along both axes."""
_SEEN_SHARE = 0.02
"""Of the picture's width: what moves less than this with the hand is not the marker in it."""
_ODD_SHARE = 0.25
"""Of its way, so far off may a marker be seen that moves along a plane."""


def first_of(*finds: Find) -> Find:
    """Finds what the first of these finds that finds something."""

    def find(image: Image) -> FloatArray | None:
        return next((at for one in finds if (at := one(image)) is not None), None)

    return find


def see_tool_x(cell: Workcell, find: Find, high_z_m: float) -> float | None:
    """Radians in the base frame: where the marker is from the tool at yaw 0, in truth.

    The hand moves over the middle of the workspace at a height, along x and y, and turns. None where no marker is seen
    to move with it.
    """
    area = cell.settings.workspace
    middle = np.array([area.x_min + area.x_max, area.y_min + area.y_max]) / 2
    dx, dy = SHARE * (area.x_max - area.x_min), SHARE * (area.y_max - area.y_min)

    def look_from(x: float, y: float, yaw: float) -> list[FloatArray]:
        target = PlanarPose(float(middle[0]) + x, float(middle[1]) + y, yaw).at_height(high_z_m)
        try:
            pose = cell.arm.move_to(target, cell.arm.at_most(_SPEED_M_S))
        except ReachError:
            return []
        found = find(cell.camera.look().color)
        if found is None:
            return []
        return [np.array([*(pose.planar.xy - middle), pose.yaw, *marker_middle(found)])]

    for yaw in FIRST_YAWS:
        moved = look_from(0.0, 0.0, yaw)
        if not moved:
            continue
        for x, y in ((dx, 0.0), (-dx, 0.0), (0.0, dy), (0.0, -dy)):
            moved += look_from(x, y, yaw)
        turned = look_from(0.0, 0.0, yaw + TURN_RAD) + look_from(0.0, 0.0, yaw - TURN_RAD)
        if len(moved) >= _ENOUGH and turned:
            return _direction(np.array(moved), np.array(turned), cell.camera.size[0])
    return None


def _direction(moved: FloatArray, turned: FloatArray, width_px: int) -> float | None:
    """From `(N, 5)` x, y, yaw of the tool and u, v of the marker: moved along at one yaw, and turned from it."""
    plane, pixels = np.c_[moved[:, :2], np.ones(len(moved))], moved[:, 3:]
    to_pixels, *_ = np.linalg.lstsq(plane, pixels, rcond=None)
    way_px = float(np.ptp(pixels, axis=0).max())
    off_px = float(np.linalg.norm(plane @ to_pixels - pixels, axis=1).max())
    if way_px < _SEEN_SHARE * width_px or off_px > _ODD_SHARE * way_px:
        return None
    # The marker at the turned hand, less where it would be without the turn, is (R - R0) times where it is in the hand.
    shifts = (turned[:, 3:] - to_pixels[2]) @ np.linalg.inv(to_pixels[:2]) - turned[:, :2]
    turns = [rotation(yaw) - rotation(moved[0, 2]) for yaw in turned[:, 2]]
    in_hand, *_ = np.linalg.lstsq(np.vstack(turns), shifts.ravel(), rcond=None)
    return math.atan2(in_hand[1], in_hand[0])


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
    assert isinstance(marker, ArucoMarker)
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
