"""The simulated arm as a workcell has it: how it moves, and its tools, the hand or a suction cup."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from baggie.errors import BaggieError
from baggie.geometry import FloatArray, ToolPose
from baggie.robot.arm import CLEAR_Z_M, ArmInfo
from baggie.robot.franka.models import HOME, PARK
from baggie.robot.kinematics import CONTROL_PERIOD_S, Kinematics, minimum_jerk
from baggie.robot.primitives import Handling
from baggie.sim.arm_world import MOVE_FORCE_N, ArmWorld, Fingers, Suction
from baggie.sim.scene import TIMESTEP_S, Tool, arm_spec
from baggie.sim.world import PERIOD_S, World

# FR3 joint velocity limits, rad/s (Franka's data sheet), of which motions use at most 80%.
JOINT_SPEED_LIMITS = 0.8 * np.array([2.62, 2.62, 2.62, 2.62, 5.26, 4.18, 5.26])
SETTLED_RAD_S = 0.02
SETTLE_TIMEOUT_S = 0.12


class ArmMotions:
    """The FR3 in MuJoCo. Blocking motions advance the world's time."""

    info: ArmInfo
    period_s = CONTROL_PERIOD_S
    """Between two commands."""
    feel_period_s = CONTROL_PERIOD_S
    """Between two commands on the way down, and two looks at the force on the tool."""
    looks_to_feel = 1
    """Looks in a row at which a force has to be there for the arm to feel it."""
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
        """Straight down with minimum-jerk timing until the arm feels `force_n` more than at the start."""
        start = self._kinematics.tool_pose(self._target)
        if start.z > z_min:
            path = self._kinematics.line(self._target, replace(start, z=z_min))
            # Where a joint slows only a part of the way, the hand's own inertia would be felt as a contact.
            speed_m_s = min(speed_m_s, self._kinematics.even_speed(path, JOINT_SPEED_LIMITS))
            if self._drive(path, speed_m_s, self.feel_period_s, self._feeling(force_n)):
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

    def _feeling(self, force_n: float) -> Callable[[], bool]:
        """What looks whether the tool is pushed up by `force_n` more than now, at `looks_to_feel` looks in a row."""
        tare = self._world.upward_force
        felt = deque[bool](maxlen=self.looks_to_feel)

        def look() -> bool:
            felt.append(self._world.upward_force - tare > force_n)
            return len(felt) == self.looks_to_feel and all(felt)

        return look

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


FINGER_SPEED_M_S = 0.05  # each; Franka's data sheet
SQUEEZE_S = 0.4
"""So long at most cloth gives way between the fingers,"""
SQUEEZED_M = 0.0002
"""which are done where they close by less than this"""
SQUEEZED_S = 4 * CONTROL_PERIOD_S
"""in so long."""
FINGER_SETTLE_S = 0.1
FEELS_N = 0.5
"""Contacts are added up, without a sensor's noise."""


class SimulatedArm(ArmMotions):
    """The FR3 with its hand. Raises `BaggieError` for a world whose arm carries another tool."""

    feel_period_s = CONTROL_PERIOD_S / 2
    looks_to_feel = 3  # squeezed cloth chatters

    def __init__(self, world: World) -> None:
        super().__init__(world)
        self.info = ArmInfo(
            "simulated FR3", max_width_m=0.08, max_speed_m_s=1.7, max_force_n=70.0, feels_n=FEELS_N
        )
        self._fingers = _fingers(world)

    def move_gripper(self, width_m: float) -> float:
        """Fingers to a width at their usual speed."""
        if abs(width_m - self._fingers.width) < 0.001:
            return self._fingers.width
        self._fingers.set_force(MOVE_FORCE_N)
        current = self._fingers.width / 2
        steps = max(round(abs(width_m / 2 - current) / FINGER_SPEED_M_S / CONTROL_PERIOD_S), 1)
        for opening in np.linspace(current, width_m / 2, steps + 1)[1:]:
            self._fingers.set_opening(opening)
            self._world.advance(CONTROL_PERIOD_S)
        self._world.advance(FINGER_SETTLE_S)
        return self._fingers.width

    def grasp(self, force_n: float) -> float:
        """Close, then squeeze with `force_n` a finger; cloth needs a moment to give way."""
        self._fingers.set_force(force_n)
        current = self._fingers.width / 2
        for opening in np.arange(current, 0.0, -FINGER_SPEED_M_S * CONTROL_PERIOD_S):
            self._fingers.set_opening(opening)
            self._world.advance(CONTROL_PERIOD_S)
        self._fingers.set_opening(0.0)
        for _ in range(round(SQUEEZE_S / SQUEEZED_S)):
            before = self._fingers.width
            self._world.advance(SQUEEZED_S)
            if before - self._fingers.width < SQUEEZED_M:
                break
        return self._fingers.width

    def gripper_width(self) -> float:
        """Metres between the fingers now."""
        return self._fingers.width

    def enter(self, world: World) -> None:
        """Work in another world from now on, where the arm is at home."""
        self._fingers = _fingers(world)
        self._world = world
        self.reset()


