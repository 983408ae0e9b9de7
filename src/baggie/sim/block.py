"""A firm block that can be laid on the table, for an arm to feel."""

from __future__ import annotations

import mujoco

from baggie.geometry import PlanarPose
from baggie.sim.touch import upward_touch

BLOCK = "block"
MAX_HEIGHT_M = 0.20
_HALF_M = (0.05, 0.05, MAX_HEIGHT_M / 2)
_AWAY = (0.4, 0.0, -0.5)
"""Under the table, within the room."""


def block_xml() -> str:
    """The body, away for now. It stands as deep in the table as it is too high."""
    x, y, z = _AWAY
    size = " ".join(f"{half:g}" for half in _HALF_M)
    return f"""
    <body name="{BLOCK}" mocap="true" pos="{x:g} {y:g} {z:g}">
      <geom name="{BLOCK}" type="box" size="{size}" rgba="0.78 0.76 0.72 0" friction="1"/>
    </body>"""


class Block:
    """The block of a running simulation."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        self._model, self._data = model, data
        self._body = model.body(BLOCK).id
        self._mocap = int(model.body(BLOCK).mocapid[0])
        self.pose: PlanarPose | None = None
        """Where it lies; None while it is away."""
        self.height_m = 0.0
        """Of its top above the table; 0 while it is away."""

    def lay(self, pose: PlanarPose, height_m: float) -> None:
        """Its middle at this place, its top at this height; its sides stay along x and y."""
        self.pose, self.height_m = pose, height_m
        self._put((pose.x, pose.y, height_m - _HALF_M[2]))

    def take_away(self) -> None:
        """Off the table."""
        self.pose, self.height_m = None, 0.0
        self._put(_AWAY)

    def _put(self, at: tuple[float, float, float]) -> None:
        self._data.mocap_pos[self._mocap] = at
        self._model.geom(BLOCK).rgba[3] = 1.0 if self.pose else 0.0
        mujoco.mj_forward(self._model, self._data)

    @property
    def pressed_n(self) -> float:
        """Newtons with which something presses on it now."""
        return 0.0 - upward_touch(self._model, self._data, [self._body])
