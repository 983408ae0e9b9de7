"""The running simulation: physics, the state of arm, gripper and bag, and who wants to watch."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import replace

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from baggie.geometry import FloatArray, PlanarPose, invert_transform
from baggie.sim.bag import BAG, SECOND_BAG, BagParameters
from baggie.sim.cell import Cell
from baggie.sim.distractors import Distractor
from baggie.sim.scene import (
    ARM,
    HOME,
    T_HAND_PLATE,
    TIMESTEP_S,
    build_model,
    camera_quaternion,
    paint,
)
from baggie.sim.soft_body import SoftBody
from baggie.sim.table import bump_table
from baggie.sim.targets import (
    PLATE,
    PLATE_SIZE_M,
    PLATE_TEXTURE,
    SHEET,
    SHEET_SIZE_M,
    SHEET_TEXTURE,
    T_sheet_target,
    texture,
)
from baggie.vision.targets import Target

SETTLE_S = 1.0
MOVE_FORCE_N = 20.0  # what moves the empty fingers against their friction
COARSE_TIMESTEP_S = 0.008  # three times as fast, and good where nothing but the table touches the bag
CLEARANCE_M = 0.03  # further than the hand moves in one control period
FINGERTIP_M = 0.009  # how far the fingers reach beyond the tool point
DROP_HEIGHT_M = 0.02
SECOND_HOME = PlanarPose(0.5, 0.25)  # clear of the first, until it is told where


class World:
    """One MuJoCo world. Time passes only inside `advance`, as fast as the processor allows."""

    def __init__(
        self,
        cell: Cell,
        bag: BagParameters | None = None,
        second: BagParameters | None = None,
        distractors: Sequence[Distractor] = (),
    ) -> None:
        # MuJoCo would print every warning and write a file into the current folder. Dropping a bag or squeezing it
        # flat leaves the implicit solve a little short of its tolerance for some steps, which is harmless.
        mujoco.set_mju_user_warning(logging.getLogger(__name__).debug)
        self.cell = cell
        self.bag = bag or BagParameters()
        self.distractors = tuple(distractors)
        self.model = build_model(cell, self.bag, second, self.distractors)
        self.data = mujoco.MjData(self.model)
        self.watchers: list[Callable[[], None]] = []
        """Called after every control period; a film camera is one."""
        self.printed: dict[str, tuple[Target, float]] = {}
        """By the texture's name, the target last printed and its scale; renderers keep copies of textures."""
        self._bag = SoftBody(self.model, self.data, BAG, self.bag)
        self._second = SoftBody(self.model, self.data, SECOND_BAG, second) if second else None
        self._arm_dofs = [int(self.model.joint(f"{ARM}fr3_joint{k}").dofadr[0]) for k in range(1, 8)]
        self._arm_q = [int(self.model.joint(f"{ARM}fr3_joint{k}").qposadr[0]) for k in range(1, 8)]
        self._finger_q = [int(self.model.joint(f"{ARM}finger_joint{k}").qposadr[0]) for k in (1, 2)]
        self._arm_ctrl = [self.model.actuator(f"{ARM}fr3_joint{k}").id for k in range(1, 8)]
        self._grip = self.model.actuator(f"{ARM}hand").id
        # A position servo with damping lags by kv / kp seconds; `set_joints` feeds that forward.
        stiffness = self.model.actuator_gainprm[self._arm_ctrl, 0]
        self._lag = -self.model.actuator_biasprm[self._arm_ctrl, 2] / stiffness
        self._wrist = self.model.sensor(f"{ARM}wrist").adr[0]
        self._wrist_site = self.model.site(f"{ARM}wrist").id
        self._tool_site = self.model.site(f"{ARM}tool").id
        self.reset(PlanarPose(0.5, 0.0))

    # -- time ---------------------------------------------------------------------------------------------------

    @property
    def time(self) -> float:
        """Seconds of simulated time since the last reset."""
        return float(self.data.time)

    def advance(self, seconds: float) -> None:
        """Let physics run, in coarse steps as long as the hand is well above the bag."""
        coarse = self._hand_is_clear()
        timestep = COARSE_TIMESTEP_S if coarse else TIMESTEP_S
        self.model.opt.timestep = timestep
        # Newton's method is exact when cloth is squeezed; at rest one step of conjugate gradients is as good.
        self.model.opt.solver = mujoco.mjtSolver.mjSOL_CG if coarse else mujoco.mjtSolver.mjSOL_NEWTON
        for _ in range(max(round(seconds / timestep), 1)):
            mujoco.mj_step(self.model, self.data)
        for watch in self.watchers:
            watch()

    def _hand_is_clear(self) -> bool:
        fingertips = self.data.site_xpos[self._tool_site, 2] - FINGERTIP_M
        return bool(fingertips - self.data.flexvert_xpos[:, 2].max() > CLEARANCE_M)

    def reset(self, bag_pose: PlanarPose, second_pose: PlanarPose | None = None) -> None:
        """Arm home, gripper open, the bag dropped flat at this pose without dents, everything at rest.

        So is the second bag at its own pose, where there is one.
        """
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[self._arm_q] = HOME
        self.data.qpos[self._finger_q] = 0.04
        self.set_joints(HOME, np.zeros(7))
        self.set_finger_opening(0.04)
        self.set_grip_force(MOVE_FORCE_N)
        if self._second is not None:
            self._second.put(second_pose or SECOND_HOME, DROP_HEIGHT_M)
        self.put_bag(bag_pose)
        self.advance(SETTLE_S)

    # -- arm ----------------------------------------------------------------------------------------------------

    @property
    def joints(self) -> FloatArray:
        """`(7,)` radians, as measured."""
        return np.asarray(self.data.qpos[self._arm_q].copy())

    @property
    def joint_velocities(self) -> FloatArray:
        """`(7,)` radians per second."""
        return np.asarray(self.data.qvel[self._arm_dofs].copy())

    def set_joints(self, q: FloatArray, velocity: FloatArray) -> None:
        """Command joint positions `(7,)` radians that move with `velocity` `(7,)` rad/s."""
        self.data.ctrl[self._arm_ctrl] = q + self._lag * velocity

    def put_joints(self, q: FloatArray) -> None:
        """Put the arm at joint positions `(7,)` radians, at rest there, without time passing."""
        self.data.qpos[self._arm_q] = q
        self.data.qvel[self._arm_dofs] = 0.0
        self.set_joints(q, np.zeros(7))
        mujoco.mj_forward(self.model, self.data)

    @property
    def finger_width(self) -> float:
        """Metres between the fingers."""
        return float(self.data.qpos[self._finger_q].sum())

    def set_finger_opening(self, opening: float) -> None:
        """Command how far each finger is from the middle, metres."""
        self.data.ctrl[self._grip] = opening

    def set_grip_force(self, newtons: float) -> None:
        """The most each finger presses with."""
        # The tendon pulls each finger with half its force.
        self.model.actuator_forcerange[self._grip] = [-2 * newtons, 2 * newtons]

    @property
    def upward_force(self) -> float:
        """Newtons that push the hand up, as a wrist sensor feels them, the hand's own weight included."""
        force = self.data.sensordata[self._wrist : self._wrist + 3]
        return float(-(self.data.site_xmat[self._wrist_site].reshape(3, 3) @ force)[2])

    # -- bags, card and printed sheets -------------------------------------------------------------------------

    def put_bag(self, pose: PlanarPose, height: float = DROP_HEIGHT_M) -> None:
        """Lay the bag, undented and at rest, with its centre `height` metres above the table."""
        self._bag.put(pose, height)
        mujoco.mj_forward(self.model, self.data)

    @property
    def bag_points(self) -> FloatArray:
        """`(P, 3)` metres: the bag's surface points now."""
        return self._bag.points

    def bag_pose(self) -> PlanarPose:
        """The bag's true centre and yaw."""
        return self._bag.pose()

    def second_pose(self) -> PlanarPose | None:
        """The same of the second bag, where there is one."""
        return self._second.pose() if self._second else None

    def put_card(self, pose: PlanarPose | None) -> None:
        """Lay the printed goal card on the table, or take it away."""
        at = (0.0, 0.0, -1.0) if pose is None else (pose.x, pose.y, 0.0006)
        yaw = 0.0 if pose is None else pose.yaw
        card = int(self.model.body("card").mocapid[0])
        self.data.mocap_pos[card] = at
        self.data.mocap_quat[card] = [np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)]
        mujoco.mj_forward(self.model, self.data)

    def show_sheet(self, target: Target, T_base_target: FloatArray, scale: float = 1.0) -> None:
        """Print a target, `scale` times too large, on the sheet, its own frame at `T_base_target` `(4, 4)`.

        Raises `BaggieError` where it does not fit.
        """
        self._print(SHEET, target, scale, SHEET_SIZE_M, SHEET_TEXTURE)
        T_base_sheet = T_base_target @ invert_transform(T_sheet_target(target, scale))
        sheet = int(self.model.body(SHEET).mocapid[0])
        self.data.mocap_pos[sheet] = T_base_sheet[:3, 3]
        mujoco.mju_mat2Quat(self.data.mocap_quat[sheet], T_base_sheet[:3, :3].ravel())
        mujoco.mj_forward(self.model, self.data)

    def hide_sheet(self) -> None:
        """Take the printed sheet away."""
        self.model.geom(SHEET).rgba[3] = 0.0

    def show_plate(self, target: Target, scale: float = 1.0) -> FloatArray:
        """Print a target, `scale` times too large, on the plate in the hand; `T_hand_target` `(4, 4)`.

        Raises `BaggieError` where it does not fit.
        """
        self._print(ARM + PLATE, target, scale, PLATE_SIZE_M, PLATE_TEXTURE)
        return T_HAND_PLATE @ T_sheet_target(target, scale)

    def hide_plate(self) -> None:
        """Take the printed plate out of the hand."""
        self.model.geom(ARM + PLATE).rgba[3] = 0.0

    def show_paddle(self, shown: bool) -> None:
        """Put the calibration paddle into the hand, or take it away."""
        self.model.geom(f"{ARM}paddle").rgba[3] = 1.0 if shown else 0.0

    # -- what gets bumped ---------------------------------------------------------------------------------------

    def bump_camera(self, shift_m: FloatArray, turn_rad: FloatArray) -> None:
        """Move the camera for good: `shift_m` `(3,)` along the base frame's axes, `turn_rad` `(3,)` about its own."""
        self.cell = replace(
            self.cell,
            camera_position=self.cell.camera_position + shift_m,
            camera_rotation=self.cell.camera_rotation @ Rotation.from_rotvec(turn_rad).as_matrix(),
        )
        camera = self.model.camera("top")
        camera.pos[:], camera.quat[:] = self.cell.camera_position, camera_quaternion(self.cell)
        mujoco.mj_forward(self.model, self.data)

    def bump_table(self, motion: PlanarPose) -> None:
        """Move the table's top for good, and bag, card and sheet with it; robot, camera and lamps stay.

        Turned about the base frame's origin and then shifted: what was at `pose` is at `motion @ pose`.
        """
        bump_table(self.model, self.data, motion, [bag for bag in (self._bag, self._second) if bag])

    def _print(
        self, name: str, target: Target, scale: float, size_m: tuple[float, float], shape: tuple[int, int]
    ) -> None:
        """Print a target on the sheet or plate of this name, unless it is on it already, and show it."""
        if self.printed.get(name) != (target, scale):
            paint(self.model, name, texture(target, size_m, shape, scale))
            self.printed[name] = (target, scale)
        self.model.geom(name).rgba[3] = 1.0
