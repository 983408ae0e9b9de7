"""Renderers of the world: the workcell's camera, cameras with depth that leave the arm out, a film of the arm."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from baggie.gl import claim, require_backend
from baggie.sim.arm_world import ArmWorld
from baggie.sim.cell import Cell
from baggie.sim.sensor import Exposure, Sensor
from baggie.types import Image, Observation
from baggie.vision.height_map import DepthCamera
from baggie.vision.targets import Target

DETAILED_GROUP, HULL_GROUP = 2, 3  # the geom groups of `fr3.xml`
HIDDEN_GROUP = 5  # which no renderer draws


class RenderedWorld(Protocol):
    """What a camera looks at: an `ArmWorld`, or a copy of one."""

    model: mujoco.MjModel
    data: mujoco.MjData
    cell: Cell
    printed: dict[str, tuple[Target, float]]

    @property
    def time(self) -> float: ...  # noqa: D102 -- a world's attribute


class OffScreen:
    """MuJoCo's renderer for a world, opened with the first picture: a process that takes none may be forked."""

    def __init__(self, world: RenderedWorld, size: tuple[int, int], samples: int = 0) -> None:
        """`size`: `(width, height)` of all pictures, pixels; `samples` of each, which smooth edges.

        Raises `BaggieError` where nothing can render off screen.
        """
        require_backend()
        self._world, self._size, self._samples = world, size, samples
        self._opened: mujoco.Renderer | None = None

    def renderer(self) -> mujoco.Renderer:
        """MuJoCo's renderer with all that was printed since. Raises `BaggieError` in a fork of who has rendered."""
        if self._opened is None:
            self._opened = self._open()
            self._copied = dict(self._world.printed)
        self._refresh(self._opened)
        return self._opened

    def close(self) -> None:
        """Free the OpenGL context, if there is one."""
        if self._opened is not None:
            self._opened.close()

    def _open(self) -> mujoco.Renderer:
        claim()
        width, height = self._size
        quality = self._world.model.vis.quality
        quality.offsamples = self._samples  # read when the context is made
        opened = mujoco.Renderer(self._world.model, height, width)
        quality.offsamples = 0
        return opened

    def _refresh(self, renderer: mujoco.Renderer) -> None:
        """Copy what was printed since into the context's own textures, all of them fresh when it is made."""
        for name, print_ in self._world.printed.items():
            if self._copied.get(name) != print_:
                # MuJoCo's wrapper has no public way to its context.
                renderer._gl_context.make_current()
                texture = self._world.model.texture(name).id
                mujoco.mjr_uploadTexture(self._world.model, renderer._mjr_context, texture)
                self._copied[name] = print_


class CameraRenderer:
    """The overhead colour and depth camera: ideal rendering, then the lens, then the sensor."""

    def __init__(self, world: RenderedWorld) -> None:
        """Raises `BaggieError` where nothing can render off screen."""
        self._world = world
        self._lens = world.cell.lens
        self._off_screen = OffScreen(world, self._lens.size)
        self._sensor = Sensor(self._lens.size)
        self._detailed = np.flatnonzero(world.model.geom_group == DETAILED_GROUP)
        self._hulls = np.flatnonzero(world.model.geom_group == HULL_GROUP)

    def look(
        self, exposure: Exposure, rng: np.random.Generator, depth_rng: np.random.Generator | None = None
    ) -> Observation:
        """A picture of the world as it is now, with depth where there is a stream to draw its noise from."""
        renderer = self._off_screen.renderer()
        # A step ends with joints where they are now and bodies where they were before it: a hand that has not quite
        # come to rest would be seen where it was, up to a tenth of a millimetre from where its joints say it is.
        mujoco.mj_kinematics(self._world.model, self._world.data)
        with self._arm_simplified():
            renderer.update_scene(self._world.data, "top")
        color = self._lens.distort(renderer.render())
        measured = None if depth_rng is None else self._depth(renderer, depth_rng)
        self._sensor.pass_over(rng)  # pictures of a seed are as they were when this stream drew depth, too
        recorded = self._sensor.expose(color, exposure, rng)
        return Observation(recorded, measured, time=self._world.time)

    def _geoms_in_view(self) -> NDArray[np.bool_]:
        """Which of the arm's detailed geoms reach into the picture, by their bounding spheres."""
        centers = self._world.data.geom_xpos[self._detailed]
        distance = (centers - self._world.cell.camera_position) @ self._world.cell.camera_rotation[:, 2]
        radius = self._world.model.geom_rbound[self._detailed]
        reach = self._lens.intrinsics.matrix[0, 0] * radius / np.maximum(distance, 0.05) + 40.0
        pixels = self._world.cell.project(centers)
        inside = (pixels > -reach[:, None]) & (pixels < np.array(self._lens.size) + reach[:, None])
        return np.asarray(inside.all(axis=1) & (distance > 0))

    @contextmanager
    def _arm_simplified(self) -> Iterator[None]:
        """Draw what is out of the picture as the hull that casts its shadow, not as 240,000 triangles."""
        groups = self._world.model.geom_group
        usual = groups.copy()
        seen = self._geoms_in_view()
        groups[self._detailed[~seen]] = HIDDEN_GROUP
        bodies = self._world.model.geom_bodyid
        unseen_hulls = self._hulls[~np.isin(bodies[self._hulls], bodies[self._detailed[seen]])]
        groups[unseen_hulls] = DETAILED_GROUP
        try:
            yield
        finally:
            groups[:] = usual

    def _depth(self, renderer: mujoco.Renderer, rng: np.random.Generator) -> np.ndarray:
        renderer.enable_depth_rendering()
        ideal = renderer.render()
        renderer.disable_depth_rendering()
        return self._sensor.measure_depth(self._lens.distort(ideal), rng)

    def close(self) -> None:
        """Free the OpenGL context."""
        self._off_screen.close()


