"""What can lie on the table: plain data until a world is made of it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import numpy as np

from baggie.geometry import FloatArray, PlanarPose
from baggie.types import Image

if TYPE_CHECKING:
    import mujoco
    from scipy.spatial.transform import Rotation

Pose = PlanarPose | FloatArray
"""Flat on the table, or `T_base_body` `(4, 4)`."""


class Body(Protocol):
    """A thing in a running simulation."""

    settle_s: float
    """Seconds after which it lies still where it was put."""

    def pose(self) -> FloatArray:
        """`T_base_body` `(4, 4)` now; of a soft one, the upright motion that explains its points best."""
        ...

    def planar_pose(self) -> PlanarPose:
        """Where its middle is above the table, and which way its x axis points there."""
        ...

    def top_m(self) -> float:
        """Height of its highest point above the table."""
        ...

    def bottom_m(self) -> float:
        """Height of its lowest point above the table."""
        ...

    def put(self, pose: Pose, *, undented: bool) -> None:
        """Lay it somewhere, at rest, without time passing; the dents of a soft one stay unless `undented`."""
        ...

    def carry_along(self, turn: Rotation, shift: FloatArray) -> None:
        """Move it with the table: turned about the base frame's origin and then shifted by `(3,)` metres."""
        ...


class Thing(Protocol):
    """What a person would name: a bag, a block, a stand."""

    @property
    def name(self) -> str:
        """Its own among all on a table."""
        ...

    @property
    def soft(self) -> bool:
        """Whether it gives way."""
        ...

    @property
    def movable(self) -> bool:
        """Whether it can be picked up."""
        ...

    def assets(self) -> str:
        """Its textures and materials, XML."""
        ...

    def xml(self) -> str:
        """Its body, XML."""
        ...

    def paint(self, model: mujoco.MjModel, rng: np.random.Generator) -> None:
        """Give its textures their pictures."""
        ...

    def bind(self, model: mujoco.MjModel, data: mujoco.MjData) -> Body:
        """Find it in a world that has been built with it."""
        ...


def paint(model: mujoco.MjModel, texture: str, picture: Image) -> None:
    """Put a picture `(H, W, 3)` in the place of a texture of that size."""
    start = model.tex_adr[model.texture(texture).id]
    model.tex_data[start : start + picture.size] = picture.ravel()
