"""An arm and a camera that exist in numbers only, and what a workcell file says of each.

arm: {kind: tray-arm, reach_m: 0.9}
camera: {kind: tray-camera}
"""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from baggie.cameras.camera import CameraEntry
from baggie.errors import ReachError
from baggie.geometry import ToolPose
from baggie.robot.arm import ArmEntry, ArmInfo
from baggie.types import Intrinsics, Observation

PARKED = ToolPose(0.3, 0.0, 0.4)


class TrayArm:
    """Is at once wherever it is sent."""

    def __init__(self, reach_m: float) -> None:
        self.info = ArmInfo("tray arm", max_width_m=0.08, max_speed_m_s=1.0, max_force_n=40.0)
        self._reach_m = reach_m
        self._at, self._width_m = PARKED, 0.08

    def pose(self) -> ToolPose:
        return self._at

    def move_to(self, target: ToolPose, speed_m_s: float) -> ToolPose:
        if np.linalg.norm(target.xyz) > self._reach_m:
            raise ReachError(f"expected a place within {self._reach_m:g} m of the base; choose a nearer one")
        self._at = target
        return self._at

    def lower_until_contact(self, z_min: float, speed_m_s: float, force_n: float) -> ToolPose:
        return self.move_to(replace(self._at, z=z_min), speed_m_s)

    def move_gripper(self, width_m: float) -> float:
        self._width_m = width_m
        return width_m

    def grasp(self, force_n: float) -> float:
        return self.move_gripper(0.0)

    def gripper_width(self) -> float:
        return self._width_m

    def park(self) -> ToolPose:
        return self.move_to(PARKED, 1.0)

    def stop(self) -> None:
        """It never moves for long."""


class TrayArmEntry(ArmEntry):
    """The section `arm` of a workcell file, by an entry point of the group `baggie.arms`."""

    kind: Literal["tray-arm"] = "tray-arm"
    about: ClassVar[str] = "one of numbers"
    reach_m: float = Field(0.9, gt=0)

    def open(self, folder: Path) -> TrayArm:
        return TrayArm(self.reach_m)


class TrayCamera:
    """Sees a grey table, with a sensor's noise."""

    name = "tray camera"
    size = (64, 48)
    intrinsics: Intrinsics | None = None

    def look(self) -> Observation:
        noisy = np.random.default_rng().normal(160.0, 2.0, (48, 64, 3))
        return Observation(np.clip(noisy, 0, 255).astype(np.uint8), None, self.intrinsics, time.time())


class TrayCameraEntry(CameraEntry):
    """The section `camera`, by an entry point of the group `baggie.cameras`."""

    kind: Literal["tray-camera"] = "tray-camera"
    about: ClassVar[str] = "one of numbers"

    def open(self, folder: Path) -> TrayCamera:
        return TrayCamera()
