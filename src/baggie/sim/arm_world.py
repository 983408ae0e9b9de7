"""The running simulation of an arm over a table: time, joints, the force at its wrist, and its tool.

MuJoCo's own force sensors leave out contacts with cloth and bags (flexes), so contacts are added up here. What a cup
seals on is welded to it while they touch: MuJoCo's adhesion would pull at anything near, over edges and gaps too, where
a real cup draws air.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from baggie.geometry import FloatArray
from baggie.robot.franka.models import HOME
from baggie.sim.cell import Cell
from baggie.sim.objects import CUP_RADIUS_M
from baggie.sim.scene import ARM, CUP, TIMESTEP_S, camera_quaternion, seal_of
from baggie.vision.targets import Target

MOVE_FORCE_N = 20.0  # what moves the empty fingers against their friction
OPEN_M = 0.04  # each finger from the middle, at the most
HAND = ("hand", "left_finger", "right_finger")
"""Names of the bodies that touch things, without the arm's prefix."""


@dataclass(frozen=True)
class Stepping:
    """How finely physics is reckoned."""

    longest_s: float
    """The most that a step may take."""
    solver: mujoco.mjtSolver = mujoco.mjtSolver.mjSOL_NEWTON
    iterations: int = 100
    """The most that the solver takes in a step."""


FINE = Stepping(TIMESTEP_S)


class Fingers:
    """The two fingers of the hand: how far they are apart, and how hard they press."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        self._model, self._data = model, data
        self._q = [int(model.joint(f"{ARM}finger_joint{k}").qposadr[0]) for k in (1, 2)]
        self._grip = model.actuator(f"{ARM}hand").id

    @staticmethod
    def are_in(model: mujoco.MjModel) -> bool:
        """Whether the model's arm has fingers."""
        return bool(mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_ACTUATOR, f"{ARM}hand") >= 0)

    @property
    def width(self) -> float:
        """Metres between the fingers."""
        return float(self._data.qpos[self._q].sum())

    def set_opening(self, opening: float) -> None:
        """Command how far each finger is from the middle, metres."""
        self._data.ctrl[self._grip] = opening

    def set_force(self, newtons: float) -> None:
        """The most each finger presses with."""
        # The tendon pulls each finger with half its force.
        self._model.actuator_forcerange[self._grip] = [-2 * newtons, 2 * newtons]

    def reset(self) -> None:
        """Wide open at once."""
        self._data.qpos[self._q] = OPEN_M
        self.set_opening(OPEN_M)
        self.set_force(MOVE_FORCE_N)


VACUUM_PA = 60_000.0  # what a small ejector reaches
HOLDING_N = VACUUM_PA * np.pi * CUP_RADIUS_M**2  # 19 N
RIM_POINTS = 12
REACH_M = 0.002  # how far the lip bends
TILT_RAD = np.deg2rad(5.0)
FLATNESS_M = 0.0003
_WIDE_AWAKE = -(1 + mujoco.mjMINAWAKE)  # as MuJoCo counts in `tree_asleep`
_BACK_M = 0.004  # rays start within the cup: a surface that the rim presses into is seen too


