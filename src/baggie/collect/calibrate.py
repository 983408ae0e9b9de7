"""Calibrate a cell before collecting in it: take the arm to known positions, at two heights, and look."""

from __future__ import annotations

from baggie import seeds
from baggie.calibration.homography import ImageToRobot, offset_to_height
from baggie.collect.cell import CollectorCell
from baggie.collect.places import MARGIN_M
from baggie.collect.points import collect_points, grid

MARKER_HEIGHTS_M = (0.07, 0.20)
"""Above the table while it is looked at. The lower, just clear of a bag that lies there, is the map's; the
other only tells how things shift with height."""


def calibrate(cell: CollectorCell, seed: int) -> ImageToRobot:
    """Fit the map from the picture to the robot, right at half the object's height, where its outline is.

    The same cell and seed give the same map. Raises `BaggieError` when the marker is seen too seldom, or not
    where the arm says it is.
    """
    cell.reset((seeds.CALIBRATION, seed))
    cell.show_paddle(True)
    try:
        low, high = (_fit_plane(cell, height) for height in MARKER_HEIGHTS_M)
    finally:
        cell.show_paddle(False)
    return low.with_offset(offset_to_height(low, high, cell.settings.object_size_m[2] / 2))


def _fit_plane(cell: CollectorCell, height_m: float) -> ImageToRobot:
    settings = cell.settings
    positions = grid(settings.workspace, MARGIN_M)
    pixels, robot = collect_points(cell.arm, cell.camera, positions, height_m, settings.marker)
    return ImageToRobot.fit(pixels, robot, cell.camera.size, height_m)
