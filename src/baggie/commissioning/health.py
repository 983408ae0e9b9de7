"""What can be wrong with a workcell: one function a check, those that move nothing apart from those that do.

A check returns what it found. It raises `Doubt` for what a person should look at, and any other `BaggieError` for what
has to be mended first.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from baggie.errors import ArmError, BaggieError, CameraError
from baggie.geometry import PlanarPose
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
