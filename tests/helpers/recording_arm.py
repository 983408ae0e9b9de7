"""An arm for tests that is nowhere, and a workcell for it."""

from __future__ import annotations

import math
from dataclasses import replace

from baggie.geometry import ToolPose
from baggie.robot.arm import ArmInfo
from baggie.workcell.workcell import Workcell


class RecordingArm:
    """Obeys whatever it is told and remembers it; holds something `width` wide."""

    info = ArmInfo("recorder", max_width_m=0.08, max_speed_m_s=2.0, max_force_n=70.0)

    def __init__(self, width: float = 0.01, floor_z: float = -math.inf) -> None:
        self.at = ToolPose(0.4, 0.0, 0.4)
        self.width, self._held, self._floor = 0.08, width, floor_z
        self.poses: list[ToolPose] = []
        self.speeds: list[float] = []
        self.log: list[str] = []

    def pose(self) -> ToolPose:
        return self.at

    def move_to(self, target: ToolPose, speed_m_s: float) -> ToolPose:
        self.at = target
        self.poses.append(target)
        self.speeds.append(speed_m_s)
        self.log.append(f"move {target.z:.3f}")
        return target

    def lower_until_contact(self, z_min: float, speed_m_s: float, force_n: float) -> ToolPose:
        self.speeds.append(speed_m_s)
        self.log.append("lower")
        self.at = replace(self.at, z=max(z_min, self._floor))
        self.poses.append(self.at)
        return self.at

    def move_gripper(self, width_m: float) -> float:
        self.log.append(f"gripper {width_m:.3f}")
        self.width = width_m
        return width_m

    def grasp(self, force_n: float) -> float:
        self.log.append("grasp")
        self.width = self._held
        return self.width

    def gripper_width(self) -> float:
        return self.width

    def park(self) -> ToolPose:
        return self.at

    def stop(self) -> None:
        self.log.append("stop")


class TimelessCell(Workcell):
    def clock(self) -> float:
        return 0.0
