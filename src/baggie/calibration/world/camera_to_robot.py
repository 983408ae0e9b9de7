"""Where a camera is for the robot, without going through the world again: the two other calibrations composed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from baggie.calibration.files import CameraIdentity, broken, read_calibration, write_calibration
from baggie.calibration.pose import UncertainTransform, pose_from_yaml, uncertainty_to_yaml
from baggie.calibration.world.camera_to_world import CameraToWorld
from baggie.calibration.world.robot_to_world import RobotToWorld
from baggie.geometry import difference

_KIND = "camera-to-robot"


@dataclass(frozen=True)
class CameraToRobot:
    """The pose of a camera that stands still beside a robot."""

    camera: CameraIdentity
    pose: UncertainTransform
    """`T_base_camera`, metres; OpenCV's camera axes."""
    source: str
    """How it was found, in words."""

    def summary(self) -> dict[str, Any]:
        """What a person or a script wants to know, ready for JSON."""
        return {
            "T_base_camera": self.pose.transform.tolist(),
            "uncertainty": {"std_mm": self.pose.std_mm, "std_deg": self.pose.std_deg},
            "source": self.source,
        }

    def save(self, path: Path) -> None:
        """Write readable YAML. Raises `DataError` when it cannot be written."""
        content = {
            "camera": self.camera.to_yaml(),
            "frames": "base: x forward, y left, z up; camera: x right, y down, z ahead",
            "units": "metres, radians",
            **self.summary(),
            "uncertainty": uncertainty_to_yaml(self.pose),
        }
        write_calibration(path, _KIND, content)

    @classmethod
    def load(cls, path: Path, camera: CameraIdentity | None = None) -> CameraToRobot:
        """Read what `save` wrote; with `camera`, only a calibration of that one.

        Raises `DataError` for a missing or damaged file, `CalibrationError` for another camera or resolution.
        """
        content = read_calibration(path, _KIND)
        try:
            identity = CameraIdentity.from_yaml(content["camera"])
            result = cls(identity, pose_from_yaml(content, "T_base_camera"), str(content["source"]))
        except (KeyError, TypeError, ValueError) as error:
            raise broken(path, _KIND, error) from None
        if camera is not None:
            identity.check(camera, f"the calibration in {path}")
        return result


@dataclass(frozen=True)
class Comparison:
    """How far apart two calibrations of the same camera and robot are."""

    mm: float
    """Between the two positions of the camera."""
    deg: float
    """Between the two orientations."""
    agree: bool
    """Whether that is within what both state, with 95% probability, their errors independent."""


def compose(camera_to_world: CameraToWorld, robot_to_world: RobotToWorld) -> CameraToRobot:
    """`T_base_camera` = inverse(`T_world_base`) @ `T_world_camera`, the uncertainty of both in it.

    Both must have been made in the same world: the arm touched the target that the camera saw, in the same place.
    """
    pose = robot_to_world.pose.inverse() @ camera_to_world.pose
    return CameraToRobot(camera_to_world.camera, pose, "camera-to-world and robot-to-world composed")


def compare(a: CameraToRobot, b: CameraToRobot) -> Comparison:
    """Compare two calibrations. Raises `CalibrationError` when they are of different cameras or resolutions."""
    a.camera.check(b.camera, "the first calibration")
    metres, radians = difference(a.pose.transform, b.pose.transform)
    together = UncertainTransform(a.pose.transform, a.pose.covariance + b.pose.covariance)
    return Comparison(metres * 1000, float(np.degrees(radians)), together.holds(b.pose.transform))
