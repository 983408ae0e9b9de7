"""Any robot with LeRobot's interface as an arm: straight lines, planned from what is measured.

It feels no force; what it is behind tells a touch, coarsely. The gate in front of it is `limits.py`, as for every arm.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from baggie.errors import BaggieError, ReachError
from baggie.geometry import FloatArray, ToolPose
from baggie.sim.arm_model import load_arm_model
from baggie.sim.kinematics import Kinematics
from baggie.workcell.arm import ArmInfo
from baggie.workcell.lerobot_follow import ARRIVED_RAD, Clock, Follower
from baggie.workcell.lerobot_link import LeRobotLink, LeRobotRobot
from baggie.workcell.lerobot_settings import LeRobotSettings

MAX_SPEED_M_S = 1.2
TILTED_RAD = 0.35
OFF_LINE_M = 0.005
ARRIVED_M = 0.01


class LeRobotArm:
    """A robot that takes joint positions, with a hand of one joint.

    Connects at the first use. Raises `BaggieError` where settings, model and robot do not fit each other, `ArmError`
    when the robot does not answer or was stopped, `ReachError` when a motion cannot be done or something held it.
    """

    def __init__(self, robot: LeRobotRobot, settings: LeRobotSettings, clock: Clock = time) -> None:
        names = [joint.model_name for joint in settings.joints]
        model = load_arm_model(
            settings.model,
            names,
            tool=settings.tool,
            tool_xyz_m=settings.tool_xyz_m,
            tool_rpy_rad=tuple(np.deg2rad(settings.tool_rpy_deg)),
            base_z_m=settings.base_z_m,
        )
        self._range = np.array([model.joint(name).range for name in names])
        zero, gain = _scales(settings, self._range)
        self._park = zero + gain * np.array(settings.park)
        self._kinematics = Kinematics(model, self._park, names)
        self._check_park()
        readings = [*(joint.name for joint in settings.joints), settings.gripper]
        self._link = LeRobotLink(robot, readings, np.append(zero, 0.0), np.append(gain, 1.0))
        self._follower = Follower(self._link, self._kinematics, settings, clock)
        self._settings = settings
        self.info = ArmInfo(
            f"LeRobot's {robot.name}", settings.widths[-1][1], MAX_SPEED_M_S, settings.max_grip_n
        )

    def pose(self) -> ToolPose:
        """Where the tool is now, by forward kinematics of the measured joints."""
        return self._kinematics.tool_pose(self._joints())

    def hand_pose(self) -> FloatArray:
        """`T_base_hand` `(4, 4)`, by forward kinematics of the measured joints."""
        return self._kinematics.hand_pose(self._joints())

    def foresee(self, way: Sequence[ToolPose]) -> float:
        """`ForeseeingArm.foresee`, by the model's kinematics."""
        return self._kinematics.turn_along(self._begin(), way, self._line)

    def move_to(self, target: ToolPose, speed_m_s: float) -> ToolPose:
        """Along a straight line; turns the shorter way, if the wrist can."""
        self._follower.follow(self._plan(target), speed_m_s)
        reached = self.pose()
        off_m = float(np.linalg.norm(reached.xyz - target.xyz))
        if off_m > ARRIVED_M:
            raise ReachError(
                f"the arm ended {1000 * off_m:.0f} mm from where it was sent; something holds it, or the load in its "
                "hand is too heavy"
            )
        return reached

    def lower_until_contact(self, z_min: float, speed_m_s: float, force_n: float) -> ToolPose:
        """Straight down until the tool stays behind what it was sent by more than free joints would.

        Coarse: the force is what the settings' stiffness makes of the lag, and the speed no higher than `feel_m_s`.
        """
        start, s = self.pose(), self._settings
        if start.z <= z_min:
            return start
        speed = min(speed_m_s, s.feel_m_s)
        held_m = force_n / s.stiffness_n_m + s.lag_s * s.speed * speed

        def touched(sent: FloatArray, measured: FloatArray) -> bool:
            return self._kinematics.tool_pose(measured).z - self._kinematics.tool_pose(sent).z > held_m

        self._follower.follow(self._plan(replace(start, z=z_min)), speed, touched)
        return self.pose()

    def move_gripper(self, width_m: float) -> float:
        """Fingers to a width."""
        positions, widths = np.array(self._settings.widths).T
        self._follower.move_fingers(float(np.interp(width_m, widths, positions)))
        return self.gripper_width()

    def grasp(self, force_n: float) -> float:
        """Close until the fingers stand still, then leave their target so far inside that they squeeze."""
        closed = self._settings.widths[0][0]
        self._follower.move_fingers(closed, squeeze=force_n / self._settings.grip_n)
        return self.gripper_width()

    def gripper_width(self) -> float:
        """Metres between the fingers now."""
        positions, widths = np.array(self._settings.widths).T
        return float(np.interp(self._link.measured()[-1], positions, widths))

    def park(self) -> ToolPose:
        """Rise, then go joint by joint together to the parking position. It begins at any tilt."""
        q = self._joints()
        here = self._kinematics.tool_pose(q)
        if np.abs(q - self._park).max() < 2 * ARRIVED_RAD:
            return here
        if here.z < self._settings.clear_z_m and self._tilt(q) < TILTED_RAD:
            self._follower.follow(self._plan(replace(here, z=self._settings.clear_z_m)), MAX_SPEED_M_S)
            q = self._joints()
        self._follower.follow(np.linspace(q, self._park, 20), MAX_SPEED_M_S)
        return self.pose()

    def stop(self) -> None:
        """Send no more targets, from any thread: the joints rest at the last. The motion raises `StuckError`."""
        self._follower.stop()

    def close(self) -> None:
        """Let go of the robot. Most go limp then, unless their `disable_torque_on_disconnect` is false."""
        self._link.close()

    def _joints(self) -> FloatArray:
        return self._link.measured()[:-1]

    def _tilt(self, q: FloatArray) -> float:
        """Radians between the tool and straight down."""
        return float(np.arccos(np.clip(-self._kinematics.hand_pose(q)[2, 2], -1.0, 1.0)))

    def _check_park(self) -> None:
        tilt = self._tilt(self._park)
        if tilt > TILTED_RAD:
            raise BaggieError(
                f"expected a parking position with the tool pointing down, its model says that it is tilted by "
                f"{np.rad2deg(tilt):.0f} degrees; change park, or tool_rpy_deg where that is wrong"
            )

    def _plan(self, target: ToolPose) -> FloatArray:
        """The joint path `(N, J)` to `target`. Raises `ReachError` where the arm cannot follow it; nothing was sent."""
        return self._line(self._begin(), target)

    def _begin(self) -> FloatArray:
        """Where a straight line begins, `(J,)`. Raises `ReachError` where the tool does not point down."""
        q: FloatArray = np.clip(self._joints(), *self._range.T)
        if self._tilt(q) > TILTED_RAD:
            raise ReachError(
                f"the tool is tilted by {np.rad2deg(self._tilt(q)):.0f} degrees, straight lines begin pointing down; "
                "park the arm first"
            )
        return q

    def _line(self, q: FloatArray, target: ToolPose) -> FloatArray:
        """The joint path `(N, J)` from `q` `(J,)` to `target`. Raises `ReachError` where the arm cannot follow it."""
        path = self._kinematics.line(q, target)
        begin = self._kinematics.tool_pose(q).xyz
        shares = np.linspace(0, 1, len(path))[:, None]
        line = begin + shares * (target.xyz - begin)
        off = [
            float(np.linalg.norm(self._kinematics.tool_pose(p).xyz - at))
            for p, at in zip(path, line, strict=True)
        ]
        if max(off) > OFF_LINE_M:
            raise ReachError(
                f"the arm cannot keep to the straight line to x {target.x:.3f}, y {target.y:.3f}, z {target.z:.3f} m "
                f"(it would be {1000 * max(off):.0f} mm off); go there in two motions, or turn less"
            )
        return path


def _scales(settings: LeRobotSettings, ranges: FloatArray) -> tuple[FloatArray, FloatArray]:
    """`zero` and `gain`, `(J,)` each: a joint is at `zero + gain * reading` radians. `ranges`: `(J, 2)` radians."""
    normalized = settings.units == "normalized"
    middle, half = ranges.mean(axis=1), np.diff(ranges, axis=1)[:, 0] / 2
    zero = middle if normalized else np.zeros(len(ranges))
    unit = half / 100 if normalized else np.full(len(ranges), np.pi / 180)
    given = [joint.zero_deg for joint in settings.joints]
    zero = np.array([z if deg is None else np.deg2rad(deg) for z, deg in zip(zero, given, strict=True)])
    return zero, unit * [joint.sign for joint in settings.joints]
