"""Where the object of a workcell is, by its colour in a picture and a map from the picture to the robot."""

from __future__ import annotations

import math

import numpy as np

from baggie.calibration.image_to_robot.map import ImageToRobot
from baggie.geometry import FloatArray, PlanarPose, wrap_angle
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


def long_yaw(image_to_robot: ImageToRobot, corners: FloatArray, yaw: float) -> float:
    """The angle of a long object's long side; radians in [-pi/2, pi/2).

    `corners` `(4, 2)`, pixels, in turn around it, tell which side is the long one; `yaw`, modulo a quarter turn, its
    angle. A gripper at this angle closes across the narrow side: at yaw 0 fingers open along y.
    """
    sides = np.roll(on_table := image_to_robot.to_robot(corners), -1, axis=0) - on_table
    x, y = sides[int(np.argmax(np.linalg.norm(sides[:2] - sides[2:], axis=1)))]
    quarters = round((math.atan2(y, x) - yaw) / (math.pi / 2))
    return wrap_angle(yaw + quarters * math.pi / 2, math.pi)
