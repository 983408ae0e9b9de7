"""Where the object is, by its colour in a picture and a map from the picture to the robot."""

from __future__ import annotations

from baggie.calibration.image_to_robot.map import ImageToRobot
from baggie.collect.places import long_yaw
from baggie.geometry import PlanarPose
from baggie.types import Observation
from baggie.vision.color_mask import Detection, find_bag
from baggie.workcell.workcell import WorkcellSettings

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
    """The map at half the object's height, where its outline is; as it is where it knows one height only."""
    if not image_to_robot.height_aware:
        return image_to_robot
    return image_to_robot.at_height(settings.object_size_m[2] / 2)
