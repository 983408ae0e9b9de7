"""The simulated arm's tools: two fingers, and the suction of a cup, which holds what it seals on.

The seal is a weld between cup and block, switched on where they touch. MuJoCo's adhesion would pull at anything near,
over edges and gaps too, where a real cup draws air.

The two fingers of the simulated hand.
"""

from __future__ import annotations

from collections.abc import Iterable

import mujoco
import numpy as np

from baggie.geometry import FloatArray
from baggie.sim.blocks import CUP_RADIUS_M
from baggie.sim.scene import ARM, CUP, seal_of

MOVE_FORCE_N = 20.0  # what moves the empty fingers against their friction
OPEN_M = 0.04  # each finger from the middle, at the most


class Fingers:
    """How far they are apart, and how hard they press."""

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
        """Metres between them."""
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
