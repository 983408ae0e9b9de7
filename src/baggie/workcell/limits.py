"""The one gate every motion passes: workspace, height, speed, force and squeeze, checked before the arm is told."""

from __future__ import annotations

import math
from dataclasses import dataclass

from baggie.errors import LimitError
from baggie.geometry import FloatArray, PlanarPose, Rectangle, ToolPose
from baggie.workcell.arm import Arm, ArmInfo, hand_pose


@dataclass(frozen=True)
class Limits:
    """What the tool may do. Robot base frame; metres, seconds, newtons."""

    workspace: Rectangle
    """Where the tool may be below `clearance_z_m`."""
    reach: Rectangle
    """Where it may be above."""
    z_min_m: float = 0.012
    """The lowest the tool may go: 12 mm keep a Franka hand's fingertips off the table."""
    z_max_m: float = 0.70
    clearance_z_m: float = 0.12
    max_speed_m_s: float = 1.2
    max_contact_force_n: float = 40.0
    """The most that lowering may press before it stops."""
    max_grasp_force_n: float = 30.0


class GuardedArm:
    """An arm behind the gate. Raises `LimitError` for whatever the limits forbid; then nothing was sent."""

    def __init__(self, arm: Arm, limits: Limits) -> None:
        self._arm = arm
        self.limits = limits
        self.info: ArmInfo = arm.info

    def check(self, pose: PlanarPose | ToolPose, name: str = "tool") -> None:
        """Raise `LimitError` unless the pose is allowed; a planar pose is one at table height."""
        limits = self.limits
        z = pose.z if isinstance(pose, ToolPose) else limits.z_min_m
        if not all(math.isfinite(value) for value in (pose.x, pose.y, z, pose.yaw)):
            raise LimitError(f"{name} pose {pose} is not finite; nothing was moved")
        if not limits.z_min_m - 1e-9 <= z <= limits.z_max_m:
            raise LimitError(
                f"{name} height {z:.3f} m is outside {limits.z_min_m:.3f}..{limits.z_max_m:.3f} m; nothing was moved"
            )
        area = limits.workspace if z < limits.clearance_z_m else limits.reach
        if not area.contains(pose.x, pose.y):
            raise LimitError(
                f"{name} position x {pose.x:.3f}, y {pose.y:.3f} m is outside the workspace ({area}); "
                "choose a place inside or widen the workspace in the workcell file"
            )

    def pose(self) -> ToolPose:
        """Where the tool is now."""
        return self._arm.pose()

    def hand_pose(self) -> FloatArray:
        """`T_base_hand` `(4, 4)`: the function `hand_pose` of the arm."""
        return hand_pose(self._arm)

    def move_to(self, target: ToolPose, speed_m_s: float) -> ToolPose:
        """`Arm.move_to`, if target and speed are allowed."""
        self.check(target)
        self._check_speed(speed_m_s)
        return self._arm.move_to(target, speed_m_s)

    def lower_until_contact(self, z_min: float, speed_m_s: float, force_n: float) -> ToolPose:
        """`Arm.lower_until_contact`, if height, speed and force are allowed."""
        here = self._arm.pose()
        self.check(ToolPose(here.x, here.y, z_min, here.yaw))
        self._check_speed(speed_m_s)
        self._check_at_most("contact force", force_n, self.limits.max_contact_force_n, "N")
        return self._arm.lower_until_contact(z_min, speed_m_s, force_n)

    def move_gripper(self, width_m: float) -> float:
        """`Arm.move_gripper`, if the gripper opens that wide."""
        if not 0.0 <= width_m <= self.info.max_width_m:
            raise LimitError(
                f"gripper width {width_m:.3f} m is outside 0..{self.info.max_width_m:.3f} m; nothing was moved"
            )
        return self._arm.move_gripper(width_m)

    def grasp(self, force_n: float) -> float:
        """`Arm.grasp`, if the gripper may squeeze that hard."""
        self._check_at_most(
            "grasp force", force_n, min(self.limits.max_grasp_force_n, self.info.max_force_n), "N"
        )
        return self._arm.grasp(force_n)

    def gripper_width(self) -> float:
        """Metres between the fingers now."""
        return self._arm.gripper_width()

    def park(self) -> ToolPose:
        """Move out of the camera's view. The parking pose is part of the arm's set-up, not a command."""
        return self._arm.park()

    def stop(self) -> None:
        """Stop moving, now."""
        self._arm.stop()

    def _check_speed(self, speed_m_s: float) -> None:
        self._check_at_most(
            "speed", speed_m_s, min(self.limits.max_speed_m_s, self.info.max_speed_m_s), "m/s"
        )

    @staticmethod
    def _check_at_most(name: str, value: float, highest: float, unit: str) -> None:
        if not 0.0 < value <= highest:
            raise LimitError(f"{name} {value:g} {unit} is outside 0..{highest:g} {unit}; nothing was moved")
