"""One bag in the running simulation: where its points are, and how to lay it somewhere."""

from __future__ import annotations

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from baggie.geometry import FloatArray, PlanarPose
from baggie.sim.bag import BagParameters, pillow


class SoftBody:
    """The flex of a model with this name."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, name: str, bag: BagParameters) -> None:
        self._model, self._data = model, data
        nodes = [b for b in range(model.nbody) if model.body(b).name.startswith(name)]
        self._joints = np.array([model.body_jntadr[b] + np.arange(3) for b in nodes])
        self._home = model.body_pos[nodes].copy()
        flex = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_FLEX, name)
        start = int(model.flex_vertadr[flex])
        self._vertices = slice(start, start + int(model.flex_vertnum[flex]))
        self._dents = _plastic_state(model, flex)
        self._rest, _ = pillow(bag)

    @property
    def points(self) -> FloatArray:
        """`(P, 3)` metres: its surface points now."""
        return np.asarray(self._data.flexvert_xpos[self._vertices].copy())

    def pose(self) -> PlanarPose:
        """Its true centre and yaw: the planar rigid motion that best explains where its points are (Kabsch)."""
        now = self.points[:, :2]
        center = now.mean(axis=0)
        rest = self._rest[:, :2]
        covariance = rest.T @ (now - center)
        yaw = np.arctan2(covariance[0, 1] - covariance[1, 0], covariance[0, 0] + covariance[1, 1])
        return PlanarPose(float(center[0]), float(center[1]), float(yaw))

    def put(self, pose: PlanarPose, height: float, *, undented: bool) -> None:
        """Lay it, at rest, with its centre `height` metres above the table; its dents stay unless `undented`."""
        c, s = np.cos(pose.yaw), np.sin(pose.yaw)
        turned = self._home @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
        self._data.qpos[self._positions] = turned + np.array([pose.x, pose.y, height]) - self._home
        self._data.qvel[self._velocities] = 0.0
        if undented:
            self._data.plastic[self._dents] = 0.0

    def carry_along(self, turn: Rotation, shift: FloatArray) -> None:
        """Move it as it is, turned about the base frame's origin and then shifted by `(3,)` metres."""
        nodes = self._home + self._data.qpos[self._positions]
        self._data.qpos[self._positions] = turn.apply(nodes) + shift - self._home
        self._data.qvel[self._velocities] = turn.apply(self._data.qvel[self._velocities])

    @property
    def _positions(self) -> np.ndarray:
        return np.asarray(self._model.jnt_qposadr[self._joints])

    @property
    def _velocities(self) -> np.ndarray:
        return np.asarray(self._model.jnt_dofadr[self._joints])


def _plastic_state(model: mujoco.MjModel, flex: int) -> slice:
    """Where in `data.plastic` the strains stand that stay in a flex; nowhere for one that yields to nothing."""
    start, ends = int(model.flex_plasticadr[flex]), (*model.flex_plasticadr, model.nplastic)
    return slice(0) if start < 0 else slice(start, int(min(end for end in ends if end > start)))
