"""The arm of a simulated world, as a Franka robot is: commanded each millisecond, with Franka's words for its state.

It has what `franky-sim`'s server calls on a robot. Commands become targets of the world's own position servos; physics
runs in steps of several milliseconds, so that a world with a soft bag in it keeps up. The hand moves as Franka's own
controller leads it: towards a width, at a speed, with a force.
"""

from __future__ import annotations

import statistics
from collections import deque
from collections.abc import Callable

import mujoco
import numpy as np
from franky_sim.franka_robot_state import FrankaRobotState

from baggie.geometry import FloatArray
from baggie.robot.franka.link import T_FLANGE_TOOL
from baggie.robot.franka.models import HOME
from baggie.robot.kinematics import Kinematics
from baggie.sim.arm_world import HAND, OPEN_M, ArmWorld, Fingers, upward_touch
from baggie.sim.scene import ARM, arm_spec

Difference = Callable[[FloatArray, FloatArray], FloatArray]


class CommandState:
    """The last command and its derivatives by finite differences: a client's plans go on from there."""

    def __init__(self, value: FloatArray, difference: Difference = np.subtract) -> None:
        """`difference(after, before)`: what leads from one value to another."""
        self._difference = difference
        self.rest(value)

    def rest(self, value: FloatArray) -> None:
        """Stand still here."""
        self.value = value
        self.velocity = np.zeros_like(self._difference(value, value))
        self.acceleration = self.velocity

    def take(self, value: FloatArray, seconds: float) -> None:
        """Go on to the next value, which comes `seconds` after the last."""
        velocity = self._difference(value, self.value) / seconds
        self.acceleration = (velocity - self.velocity) / seconds
        self.velocity, self.value = velocity, value


def pose_difference(after: FloatArray, before: FloatArray) -> FloatArray:
    """`(6,)`: the shift and the small turn, both along the base frame's axes, between two poses `(4, 4)`."""
    turn = after[:3, :3] @ before[:3, :3].T
    skew = (turn - turn.T) / 2
    return np.array([*(after[:3, 3] - before[:3, 3]), skew[2, 1], skew[0, 2], skew[1, 0]])


SLIP_M = 0.02
"""So far a finger gives way when a grasp slips."""
SLIP_S = 0.3


class LabHand:
    """Moves the fingers' command a little at every step of the world."""

    def __init__(self, fingers: Fingers) -> None:
        self._fingers = fingers
        self._slipping_s = 0.0
        self.reset()

    @property
    def width(self) -> float:
        """Metres between the fingers."""
        return self._fingers.width

    @property
    def moving(self) -> bool:
        """Whether the fingers' command is on its way."""
        return self._opening != self._goal or self._slipping_s > 0

    def reset(self) -> None:
        """Take note that the fingers are wide open."""
        self._opening = self._goal = OPEN_M
        self._speed = 0.0

    def aim(self, width_m: float, speed_m_s: float, force_n: float) -> None:
        """Go for a width from now on; each finger moves at `speed_m_s` and presses with at most `force_n`."""
        self._opening = self._fingers.width / 2
        self._goal = min(max(width_m / 2, 0.0), OPEN_M)
        self._speed = speed_m_s
        self._fingers.set_force(force_n)

    def slip(self) -> None:
        """Lose what is held: the fingers give way for a moment, and close again."""
        self._slipping_s = SLIP_S

    def step(self, seconds: float) -> None:
        """What to command for the next `seconds`."""
        way = self._speed * seconds
        self._opening += min(max(self._goal - self._opening, -way), way)
        self._slipping_s -= seconds
        self._fingers.set_opening(self._opening + (SLIP_M if self._slipping_s > 0 else 0.0))


TICK_S = 0.001
TICKS_PER_STEP = 8
"""Of the protocol to one of the world: the longest step a world takes with a bag in it."""
STEP_S = TICKS_PER_STEP * TICK_S
_PARTS = 2
"""Of which each is taken: in whole ones the servos of an arm that is folded up never come to rest, and drift."""
FELT_OVER_S = 0.05
"""The force is the median over so long: squeezed cloth chatters for up to three steps with hundreds of newtons, which
is the simulation's own, and which an estimate from joint torques would not show."""


