"""Where the object is, by its colour in a picture and a map from the picture to the robot."""

from __future__ import annotations

import warnings

from baggie.calibration.image_to_robot.map import ImageToRobot
from baggie.collect.places import long_yaw
from baggie.errors import BaggieWarning
from baggie.geometry import PlanarPose
from baggie.types import Observation
from baggie.vision.color_mask import Detection, find_bag
from baggie.workcell.workcell import WorkcellSettings

NEAR_M = 0.005
"""From a plane so near what is seen at half a metre from under a camera 1 m up is 2 mm off, and that will do."""
LONG = 2
"""The symmetry of an object that is longer than wide."""


def detect(
    observation: Observation, image_to_robot: ImageToRobot, settings: WorkcellSettings
) -> tuple[Detection, PlanarPose] | None:
    """The object of a workcell's settings, in pixels and in the robot's base frame; None where none is in sight.

    `image_to_robot` is for pictures of this size. The yaw is modulo a quarter turn, a long object's modulo half a turn.
    """
    found = find_bag(observation.color, settings.object_color)
    if found is None:
        return None
    x, y = image_to_robot.to_robot(found.center)[0]
    yaw = image_to_robot.yaw_to_robot(found.center, found.yaw)
    if settings.object_symmetry == LONG:
        yaw = long_yaw(image_to_robot, found.corners, yaw)
    return found, PlanarPose(float(x), float(y), yaw)


def at_outline(image_to_robot: ImageToRobot, settings: WorkcellSettings) -> ImageToRobot:
    """The map at half the object's height, where the middle of what is seen of it is.

    As it is where it knows one height only, with a `BaggieWarning` where that is another.
    """
    middle_m = settings.object_size_m[2] / 2
    if image_to_robot.height_aware:
        return image_to_robot.at_height(middle_m)
    if abs(image_to_robot.height_m - middle_m) > NEAR_M:
        warnings.warn(
            f"the map from the picture to the robot is right {image_to_robot.height_m:g} m above the table only, the "
            f"middle of the object is {middle_m:g} m up: places are off by some millimetres; calibrate at two heights, "
            "or with --intrinsics",
            BaggieWarning,
            stacklevel=2,
        )
    return image_to_robot
