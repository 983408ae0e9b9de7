"""Where the tool's x axis points, seen by how a marker in the hand moves in the picture: no calibration is needed."""

from __future__ import annotations

import math

import numpy as np

from baggie.commissioning.points import Find
from baggie.errors import ReachError
from baggie.geometry import FloatArray, PlanarPose, rotation
from baggie.types import Image
from baggie.workcell.workcell import Workcell

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
        pixel = find(cell.camera.look().color)
        return [] if pixel is None else [np.array([*(pose.planar.xy - middle), pose.yaw, *pixel])]

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
