"""Calibrate a cell before collecting in it: take the arm to known positions, at two heights, and look."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from baggie import seeds
from baggie.calibration.files import REFERENCE_FILE
from baggie.calibration.image_to_robot.map import ImageToRobot
from baggie.calibration.image_to_robot.projection import MIN_POINTS_TWO_HEIGHTS
from baggie.collect.machine import MARGIN_M
from baggie.commissioning.image_to_robot import color_finder, grid, visit
from baggie.errors import BaggieError
from baggie.geometry import transform_points
from baggie.pictures import write_picture
from baggie.workcell.workcell import Workcell, at_outline

MARKER_HEIGHTS_M = (0.07, 0.17)
"""Above the table while it is looked at; the lower, just clear of a bag that lies there, unless that is higher."""
_CLEAR_M = 0.04
"""Between the marker and what lies there."""


def calibrate_into(folder: Path, cell: Workcell, seed: int, watched: bool = True) -> None:
    """Calibrate a cell and keep all that belongs to it: the colour-mask policy with its map, and, where the cell is
    `watched`, the picture that a watch compares with.

    Raises `BaggieError` as `calibrate` does.
    """
    from baggie.policies.baselines import ColorMaskPolicy  # noqa: PLC0415 -- workers do without torch

    image_to_robot = calibrate(cell, seed)
    if watched:
        write_picture(folder / REFERENCE_FILE, cell.look().color)
    ColorMaskPolicy(image_to_robot, cell.settings.object_color).save(folder)  # last: where it is, all is


def calibrate(cell: Workcell, seed: int) -> ImageToRobot:
    """Fit the map from the picture to the robot, right at half the object's height, where its outline is.

    The workcell's own map where it has one; else the same cell and seed give the same map. Raises `BaggieError` when
    the marker is seen too seldom, or not where the arm says it is.
    """
    settings, camera = cell.settings, cell.camera
    known = cell.calibrations.image_to_robot
    if known is not None:
        return at_outline(known, settings)
    find = color_finder(settings.marker.color)
    in_hand = np.array([settings.marker.offset_m, 0.0, 0.0])
    cell.reset((seeds.CALIBRATION, seed))
    cell.show_paddle(True)
    low, high = MARKER_HEIGHTS_M
    raised = max(0.0, settings.object_size_m[2] + _CLEAR_M - low)
    places = grid(settings.workspace, MARGIN_M, (low + raised, high + raised))
    pixels, robot = [], []
    try:
        for _, T_base_hand, observation in visit(cell.arm, camera, places, in_hand):
            pixel = find(observation.color)
            if pixel is not None:
                pixels.append(pixel)
                robot.append(transform_points(T_base_hand, in_hand)[0])
    finally:
        cell.show_paddle(False)
    if len(pixels) < MIN_POINTS_TWO_HEIGHTS:
        raise BaggieError(
            f"expected to see the marker in most of {len(places)} places of the workspace, {settings.workspace}, "
            f"saw it in {len(pixels)}: see that the hand has it, or make the workspace smaller, within the arm's reach "
            "and the camera's view"
        )
    return ImageToRobot.fit(
        np.array(pixels),
        np.array(robot),
        cell.calibrated_camera,
        intrinsics=camera.intrinsics,
        height_m=settings.object_size_m[2] / 2,
    )