class Suction:
    """The cup's vacuum. Tried once, when it is switched on."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, blocks: Iterable[str]) -> None:
        """`blocks`: the names of bodies it can hold, each with its seal in the model."""
        self._model, self._data = model, data
        self._block_of = {model.body(block).id: block for block in blocks}
        self._cup = model.body(ARM + CUP).id
        self._lip = model.geom(ARM + CUP).id
        self._site = model.site(f"{ARM}tool").id
        angles = np.linspace(0.0, 2 * np.pi, RIM_POINTS, endpoint=False)
        self._rim = CUP_RADIUS_M * np.c_[np.cos(angles), np.sin(angles), np.zeros(RIM_POINTS)]
        self.held: str | None = None
        """What the cup holds."""

    @property
    def sealed(self) -> bool:
        """Whether it holds something."""
        return self.held is not None

    def on(self) -> None:
        """Hold what the whole rim lies on, if that is one flat face of one block."""
        self.off()
        mujoco.mj_kinematics(self._model, self._data)
        block = self._under_the_rim()
        if block is None:
            return
        self._weld(block)
        # What the lip was pressed by at that moment would be felt as a pull for as long as the weld keeps them there.
        self._touch(False)
        self.held = block

    def off(self) -> None:
        """Let go."""
        if self.held is not None:
            self._data.eq_active[self._model.equality(seal_of(self.held)).id] = 0
            self._touch(True)
            # A block that hung still would be put to sleep in the air now that nothing awake is connected to it.
            self._data.tree_asleep[self._model.body_treeid[self._model.body(self.held).id]] = _WIDE_AWAKE
        self.held = None

    def check(self) -> None:
        """Lose what is pulled off or sideways harder than the vacuum holds."""
        if self.held is not None and self.pull_n() > HOLDING_N:
            self.off()

    def pull_n(self) -> float:
        """Newtons with which the held block pulls at the cup, downwards and sideways; pressing it on is none."""
        if self.held is None:
            return 0.0
        if not self._data.ne:  # sealed since the last step
            return 0.0
        # Equalities come first, and there is no other: the force on the cup, base frame, and then three torques.
        force = self._data.efc_force[:3]
        out = self._axes()[:, 2]
        off = float(force @ out)
        return float(np.hypot(max(off, 0.0), np.linalg.norm(force - off * out)))

    def _under_the_rim(self) -> str | None:
        """The block whose face the whole rim lies on."""
        axes = self._axes()
        out = np.ascontiguousarray(axes[:, 2])
        starts = self._data.site_xpos[self._site] + (self._rim - [0.0, 0.0, _BACK_M]) @ axes.T
        distances, bodies = np.empty(RIM_POINTS), np.empty(RIM_POINTS, int)
        for number, start in enumerate(starts):
            geom = np.full(1, -1, np.int32)
            distances[number] = mujoco.mj_ray(self._model, self._data, start, out, None, 1, self._cup, geom)
            bodies[number] = self._model.geom_bodyid[geom[0]] if geom[0] >= 0 else -1
        gaps = distances - _BACK_M
        if (bodies != bodies[0]).any() or (gaps > REACH_M).any() or not is_flat(self._rim[:, :2], gaps):
            return None
        return self._block_of.get(int(bodies[0]))

    def _weld(self, block: str) -> None:
        """Make the block's pose in the hand the one it has to keep, anchored at the cup."""
        body, seal = self._model.body(block).id, self._model.equality(seal_of(block)).id
        data = self._data
        tool = data.site_xpos[self._site]
        cup_axes, block_axes = data.xmat[self._cup].reshape(3, 3), data.xmat[body].reshape(3, 3)
        away, turn = np.empty(4), np.empty(4)
        mujoco.mju_negQuat(away, data.xquat[self._cup])
        mujoco.mju_mulQuat(turn, away, data.xquat[body])
        # MuJoCo's weld: the anchor in body 2, the anchor in body 1, the turn of 2 in 1 (w first), torquescale.
        self._model.eq_data[seal, :3] = block_axes.T @ (tool - data.xpos[body])
        self._model.eq_data[seal, 3:6] = cup_axes.T @ (tool - data.xpos[self._cup])
        self._model.eq_data[seal, 6:10] = turn
        data.eq_active[seal] = 1

    def _touch(self, touches: bool) -> None:
        """Whether things can run into the cup."""
        self._model.geom_contype[self._lip] = self._model.geom_conaffinity[self._lip] = int(touches)

    def _axes(self) -> FloatArray:
        """`(3, 3)`: the tool's axes in the base frame, z out of the cup."""
        return np.asarray(self._data.site_xmat[self._site].reshape(3, 3))


def is_flat(points: FloatArray, gaps: FloatArray) -> bool:
    """Whether the lip closes on a surface that is `gaps` `(N,)` metres from the rim's `points` `(N, 2)`.

    That is one plane, tilted against the cup by no more than the lip gives way.
    """
    design = np.c_[points, np.ones(len(points))]
    plane, *_ = np.linalg.lstsq(design, gaps, rcond=None)
    off = np.abs(design @ plane - gaps).max()
    return bool(off <= FLATNESS_M and np.hypot(*plane[:2]) <= np.tan(TILT_RAD))


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
        self._hand = {model.body(ARM + name).id for name in HAND} if self.fingers else set[int]()
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
        stepping = self._stepping(seconds)
        steps = max(math.ceil(seconds / stepping.longest_s - 1e-6), 1)
        self._step_by(replace(stepping, longest_s=seconds / steps))
        mujoco.mj_step(self.model, self.data, steps)
        for watch in self.watchers:
            watch()

    def _stepping(self, seconds: float) -> Stepping:
        """How finely to reckon what is about to happen within these seconds."""
        return FINE

    def _step_by(self, stepping: Stepping) -> None:
        option = self.model.opt
        option.timestep, option.solver, option.iterations = (
            stepping.longest_s,
            stepping.solver,
            stepping.iterations,
        )

    def _reset_arm(self) -> None:
        """Everything as the model has it, the arm home, fingers open, all at rest."""
        mujoco.mj_resetData(self.model, self.data)
        self._step_by(FINE)  # whatever the step before was: the same scene begins the same
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
        """Newtons that push the tool up: what touches a hand; of a cup what a wrist sensor feels, its weight included.

        The sensor of MuJoCo leaves out what is soft, and a hand's own inertia would drown what a bag weighs.
        """
        if self._hand:
            return upward_touch(self.model, self.data, self._hand)
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
        with self._awake():
            mujoco.mj_forward(self.model, self.data)

    @contextmanager
    def _awake(self) -> Iterator[None]:
        """Let nothing sleep while the block runs."""
        flags = self.model.opt.enableflags
        self.model.opt.enableflags = flags & ~int(mujoco.mjtEnableBit.mjENBL_SLEEP)
        try:
            yield
        finally:
            self.model.opt.enableflags = flags
