"""An arm of your own: copy this file as `own_arm.py`, and put your robot where the imaginary one is.

Shows the eight methods that everything above a workcell needs of an arm, and the check that they keep their promises.
It is longer than the other examples because it is the whole of it. Guide: docs/own-arm.md. In a workcell file, with the
copy beside it:

    arm: {kind: python, factory: "own_arm:open_arm", reach_m: 0.8}
    camera: 0

Moves the imaginary arm, and prints what the check found out:

    the arm keeps the contract
    force: not tried; lay a firm thing under the middle and give firm_height_m
    tool x: not tried; give tool_x, which says where it is seen to point
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from baggie.errors import ArmError, ReachError
from baggie.geometry import ToolPose, wrap_angle
from baggie.robot.arm import ArmInfo
from baggie.robot.contract import check_arm
from baggie.robot.kinematics import QUINTIC_PEAK, quintic
from baggie.robot.limits import GuardedArm
from baggie.workcell.workcell import WorkcellSettings

PERIOD_S = 0.02
TURN_RAD_S = 1.5
FINGERS_M_S = 0.1
PARK = ToolPose(0.2, -0.4, 0.35)


@dataclass
class ImaginaryRobot:
    """In the place of your robot's library: it takes Cartesian targets, and feels what stands on the table."""

    tool: ToolPose = PARK
    width_m: float = 0.08
    table_z: float = 0.0
    thing_m: float = 0.0
    """So wide is what is between its fingers."""
    hand_n: float = 7.0
    """So heavy is its hand, which its sensor feels as well."""

    def send(self, tool: ToolPose) -> None:
        """Go there, at once."""
        self.tool = replace(tool, z=max(tool.z, self.table_z))

    def send_fingers(self, width_m: float) -> None:
        self.width_m = max(width_m, self.thing_m)

    @property
    def upward_force_n(self) -> float:
        """What pushes the hand up is positive; its own weight pulls it down."""
        return (50.0 if self.tool.z <= self.table_z else 0.0) - self.hand_n


class OwnArm:
    """The eight methods of `baggie.robot.arm.Arm`, and `close`."""

    def __init__(
        self, robot: ImaginaryRobot, reach_m: float, sleep: Callable[[float], None] = time.sleep
    ) -> None:
        self.info = ArmInfo("imaginary arm", max_width_m=0.08, max_speed_m_s=1.5, max_force_n=40.0)
        self._robot, self._reach_m, self._sleep = robot, reach_m, sleep
        self._stopped = threading.Event()

    def pose(self) -> ToolPose:
        return self._robot.tool  # measured, not what was sent last

    def move_to(self, target: ToolPose, speed_m_s: float) -> ToolPose:
        self._check_reach(target)  # before anything moves
        self._go(target, speed_m_s)
        return self.pose()

    def lower_until_contact(self, z_min: float, speed_m_s: float, force_n: float) -> ToolPose:
        start = self.pose()
        if start.z > z_min:
            target = replace(start, z=z_min)
            self._check_reach(target)
            tare = self._robot.upward_force_n  # of the hand, and of what it holds
            self._go(target, speed_m_s, until=lambda: self._robot.upward_force_n - tare > force_n)
        return self.pose()

    def move_gripper(self, width_m: float) -> float:
        self._sleep(abs(width_m - self._robot.width_m) / FINGERS_M_S)
        self._robot.send_fingers(width_m)
        return self.gripper_width()

    def grasp(self, force_n: float) -> float:
        return self.move_gripper(0.0)  # yours squeezes with `force_n`

    def gripper_width(self) -> float:
        return self._robot.width_m

    def park(self) -> ToolPose:
        self.move_to(replace(self.pose(), z=max(self.pose().z, PARK.z)), 0.5)  # up first
        return self.move_to(PARK, 0.5)

    def stop(self) -> None:
        self._stopped.set()  # comes from another thread when the camera falls silent

    def close(self) -> None:
        """Let go of the robot; a workcell calls it."""

    def _check_reach(self, target: ToolPose) -> None:
        away = float(np.linalg.norm(target.xyz))
        if away > self._reach_m:
            raise ReachError(
                f"the arm reaches {self._reach_m:.2f} m, x {target.x:.3f}, y {target.y:.3f}, z {target.z:.3f} m is "
                f"{away:.2f} m away; choose a place nearer the robot's base"
            )

    def _go(self, target: ToolPose, speed_m_s: float, until: Callable[[], bool] = lambda: False) -> None:
        """A straight line from rest to rest, the shorter turn, nowhere faster than `speed_m_s`."""
        self._stopped.clear()
        start = self.pose()
        way, turn = target.xyz - start.xyz, wrap_angle(target.yaw - start.yaw)
        seconds = QUINTIC_PEAK * max(float(np.linalg.norm(way)) / speed_m_s, abs(turn) / TURN_RAD_S)
        for share in quintic(np.linspace(0, 1, int(np.ceil(seconds / PERIOD_S)) + 1)[1:]):
            if self._stopped.is_set():
                raise ArmError("the arm was stopped; nothing moves until it is told to again")
            x, y, z = (float(value) for value in start.xyz + share * way)
            self._robot.send(ToolPose(x, y, z, float(start.yaw + share * turn)))
            self._sleep(PERIOD_S)
            if until():
                return


def open_arm(reach_m: float = 0.85) -> OwnArm:
    """The factory that a workcell file names; what stands below `arm` there comes as arguments."""
    return OwnArm(ImaginaryRobot(), reach_m)


if __name__ == "__main__":
    found = check_arm(GuardedArm(open_arm(), WorkcellSettings().limits))
    print("the arm keeps the contract", *found, sep="\n")