class Film:
    """Collects frames of the arm at work, from beside the table, at a steady rate of simulated time."""

    def __init__(self, world: ArmWorld, size: tuple[int, int], fps: float) -> None:
        self.frames: list[Image] = []
        self._world = world
        self._off_screen = OffScreen(world, size, samples=4)
        self._period = 1.0 / fps
        self._next = world.time

    def watch(self) -> None:
        """Take a frame when one is due."""
        now = self._world.time
        if now < self._next - 1.5 * self._period:  # the world was reset
            self._next = now
        if now >= self._next:
            renderer = self._off_screen.renderer()
            renderer.update_scene(self._world.data, camera="film")
            self.frames.append(renderer.render().copy())
            self._next += self._period

    def close(self) -> None:
        """Free the OpenGL context."""
        self._off_screen.close()


DEPTH_NOISE_M = 0.001
_USUAL = Exposure()


class DepthRenderer:
    """Colour and depth of one pass each, from the cameras of a world.

    The arm is not drawn, as if it were parked where it neither covers nor shades anything.
    """

    def __init__(self, world: ArmWorld, size: tuple[int, int]) -> None:
        """`size`: `(width, height)` of all pictures, pixels. Raises `BaggieError` where nothing can render."""
        width, height = size
        self._world = world
        self._off_screen = OffScreen(world, size)
        self._shown = mujoco.MjvOption()
        self._shown.geomgroup[DETAILED_GROUP] = 0
        self._sensor = Sensor(size, vignette=0.0, depth_noise_m=DEPTH_NOISE_M)
        self._color = np.empty((height, width, 3), np.uint8)
        self._depth = np.empty((height, width), np.float32)

    def look(self, camera: DepthCamera, rng: np.random.Generator) -> Observation:
        """What this camera sees now, with the noise of its sensor: about 2 grey levels, and 1 mm of depth."""
        color, depth = self._ideal(camera.name)
        return Observation(
            self._sensor.expose(color, _USUAL, rng),
            self._sensor.measure_depth(depth, rng),
            camera.intrinsics,
            self._world.time,
        )

    def close(self) -> None:
        """Free the OpenGL context."""
        self._off_screen.close()

    def _ideal(self, name: str) -> tuple[Image, NDArray[np.float32]]:
        """`(H, W, 3)` uint8 RGB and `(H, W)` metres along the optical axis."""
        renderer = self._off_screen.renderer()
        renderer.update_scene(self._world.data, name, self._shown)
        # MuJoCo's wrapper renders once for colour and once more for depth; there is no public way to read both.
        renderer._gl_context.make_current()
        mujoco.mjr_render(renderer._rect, renderer._scene, renderer._mjr_context)
        mujoco.mjr_readPixels(self._color, self._depth, renderer._rect, renderer._mjr_context)
        # As read, depth is 1 at the near plane and 0 at the far one, linear in 1 / distance.
        extent, clip = self._world.model.stat.extent, self._world.model.vis.map
        near, far = np.float32(clip.znear * extent), np.float32(clip.zfar * extent)
        depth = near * far / (self._depth * (far - near) + near)
        return self._color[::-1], np.asarray(depth[::-1], np.float32)
