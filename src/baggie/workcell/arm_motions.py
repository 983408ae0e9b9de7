"""How the simulated arm moves, whatever tool it carries."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from baggie.geometry import FloatArray, ToolPose
from baggie.sim.arm_world import ArmWorld
from baggie.sim.kinematics import CONTROL_PERIOD_S, Kinematics, minimum_jerk
from baggie.sim.scene import HOME, Tool, arm_spec
from baggie.workcell.arm import ArmInfo

# FR3 joint velocity limits, rad/s (Franka's data sheet), of which motions use at most 80%.
JOINT_SPEED_LIMITS = 0.8 * np.array([2.62, 2.62, 2.62, 2.62, 5.26, 4.18, 5.26])
SETTLED_RAD_S = 0.02
SETTLE_TIMEOUT_S = 0.12
CLEAR_Z_M = 0.1  # above what lies on the table
PARK = np.array([0.0, -1.1, 0.0, -2.75, 0.0, 1.75, 0.7853])


class ArmMotions:
    """The FR3 in MuJoCo. Blocking motions advance the world's time."""

    info: ArmInfo
    period_s = CONTROL_PERIOD_S
    """Between two commands."""
    feel_period_s = CONTROL_PERIOD_S
    """Between two commands on the way down, and two looks at the wrist's force."""
    settled_rad = np.inf
    """How near every joint has to be to what was commanded; the hand's arm is at rest before it is there."""

    def __init__(self, world: ArmWorld, tool: Tool = "hand") -> None:
        self._world = world
        self._kinematics = Kinematics(arm_spec(tool).compile(), HOME)
        self._target, self._velocity = HOME, np.zeros(7)

    def pose(self) -> ToolPose:
        """Where the tool is now, by forward kinematics of the measured joints."""
        return self._kinematics.tool_pose(self._world.joints)

    def hand_pose(self) -> FloatArray:
        """`T_base_hand` `(4, 4)`, by forward kinematics of the measured joints."""
        return self._kinematics.hand_pose(self._world.joints)

    def foresee(self, way: Sequence[ToolPose]) -> float:
        """`ForeseeingArm.foresee`, by the model's kinematics."""
        return self._kinematics.turn_along(self._target, way)

    def lead_to(self, T_base_hand: FloatArray) -> FloatArray:
        """Put the hand at a pose `(4, 4)` at once, as a person would lead it there; the pose reached."""
        q = self._kinematics.reach(self._world.joints, T_base_hand)
        self._target = q
        self._world.put_joints(q)
        return self.hand_pose()

    def move_to(self, target: ToolPose, speed_m_s: float) -> ToolPose:
        """Move along a straight line, `Kinematics.line`, with minimum-jerk timing; returns once at rest."""
        self._follow(self._kinematics.line(self._target, target), speed_m_s)
        return self.pose()

    def lower_until_contact(self, z_min: float, speed_m_s: float, force_n: float) -> ToolPose:
        """Straight down with minimum-jerk timing until the wrist feels `force_n` more than at the start."""
        start = self._kinematics.tool_pose(self._target)
        if start.z > z_min:
            path = self._kinematics.line(self._target, replace(start, z=z_min))
            # Where a joint slows only a part of the way, the hand's own inertia would be felt as a contact.
            speed_m_s = min(speed_m_s, self._kinematics.even_speed(path, JOINT_SPEED_LIMITS))
            tare = self._world.upward_force
            felt = self._drive(
                path, speed_m_s, self.feel_period_s, lambda: self._world.upward_force - tare > force_n
            )
            if felt:
                self._stop_at_contact()
            self._rest()
        return self.pose()

    def park(self) -> ToolPose:
        """Fold back over the base, out of the camera's view, joint by joint together."""
        if np.allclose(self._target, PARK):
            return self.pose()
        here = self.pose()
        if here.z < CLEAR_Z_M:
            self.move_to(replace(here, z=CLEAR_Z_M), 0.5)
        self._follow(np.linspace(self._target, PARK, 10), self.info.max_speed_m_s)
        return self.pose()

    def stop(self) -> None:
        """Hold the joints where they are."""
        self._command(self._world.joints, np.zeros(7))

    def reset(self) -> None:
        """Take note that the world put the arm back home."""
        self._target = HOME

    def _stop_at_contact(self) -> None:
        """Stop now that something was touched. Here at once; what is soft takes up the rest."""

    def _follow(self, path: FloatArray, speed_m_s: float) -> None:
        """Follow joint positions `(N, 7)` with minimum-jerk timing and come to rest."""
        self._drive(path, speed_m_s, self.period_s)
        self._rest()

    def _drive(
        self,
        path: FloatArray,
        speed_m_s: float,
        period_s: float,
        until: Callable[[], bool] = lambda: False,
    ) -> bool:
        """Follow joint positions `(N, 7)` with minimum-jerk timing to the end or until `until`; whether it was that."""
        times = self._kinematics.shortest_times(path, speed_m_s, JOINT_SPEED_LIMITS)
        points = minimum_jerk(path, times, period_s)
        velocities = np.gradient(points, period_s, axis=0)
        for q, velocity in zip(points[1:], velocities[1:], strict=True):
            self._command(q, velocity)
            self._world.advance(period_s)
            if until():
                return True
        return False

    def _rest(self) -> None:
        """Stop at the last target and wait until the arm is there."""
        self._command(self._target, np.zeros(7))
        self._settle()

    def _settle(self) -> None:
        """Wait until the arm is at rest: a pose read earlier is not where it will be."""
        deadline = self._world.time + SETTLE_TIMEOUT_S
        while self._world.time < deadline:
            self._world.advance(self.period_s)
            off = np.abs(self._world.joints - self._target).max()
            if off < self.settled_rad and np.abs(self._world.joint_velocities).max() < SETTLED_RAD_S:
                break

    def _command(self, q: FloatArray, velocity: FloatArray) -> None:
        self._target, self._velocity = q, velocity
        self._world.set_joints(q, velocity)