class LabRobot:
    """An FR3 with its hand. Joint angles `(7,)` radians; poses `(4, 4)`, `T_base_hand` as in `hand_matrix`."""

    has_gripper = True

    def __init__(self, world: ArmWorld, fingers: Fingers) -> None:
        self._world = world
        self.hand = LabHand(fingers)
        self._kinematics = Kinematics(arm_spec().compile(), HOME)
        self._hand_bodies = {world.model.body(ARM + name).id for name in HAND}
        self._forces = deque[float](maxlen=round(FELT_OVER_S / STEP_S) | 1)
        self._tick = 0
        self._joints = CommandState(world.joints)
        self._pose = CommandState(np.eye(4), pose_difference)
        self._follows_pose = False
        self._last_command_tick = 0
        self._T_nominal_tool = np.eye(4)
        self.hold()

    # -- time ---------------------------------------------------------------------------------------------------

    def tick(self) -> None:
        """A millisecond passes."""
        self._tick += 1
        if self._tick % TICKS_PER_STEP == 0:
            self._step()

    def hold(self) -> None:
        """Stay where the arm is: at the start, and after the world was reset."""
        self._joints.rest(self._world.joints)
        self._pose.rest(self._kinematics.hand_pose(self._joints.value))
        self._follows_pose = False
        self._pose_q = self._step_q = self._joints.value
        self.hand.reset()
        self._measure()

    def _step(self) -> None:
        if self._follows_pose:
            q = self._kinematics.approach(self._joints.value, self._pose.value)
            self._joints.take(q, STEP_S)
        target = self._joints.value
        self._world.set_joints(target, (target - self._step_q) / STEP_S)
        self._step_q = target
        self.hand.step(STEP_S)
        for _ in range(_PARTS):
            self._world.advance(STEP_S / _PARTS)
        self._measure()

    def _measure(self) -> None:
        world = self._world
        self._q, self._dq = world.joints, world.joint_velocities
        self._T_base_hand = self._kinematics.hand_pose(self._q)
        self._forces.append(upward_touch(world.model, world.data, self._hand_bodies))
        self._force_n = statistics.median(self._forces)

    # -- commands, as the server passes them on -------------------------------------------------------------------

    def joint_position_control(self, q: FloatArray, has_new_command: bool = True) -> None:
        """Go to joint angles."""
        if not has_new_command:
            return
        if self._follows_pose:  # the server holds the joints once a motion is over
            self._follows_pose = False
            self._joints.rest(self._joints.value)
        if np.array_equal(q, self._joints.value):
            self._joints.rest(self._joints.value)
        else:
            self._joints.take(np.asarray(q, float), self._since_last_command())
        if self._joints.value is not self._pose_q:
            self._pose_q = self._joints.value
            self._pose.rest(self._kinematics.hand_pose(self._pose_q))

    def cartesian_position_control(
        self, pose: FloatArray, elbow: FloatArray | None, has_new_command: bool = True
    ) -> None:
        """Bring the tool to a pose, `(7,)` x, y, z and a quaternion x, y, z, w; the elbow is the arm's own affair."""
        if not has_new_command:
            return
        T_base_hand = np.eye(4)
        rotation = np.empty(9)
        mujoco.mju_quat2Mat(rotation, np.roll(pose[3:], 1))
        T_base_hand[:3, :3], T_base_hand[:3, 3] = rotation.reshape(3, 3), pose[:3]
        self._follows_pose = True
        self._pose.take(T_base_hand, self._since_last_command())

    def set_hand_goal(self, width_m: float, speed_m_s: float, force_n: float) -> None:
        """Move the fingers."""
        self.hand.aim(width_m, speed_m_s, force_n)

    def _set_server(self, server: object) -> None:
        """franky-sim introduces its server here; there is nothing to ask of it."""

    def set_NE_T_EE(self, T_nominal_tool: tuple[float, ...]) -> None:
        """Another end effector. It is said to be there; the hand is what it was."""
        self._T_nominal_tool = np.reshape(T_nominal_tool, (4, 4), order="F")

    def set_EE_T_K(self, T_tool_stiffness: tuple[float, ...]) -> None:
        """Another frame for forces; taken note of by nobody."""

    def set_load(self, mass_kg: float, center: tuple[float, ...], inertia: tuple[float, ...]) -> None:
        """What the hand is said to carry; our servos need no telling."""

    def _since_last_command(self) -> float:
        seconds = TICK_S * max(self._tick - self._last_command_tick, 1)
        self._last_command_tick = self._tick
        return seconds

    # -- state ----------------------------------------------------------------------------------------------------

    @property
    def hand_width(self) -> float:
        """Metres between the fingers."""
        return self.hand.width

    @property
    def tool_xyz(self) -> tuple[float, ...]:
        """The point between the fingertips, metres, robot base frame."""
        return _floats(self._T_base_hand[:3, 3])

    @property
    def inner_state(self) -> FrankaRobotState:
        """The state where the arm is held, which is what the server wants to know when somebody connects or leaves."""
        return self.state.replace(q=_floats(self._joints.value))

    @property
    def state(self) -> FrankaRobotState:
        """What a Franka robot says of itself, as far as a client that commands positions can tell."""
        q_d, pose, twist = self._joints.value, _columns(self._pose.value), _floats(self._pose.velocity)
        return FrankaRobotState(
            q=_floats(self._q),
            dq=_floats(self._dq),
            theta=_floats(self._q),
            dtheta=_floats(self._dq),
            q_d=_floats(q_d),
            dq_d=_floats(self._joints.velocity),
            ddq_d=_floats(self._joints.acceleration),
            elbow=(float(self._q[2]), float(np.sign(self._q[3]))),
            elbow_d=(float(q_d[2]), float(np.sign(q_d[3]))),
            elbow_c=(float(q_d[2]), float(np.sign(q_d[3]))),
            O_T_EE=_columns(self._T_base_hand),
            O_T_EE_d=pose,
            O_T_EE_c=pose,
            O_dP_EE_d=twist,
            O_dP_EE_c=twist,
            O_ddP_EE_c=_floats(self._pose.acceleration),
            F_T_EE=_columns(T_FLANGE_TOOL @ self._T_nominal_tool),
            F_T_NE=_columns(T_FLANGE_TOOL),
            NE_T_EE=_columns(self._T_nominal_tool),
            O_F_ext_hat_K=(0.0, 0.0, self._force_n, 0.0, 0.0, 0.0),
            control_command_success_rate=1.0,
        )


def _floats(values: FloatArray) -> tuple[float, ...]:
    return tuple(values.tolist())


def _columns(transform: FloatArray) -> tuple[float, ...]:
    """Write the columns of a transform as libfranka does."""
    return tuple(transform.T.ravel().tolist())
