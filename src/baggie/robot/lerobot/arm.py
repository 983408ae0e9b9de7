"""Any robot with LeRobot's interface as an arm: straight lines, planned from what is measured.

It feels no force; what it is behind tells a touch, coarsely. The gate in front of it is `limits.py`, as for every arm.

Joint paths and finger motions as what a LeRobot robot takes: small position targets, at a steady rate.

Such robots follow late and, under their own weight, a little short. So what is sent runs ahead of what is measured; how
far tells when something holds them.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from baggie.errors import BaggieError, ReachError, StuckError
from baggie.geometry import FloatArray, ToolPose
from baggie.robot.arm import ArmInfo
from baggie.robot.kinematics import Kinematics, load_arm_model, minimum_jerk
from baggie.robot.lerobot.link import LeRobotLink, LeRobotRobot, LeRobotSettings

ARRIVED_RAD = 0.002
ARRIVE_S = 2.0
CATCH_UP_S = 0.15
"""In about this time what a joint is short of its goal is sent on top."""
FINGERS_PER_S = 60.0
STILL = 0.3
STILL_S = 0.25
"""Fingers that moved by less than `STILL` units in this time stand still."""

Touched = Callable[[FloatArray, FloatArray], bool]
"""Whether joints sent to the first `(J,)` and measured at the second touch something."""


class Clock(Protocol):
    """The module `time`, or a clock that does not wait."""

    def monotonic(self) -> float:
        """Seconds."""
        ...

    def sleep(self, seconds: float, /) -> None:
        """Wait."""
        ...


class Follower:
    """Moves joints and fingers. No step between two targets is larger than `max_step`, `(J,)` radians."""

    def __init__(
        self, link: LeRobotLink, kinematics: Kinematics, settings: LeRobotSettings, clock: Clock
    ) -> None:
        self._link, self._kinematics, self._settings, self._clock = link, kinematics, settings, clock
        self._period_s = 1 / settings.rate_hz
        self._joint_speeds = np.full(
            len(settings.joints), np.deg2rad(settings.joint_speed_deg_s) * settings.speed
        )
        self._max_lag = np.deg2rad(settings.max_lag_deg)
        self._due_s = 0.0
        self._stopped = threading.Event()
        self.max_step = self._joint_speeds * self._period_s

    def follow(self, path: FloatArray, speed_m_s: float, touched: Touched | None = None) -> None:
        """Follow a joint path `(N, J)` from where the joints are, until its end or a touch, and come to rest.

        Raises `ReachError` when a joint stays too far behind, `StuckError` when it was stopped.
        """
        self._stopped.clear()
        times = self._kinematics.shortest_times(path, self._settings.speed * speed_m_s, self._joint_speeds)
        points = minimum_jerk(path, times, self._period_s)
        # What is sent begins at what was sent last: further than measured by what the arm's own weight needs.
        sag = self._target()[:-1] - path[0]
        for q in points[1:]:
            self._send(q + sag)
            measured = self._joints()
            if touched and touched(q, measured):
                self._release(measured + sag)
                return
            self._check_held(q, measured, sag)
        self._arrive(points[-1], sag, touched)

    def move_fingers(self, goal: float, squeeze: float = np.inf) -> None:
        """Move the fingers to `goal`, or until something holds them: then leave their target `squeeze` units inside."""
        self._stopped.clear()
        step, window = FINGERS_PER_S * self._period_s, round(STILL_S / self._period_s) + 1
        lead = max(
            squeeze, 1.5 * FINGERS_PER_S * self._settings.lag_s
        )  # no harder than this while they find out
        seen = [self._link.measured()[-1]]
        for _ in range(round(2 * abs(goal - seen[0]) / step) + 4 * window):
            target, at = self._target(), seen[-1]
            still = len(seen) > window and abs(at - seen[-window]) < STILL
            ahead = np.clip(goal - at, *((-squeeze, squeeze) if still else (-lead, lead)))
            if still and abs(target[-1] - at - ahead) < STILL:
                return
            self._send(target[:-1], target[-1] + np.clip(at + ahead - target[-1], -step, step))
            seen.append(self._link.measured()[-1])

    def stop(self) -> None:
        """Send no more targets, from any thread."""
        self._stopped.set()

    def _joints(self) -> FloatArray:
        return self._link.measured()[:-1]

    def _arrive(self, goal: FloatArray, sag: FloatArray, touched: Touched | None) -> None:
        """Send what the joints are short of `goal` on top, little by little, until they are there or it is no use."""
        share = min(self._period_s / CATCH_UP_S, 1.0)
        measured = before = self._joints()
        for _ in range(round(ARRIVE_S / self._period_s)):
            short = goal - measured
            if max(np.abs(short).max(), np.abs(measured - before).max()) < ARRIVED_RAD:
                return
            more = np.clip(share * short, -self.max_step, self.max_step)
            on_top = np.clip(self._target()[:-1] + more - goal - sag, -self._max_lag, self._max_lag)
            self._send(goal + sag + on_top)
            before, measured = measured, self._joints()
            if touched and touched(goal + on_top, measured):
                self._release(measured + sag)
                return

    def _check_held(self, sent: FloatArray, measured: FloatArray, sag: FloatArray) -> None:
        lag = np.abs(sent - measured)
        if lag.max() <= self._max_lag:
            return
        name = self._settings.joints[int(lag.argmax())].name
        self._release(measured + sag)
        raise ReachError(
            f"{name} was {np.rad2deg(lag.max()):.0f} degrees behind where it was sent, so the arm stopped there: "
            "something is in its way, or it is too slow; lower speed, or raise max_lag_deg"
        )

    def _release(self, goal: FloatArray) -> None:
        """Take the targets back to where the arm is, in steps, so that it presses no more."""
        away = goal - self._target()[:-1]
        steps = int(np.ceil((np.abs(away) / self.max_step).max()))
        for left in range(steps - 1, -1, -1):
            self._send(goal - left / steps * away)

    def _target(self) -> FloatArray:
        """What was sent last, `(J + 1,)`; before anything was, where everything is."""
        return self._link.measured() if self._link.sent is None else self._link.sent

    def _send(self, joints: FloatArray, fingers: float | None = None) -> None:
        """Send joints `(J,)`, the fingers as they were unless given, as soon as the next target is due."""
        self._clock.sleep(max(self._due_s - self._clock.monotonic(), 0.0))
        if self._stopped.is_set():
            raise StuckError("the arm was stopped; nothing moves until it is told to again")
        self._link.send(np.append(joints, self._target()[-1] if fingers is None else fingers))
        self._due_s = max(self._due_s, self._clock.monotonic()) + self._period_s


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
