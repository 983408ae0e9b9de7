"""A real Franka arm, FR3 or Panda, with its hand: motions over franky, which plans them and speaks the FCI protocol.

The gate in front of it is `limits.py`, as for every arm. Straight lines are planned by franky (Ruckig) and followed by
the robot's own inverse kinematics; ours only says beforehand whether the arm reaches.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

import numpy as np

from baggie.errors import ReachError, StuckError
from baggie.geometry import FloatArray, ToolPose, hand_matrix, wrap_angle
from baggie.robot.arm import CLEAR_Z_M
from baggie.robot.franka.link import CollisionError, FrankaLink, HiccupError, load_franky
from baggie.robot.franka.models import MAX_SPEED_M_S, MODELS, PARK, ModelName

ROTATION_SPEED_RAD_S = 2.5  # of the tool; Franka's limit
PARK_SPEED_SHARE = 0.5  # of what the joints can do
ACCELERATION_SHARE = 0.3
"""Of the highest acceleration and jerk; at all of it (13 m/s²) a bag would fly out of the hand."""
FINGERS_M_S = 0.05
TURN_STEP_RAD = 2.5  # a turn goes the shorter way, so one of more than half a turn goes in steps
TRIES = 3
"""Of a motion cut short by late packets."""
ARRIVED_M, ARRIVED_RAD = 0.005, 0.03
SETTLED_RAD_S = 0.01
SETTLE_TIMEOUT_MS = 1000


class FrankaArm:
    """An FR3 or a Panda with Franka's hand at an address.

    `speed` is the share of every speed asked for (and of acceleration and jerk) that it really goes at: 0.1 for a first
    run. Connects at the first use. Raises `BaggieError` without `franky-control`, `ArmError` when the robot does not
    answer, `StuckError` when it was stopped or needs a person, `ReachError` when a motion cannot be done or was cut
    short by a reflex from which the robot has recovered.
    """

    def __init__(
        self, host: str, model: ModelName = "fr3", *, speed: float = 0.1, realtime: bool = True
    ) -> None:
        self._franky = load_franky()
        self._model = MODELS[model]
        self._kinematics = self._model.kinematics()
        self._link = FrankaLink(host, realtime)
        self._speed = speed
        self._stopped = False
        self.info = self._model.info(host)

    def pose(self) -> ToolPose:
        """Where the tool is now, by forward kinematics of the measured joints."""
        return self._kinematics.tool_pose(self.joints())

    def hand_pose(self) -> FloatArray:
        """`T_base_hand` `(4, 4)`, by forward kinematics of the measured joints."""
        return self._kinematics.hand_pose(self.joints())

    def joints(self) -> FloatArray:
        """`(7,)` radians, measured."""
        return np.asarray(self._state().q, float).reshape(7)

    def foresee(self, way: Sequence[ToolPose]) -> float:
        """`ForeseeingArm.foresee`, by the model's kinematics."""
        return self._kinematics.turn_along(self.joints(), way)

    def move_to(self, target: ToolPose, speed_m_s: float) -> ToolPose:
        """Along a straight line (to 1% of its length); turns the shorter way, if the wrist can."""
        line = self._plan(target)
        self._move(lambda: self._straight(line, speed_m_s))
        reached = self.pose()
        off_m = float(np.linalg.norm(reached.xyz - target.xyz))
        off_rad = abs(wrap_angle(reached.yaw - target.yaw))
        if off_m > ARRIVED_M or off_rad > ARRIVED_RAD:
            raise ReachError(
                f"the arm ended {1000 * off_m:.0f} mm and {np.rad2deg(off_rad):.0f} degrees from where it was sent; "
                "something holds it, or the load in its hand is too heavy"
            )
        return reached

    def lower_until_contact(self, z_min: float, speed_m_s: float, force_n: float) -> ToolPose:
        """Straight down until the vertical force at the hand has changed by `force_n`; a reflex is a contact, too.

        The force is the robot's own estimate from its joint torques: of a hand in motion it wanders by 1 to 3 N.
        """
        start = self.pose()
        if start.z <= z_min:
            return start
        line = self._plan(replace(start, z=z_min))
        tare = float(np.asarray(self._state().O_F_ext_hat_K).reshape(6)[2])

        def lowering() -> Any:
            motion = self._straight(line, speed_m_s)
            change = self._franky.Measure.FORCE_Z - tare
            felt = (change > force_n) | (change < -force_n)
            motion.add_reaction(self._franky.CartesianPoseReaction(felt, self._franky.CartesianStopMotion()))
            return motion

        with suppress(CollisionError):  # it touched something, harder than it should have
            self._move(lowering)
        return self.pose()

    def move_gripper(self, width_m: float) -> float:
        """Fingers to a width."""
        with self._link.speaking():
            self._link.gripper.move(width_m, FINGERS_M_S)
        return self.gripper_width()

    def grasp(self, force_n: float) -> float:
        """Close until the fingers meet something, then keep squeezing."""
        with self._link.speaking():
            self._link.gripper.grasp(0.0, FINGERS_M_S, force_n, epsilon_outer=self.info.max_width_m)
        return self.gripper_width()

    def gripper_width(self) -> float:
        """Metres between the fingers now."""
        with self._link.speaking():
            return float(self._link.gripper.width)

    def is_grasped(self) -> bool:
        """Whether the hand says that it still squeezes; it also says so when it squeezes nothing."""
        with self._link.speaking():
            return bool(self._link.gripper.is_grasped)

    def park(self) -> ToolPose:
        """Fold back over the base, joint by joint together, which also brings the elbow back to where it began."""
        if np.allclose(self.joints(), PARK, atol=1e-3):
            return self.pose()
        here = self.pose()
        if here.z < CLEAR_Z_M:
            self.move_to(replace(here, z=CLEAR_Z_M), MAX_SPEED_M_S)
        self._move(self._to_park)
        return self.pose()

    def stop(self) -> None:
        """Brake softly, now; from any thread. The motion that is under way raises `StuckError` where it is called."""
        with self._link.speaking():
            kinds = self._franky.ControlSignalType
            brakes = {
                kinds.CartesianPose: self._franky.CartesianStopMotion,
                kinds.JointPositions: self._franky.JointStopMotion,
            }
            brake = brakes.get(self._link.robot.current_control_signal_type)
            if brake is not None:
                self._stopped = True
                self._link.robot.move(brake(), asynchronous=True)

    def close(self) -> None:
        """Let go of the robot; it holds its position."""
        self._link.close()

    def _state(self) -> Any:
        with self._link.speaking():
            return self._link.robot.state

    def _plan(self, target: ToolPose) -> list[ToolPose]:
        """The poses to pass on the straight way to `target`. Raises `ReachError` where the arm cannot follow it."""
        here, q = self.pose(), self.joints()
        turn = self._kinematics.turn(self._kinematics.line(q, target))
        shares = np.linspace(0, 1, int(np.ceil(max(abs(turn), 1e-9) / TURN_STEP_RAD)) + 1)[1:]
        way = target.xyz - here.xyz
        return [
            ToolPose(
                float(here.x + share * way[0]),
                float(here.y + share * way[1]),
                float(here.z + share * way[2]),
                float(here.yaw + share * turn),
            )
            for share in shares
        ]

    def _straight(self, line: list[ToolPose], speed_m_s: float) -> Any:
        """A fresh motion through these poses. franky limits each axis, so two of them at once could go faster."""
        franky = self._franky
        share = self._speed * speed_m_s / (np.sqrt(3) * self._link.robot.translation_velocity_limit.max)
        return franky.CartesianWaypointMotion(
            [franky.CartesianWaypoint(franky.Affine(hand_matrix(pose))) for pose in line],
            relative_dynamics_factor=self._dynamics(share),
        )

    def _to_park(self) -> Any:
        limit = self._link.robot.joint_velocity_limit
        limit.set(np.minimum(self._model.speed_rad_s, limit.max))  # franky's own are those of the other model
        state = self._franky.JointState(PARK)
        return self._franky.JointMotion(
            state, relative_dynamics_factor=self._dynamics(PARK_SPEED_SHARE * self._speed)
        )

    def _dynamics(self, velocity_share: float) -> Any:
        slow = ACCELERATION_SHARE * self._speed
        return self._franky.RelativeDynamicsFactor(min(velocity_share, 1.0), slow, slow)

    def _move(self, motion: Callable[[], Any]) -> None:
        """Run a motion to its end; Ctrl-C brakes. One that late packets cut short is begun again where it ended."""
        self._link.make_ready()
        self._stopped = False
        for attempt in range(TRIES):
            try:
                with self._link.speaking():
                    self._link.robot.move(motion())
                break
            except HiccupError:
                if attempt == TRIES - 1:
                    raise
        self._settle()
        if self._stopped:
            raise StuckError("the arm was stopped; nothing moves until it is told to again")

    def _settle(self) -> None:
        """Wait until the joints are at rest; they follow what was planned a little later."""
        state = self._state()
        deadline = state.time.to_msec() + SETTLE_TIMEOUT_MS  # the robot's clock: a simulated one may be slow
        while np.abs(state.dq).max() > SETTLED_RAD_S and state.time.to_msec() < deadline:
            state = self._state()
