"""The two fingers of the simulated hand."""

from __future__ import annotations

import mujoco

from baggie.sim.scene import ARM

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