def _fingers(world: World) -> Fingers:
    if world.fingers is None:
        raise BaggieError("expected an arm with a two-finger hand, got one with another tool; use SuctionArm")
    return world.fingers


SEALED_WIDTH_M = 0.01
"""The "width" of a cup that holds something; one that holds nothing has none."""
SEAL_S = 0.04  # for the vacuum to build up, and to break down
BRAKE_STEPS = 6  # of `feel_period_s`: within what the cup gives way

BLOCK_HANDLING = Handling(
    travel_z_m=0.18,  # a carried block passes over a pyramid of three
    approach_z_m=0.14,
    pick_z_m=0.0,
    touch_force_n=2.5,
    land_force_n=2.5,
    place_z_m=0.0,
    open_width_m=0.0,
    release_width_m=0.0,
    empty_width_m=SEALED_WIDTH_M / 2,
    feel_m_s=0.35,
    carry_m_s=1.0,
)
"""Of blocks of about 4 cm, stacked up to three high, by a suction cup."""


class SuctionArm(ArmMotions):
    """The FR3 with a suction cup: to grasp is to switch it on, to move the gripper is to switch it off.

    Raises `BaggieError` for a world whose arm carries another tool.
    """

    period_s = PERIOD_S  # commands in longer steps would shake the hand, and heavy blocks off it
    feel_period_s = TIMESTEP_S  # a millimetre at feeling speed
    settled_rad = 0.0015

    def __init__(self, world: World) -> None:
        super().__init__(world, "cup")
        self.info = ArmInfo(
            "simulated FR3, suction cup",
            max_width_m=0.0,
            max_speed_m_s=1.7,
            max_force_n=70.0,
            tool_symmetry=0,
        )
        self._suction = _suction(world)

    def _stop_at_contact(self) -> None:
        """Brake evenly while the sprung cup gives way; stopping dead would shake the arm."""
        velocity = self._velocity
        for share in np.linspace(1.0, 0.0, BRAKE_STEPS + 1)[1:]:
            self._command(self._target + self.feel_period_s * share * velocity, share * velocity)
            self._world.advance(self.feel_period_s)

    def move_gripper(self, width_m: float) -> float:
        """Let go, whatever the width."""
        if self._suction.sealed:
            self._suction.off()
            self._world.advance(SEAL_S)
        return self.gripper_width()

    def grasp(self, force_n: float) -> float:
        """Switch on; the vacuum is as it is, whatever the force."""
        self._suction.on()
        if self._suction.sealed:
            self._world.advance(SEAL_S)
        return self.gripper_width()

    def gripper_width(self) -> float:
        """`SEALED_WIDTH_M` while something is held, else 0."""
        return SEALED_WIDTH_M if self._suction.sealed else 0.0

    def enter(self, world: World) -> None:
        """Work in another world from now on, where the arm is at home."""
        self._suction = _suction(world)
        self._world = world
        self.reset()


def _suction(world: World) -> Suction:
    if world.suction is None:
        raise BaggieError("expected an arm with a suction cup, got one with another tool; use SimulatedArm")
    return world.suction
