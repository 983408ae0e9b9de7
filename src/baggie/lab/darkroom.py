"""Where the lab's pictures are drawn: in a thread of its own, of a copy of the scene, while the robot goes on."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import mujoco
import numpy as np

from baggie.sim.arm_world import ArmWorld
from baggie.sim.renderer import CameraRenderer
from baggie.sim.sensor import Exposure
from baggie.types import Image


class Still:
    """A world at one moment, for a renderer to look at."""

    def __init__(self, world: ArmWorld) -> None:
        self.model, self.printed = world.model, world.printed
        self.data = mujoco.MjData(world.model)
        self.take(world)

    def take(self, world: ArmWorld) -> None:
        """Another moment; not while time passes."""
        mujoco.mj_copyData(self.data, self.model, world.data)
        self.cell = world.cell

    @property
    def time(self) -> float:
        """Seconds of simulated time."""
        return float(self.data.time)


class Darkroom:
    """The camera's renderer, and the one thread that may use it."""

    def __init__(self, world: ArmWorld) -> None:
        """Raises `BaggieError` where nothing can render off screen."""
        self._still = Still(world)
        self._thread = ThreadPoolExecutor(1, "darkroom")
        self._rng = np.random.default_rng()
        self._renderer = self._thread.submit(CameraRenderer, self._still).result()

    def take(self, world: ArmWorld, exposure: Exposure) -> None:
        """Keep what there is to see now, for `develop`. Not while time passes, nor while a picture is developed."""
        self._still.take(world)
        self._exposure = exposure

    def develop(self) -> Image:
        """The picture of what was taken last."""
        return self._thread.submit(self._draw).result()

    def close(self) -> None:
        """Free the OpenGL context."""
        self._thread.submit(self._renderer.close).result()
        self._thread.shutdown()

    def _draw(self) -> Image:
        return self._renderer.look(self._exposure, self._rng, depth=False).color
