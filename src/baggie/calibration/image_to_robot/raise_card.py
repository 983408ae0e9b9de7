"""A card lies on the table; the outline of an object that rests on it is seen higher up, and so somewhere else."""

from __future__ import annotations

from baggie.calibration.image_to_robot.map import ImageToRobot
from baggie.geometry import FloatArray


def raise_card(corners: FloatArray, image_to_robot: ImageToRobot, height_m: float) -> FloatArray:
    """Where the corners of a card on the table, `(N, 2)` pixels (u, v), would be seen `height_m` above it.

    Pixel -> robot on the table -> pixel at `height_m`: without the camera's place the two differ by up to
    `height_m * distance from under the camera / camera's height`, some millimetres. The pixels are of the map's own
    picture size (`ImageToRobot.for_size`). Raises `CalibrationError` where the map knows one height only.
    """
    on_table = image_to_robot.at_height(0.0).to_robot(corners)
    return image_to_robot.at_height(height_m).to_pixels(on_table)
