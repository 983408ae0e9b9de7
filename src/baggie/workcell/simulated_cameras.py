"""The cameras of a simulated workcell: one over the table, or several with depth as one that looks straight down."""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import numpy as np

from baggie.cameras.camera import Camera, HeightMapCamera
from baggie.errors import CameraError
from baggie.sim.renderer import CameraRenderer, DepthRenderer
from baggie.sim.sensor import Exposure
from baggie.sim.world import World
from baggie.types import Intrinsics, Observation
from baggie.vision.height_map import RAVENS_DEPTH_CAMERAS, DepthCamera


class SimulatedView(Camera, Protocol):
    """A camera whose world and noise can be exchanged."""

    def enter(self, world: World, usual: Exposure) -> None:
        """Look into another world from now on, with exposures that drift about `usual`."""
        ...

    def reseed(self, rng: np.random.Generator) -> None:
        """Draw exposures and noise from streams that this one spawns from now on."""
        ...

    def close(self) -> None:
        """Free the OpenGL context."""
        ...


class SimulatedCamera:
    """The overhead camera, with exposure and light that drift."""

    def __init__(self, world: World, usual: Exposure, depth: bool) -> None:
        """`usual`: what exposures drift about; `depth`: whether it measures that, too."""
        self.name = f"simulated camera of cell {world.cell.number}"
        self.size = world.cell.lens.size
        self.intrinsics: Intrinsics | None = None  # nobody has calibrated it
        self._renderer = CameraRenderer(world)
        self._usual = usual
        self._rng = np.random.default_rng()
        self._depth_rng = np.random.default_rng() if depth else None

    def enter(self, world: World, usual: Exposure) -> None:
        """Look into another world from now on, with exposures that drift about `usual`."""
        self._renderer.close()
        self._renderer = CameraRenderer(world)
        self._usual = usual

    def reseed(self, rng: np.random.Generator) -> None:
        """Draw exposures and noise from streams that this one spawns from now on."""
        self._rng, of_depth = rng.spawn(2)
        self._depth_rng = None if self._depth_rng is None else of_depth

    def look(self) -> Observation:
        """A picture of the world as it is now."""
        exposure = self._usual.times(Exposure.random(self._rng))
        seen = self._renderer.look(exposure, self._rng, self._depth_rng)
        return replace(seen, intrinsics=self.intrinsics)

    def close(self) -> None:
        """Free the OpenGL context."""
        self._renderer.close()


class SimulatedDepthCamera:
    """A camera with depth; several share one renderer, whose owner closes it."""

    def __init__(self, camera: DepthCamera, renderer: DepthRenderer) -> None:
        self.name = f"simulated {camera.name} camera"
        self.size = camera.intrinsics.width, camera.intrinsics.height
        self.intrinsics: Intrinsics | None = camera.intrinsics
        self.renderer = renderer
        self._camera = camera
        self._rng = np.random.default_rng()

    def reseed(self, rng: np.random.Generator) -> None:
        """Draw noise from this stream from now on."""
        self._rng = rng

    def look(self) -> Observation:
        """Colour and depth of the world as it is now."""
        return self.renderer.look(self._camera, self._rng)


class SimulatedHeightMap(HeightMapCamera):
    """Three cameras with depth, placed as the Ravens benchmark places them, as one that looks straight down."""

    def __init__(self, world: World) -> None:
        lens = RAVENS_DEPTH_CAMERAS[0].intrinsics
        self._lens_size = lens.width, lens.height
        renderer = DepthRenderer(world, self._lens_size)
        self._eyes = [SimulatedDepthCamera(each, renderer) for each in RAVENS_DEPTH_CAMERAS]
        poses = [each.T_base_camera for each in RAVENS_DEPTH_CAMERAS]
        super().__init__(self._eyes, poses, name=f"simulated height map of cell {world.cell.number}")

    def enter(self, world: World, usual: Exposure) -> None:
        """Look into another world from now on; these cameras' exposures do not drift."""
        self.close()
        renderer = DepthRenderer(world, self._lens_size)
        for eye in self._eyes:
            eye.renderer = renderer

    def reseed(self, rng: np.random.Generator) -> None:
        """Draw noise from streams that this one spawns from now on, one for each camera."""
        for eye, stream in zip(self._eyes, rng.spawn(len(self._eyes)), strict=True):
            eye.reseed(stream)

    def close(self) -> None:
        """Free the OpenGL context."""
        self._eyes[0].renderer.close()


class NoPictures:
    """The camera of a workcell that was opened without any."""

    name = "no camera"
    size = (0, 0)
    intrinsics: Intrinsics | None = None

    def look(self) -> Observation:
        """Raises `CameraError`."""
        raise CameraError("expected a workcell with pictures, got one without; open it with pictures=True")

    def enter(self, world: World, usual: Exposure) -> None:
        """Nothing: it sees none."""

    def reseed(self, rng: np.random.Generator) -> None:
        """Nothing: it has no noise."""

    def close(self) -> None:
        """Nothing: it has no context."""
