"""The running simulation of an arm over a table: physics, time, the arm's state, and who wants to watch.

What touches a body, and how hard: rigid things and cloth alike.

MuJoCo's own force sensors leave out contacts with cloth and bags (flexes), so contacts are added up here.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection
from dataclasses import replace

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from baggie.geometry import FloatArray
from baggie.robot.franka.models import HOME
from baggie.sim.cell import Cell
from baggie.sim.scene import ARM, TIMESTEP_S, camera_quaternion
from baggie.sim.tools import Fingers
from baggie.vision.targets import Target


def upward_touch(model: mujoco.MjModel, data: mujoco.MjData, bodies: Collection[int]) -> float:
    """Newtons with which all else pushes these bodies up; a load that hangs on them pulls them down."""
    geoms = data.contact.geom[: data.ncon]
    ours = np.isin(model.geom_bodyid[geoms], list(bodies)) & (geoms >= 0)  # -1 is cloth
    total, wrench = 0.0, np.zeros(6)
    for number in np.flatnonzero(ours[:, 0] != ours[:, 1]):
        mujoco.mj_contactForce(model, data, number, wrench)
        upward = float(
            data.contact.frame[number].reshape(3, 3)[:, 2] @ wrench[:3]
        )  # of the first on the second
        total += upward if ours[number, 1] else -upward
    return total


class ArmWorld:
    """A MuJoCo world with the arm in it. Time passes only inside `advance`, as fast as the processor allows."""

    def __init__(self, cell: Cell, model: mujoco.MjModel) -> None:
        """`model`: of this cell, built by `baggie.sim.scene`."""
        # MuJoCo would print every warning and write a file into the current folder. Dropping a bag or squeezing it
        # flat leaves the implicit solve a little short of its tolerance for some steps, which is harmless.
        mujoco.set_mju_user_warning(logging.getLogger(__name__).debug)
        self.cell = cell
        self.model = model
        self.data = mujoco.MjData(model)
        self.watchers: list[Callable[[], None]] = []
        """Called after every control period; a film camera is one."""
        self.printed: dict[str, tuple[Target, float]] = {}
        """By the texture's name, the target last printed and its scale; renderers keep copies of textures."""
        self.fingers = Fingers(model, self.data) if Fingers.are_in(model) else None
        """Of the hand, where the arm has one."""
        self._arm_dofs = [int(model.joint(f"{ARM}fr3_joint{k}").dofadr[0]) for k in range(1, 8)]
        self._arm_q = [int(model.joint(f"{ARM}fr3_joint{k}").qposadr[0]) for k in range(1, 8)]
        self._arm_ctrl = [model.actuator(f"{ARM}fr3_joint{k}").id for k in range(1, 8)]
        # A position servo with damping lags by kv / kp seconds; `set_joints` feeds that forward.
        stiffness = model.actuator_gainprm[self._arm_ctrl, 0]
        self._lag = -model.actuator_biasprm[self._arm_ctrl, 2] / stiffness
        self._wrist = model.sensor(f"{ARM}wrist").adr[0]
        self._wrist_site = model.site(f"{ARM}wrist").id
        self._tool_site = model.site(f"{ARM}tool").id

    # -- time ---------------------------------------------------------------------------------------------------

    @property
    def time(self) -> float:
        """Seconds of simulated time since the last reset."""
        return float(self.data.time)

    def advance(self, seconds: float) -> None:
        """Let physics run."""
        timestep = self._choose_timestep(seconds)
        self.model.opt.timestep = timestep
        mujoco.mj_step(self.model, self.data, max(round(seconds / timestep), 1))
        for watch in self.watchers:
            watch()

    def _choose_timestep(self, seconds: float) -> float:
        """Seconds, for what is about to happen within these seconds."""
        return TIMESTEP_S

    def _reset_arm(self) -> None:
        """Everything as the model has it, the arm home, fingers open, all at rest."""
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[self._arm_q] = HOME
        self.set_joints(HOME, np.zeros(7))
        if self.fingers is not None:
            self.fingers.reset()

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
    def upward_force(self) -> float:
        """Newtons that push the hand up, as a wrist sensor feels them, the hand's own weight included."""
        force = self.data.sensordata[self._wrist : self._wrist + 3]
        return float(-(self.data.site_xmat[self._wrist_site].reshape(3, 3) @ force)[2])

    # -- camera -------------------------------------------------------------------------------------------------

    def bump_camera(self, shift_m: FloatArray, turn_rad: FloatArray) -> None:
        """Move the camera for good: `shift_m` `(3,)` along the base frame's axes, `turn_rad` `(3,)` about its own."""
        bumped = replace(
            self.cell,
            camera_position=self.cell.camera_position + shift_m,
            camera_rotation=self.cell.camera_rotation @ Rotation.from_rotvec(turn_rad).as_matrix(),
        )
        self.place_camera(bumped)
        self.update_fixed()

    def place_camera(self, cell: Cell) -> None:
        """Put the camera where this cell, a bumped state of the world's own, has it; `update_fixed` has to follow."""
        self.cell, camera = cell, self.model.camera("top")
        camera.pos[:], camera.quat[:] = cell.camera_position, camera_quaternion(cell.camera_rotation)

    # -- what does not move by itself ---------------------------------------------------------------------------

    def update_fixed(self) -> None:
        """Have everything where the model says after what is fixed was moved in it: cameras, lamps, the table.

        With sleep enabled MuJoCo computes the poses of fixed things once after a reset, and what sleeps on one that
        moves away hangs in the air; so this computes them without, which wakes everything.
        """
        flags = self.model.opt.enableflags
        self.model.opt.enableflags = flags & ~int(mujoco.mjtEnableBit.mjENBL_SLEEP)
        mujoco.mj_forward(self.model, self.data)
        self.model.opt.enableflags = flags
