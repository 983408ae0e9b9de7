"""What is known about a workcell's camera: the calibrations its file points to, each checked to be of this camera."""

from __future__ import annotations

from dataclasses import dataclass

from baggie.calibration.image_to_robot.map import ImageToRobot
from baggie.calibration.intrinsics.camera_calibration import CameraCalibration
from baggie.calibration.world.camera_to_robot import CameraToRobot


@dataclass(frozen=True)
class Calibrations:
    """Nothing here is needed to collect or to run a policy; what there is is used."""

    intrinsics: CameraCalibration | None = None
    image_to_robot: ImageToRobot | None = None
    camera_to_robot: CameraToRobot | None = None
