"""One simulated camera with depth, as a workcell has it."""

from __future__ import annotations

import numpy as np

from baggie.sim.depth_cameras import DepthRenderer
from baggie.types import Intrinsics, Observation
from baggie.vision.depth_camera import DepthCamera


class SimulatedDepthCamera:
    """A camera of a world; several share one renderer, whose owner closes it."""

    def __init__(self, camera: DepthCamera, renderer: DepthRenderer) -> None:
        self.name = f"simulated {camera.name} camera"
        self.size = camera.intrinsics.width, camera.intrinsics.height
        self.intrinsics: Intrinsics | None = camera.intrinsics
        self._camera = camera
        self._renderer = renderer
        self._rng = np.random.default_rng()

    def reseed(self, rng: np.random.Generator) -> None:
        """Draw noise from this stream from now on."""
        self._rng = rng

    def look(self) -> Observation:
        """Colour and depth of the world as it is now."""
        return self._renderer.look(self._camera, self._rng)
