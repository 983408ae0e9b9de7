"""The simulated overhead camera, as a workcell has it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from baggie.sim.arm_world import ArmWorld
from baggie.sim.renderer import CameraRenderer
from baggie.sim.sensor import Exposure
from baggie.types import Intrinsics, Observation


class SimulatedCamera:
    """The overhead colour and depth camera, with exposure and light that drift."""

    def __init__(self, world: ArmWorld, usual: Exposure) -> None:
        """`usual`: what exposures drift about."""
        self.name = f"simulated camera of cell {world.cell.number}"
        self.size = world.cell.lens.size
        self.intrinsics: Intrinsics | None = None  # nobody has calibrated it
        self._renderer = CameraRenderer(world)
        self._usual = usual
        self._rng = np.random.default_rng()

    def enter(self, world: ArmWorld, usual: Exposure) -> None:
        """Look into another world from now on, with exposures that drift about `usual`."""
        self._renderer.close()
        self._renderer = CameraRenderer(world)
        self._usual = usual

    def reseed(self, rng: np.random.Generator) -> None:
        """Draw exposures and noise from this stream from now on."""
        self._rng = rng

    def look(self) -> Observation:
        """A picture of the world as it is now."""
        exposure = self._usual.times(Exposure.random(self._rng))
        return replace(self._renderer.look(exposure, self._rng), intrinsics=self.intrinsics)

    def close(self) -> None:
        """Free the OpenGL context."""
        self._renderer.close()
