"""Cameras with depth in the simulated world: what they see of the table, the arm left out."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from baggie.errors import BaggieError
from baggie.sim.arm_world import ArmWorld
from baggie.sim.renderer import DETAILED_GROUP, OffScreen
from baggie.sim.scene import camera_quaternion
from baggie.sim.sensor import Exposure, Sensor
from baggie.types import Image, Intrinsics, Observation
from baggie.vision.depth_camera import DepthCamera

DEPTH_NOISE_M = 0.001
_USUAL = Exposure()


def add_depth_cameras(scene: mujoco.MjSpec, cameras: Sequence[DepthCamera]) -> None:
    """Give a scene these cameras. Raises `BaggieError` for lenses that MuJoCo has none of."""
    for camera in cameras:
        _check_lens(camera)
        focal_length = camera.intrinsics.matrix[1, 1]
        scene.worldbody.add_camera(
            name=camera.name,
            pos=camera.T_base_camera[:3, 3],
            quat=camera_quaternion(camera.T_base_camera[:3, :3]),
            fovy=float(np.rad2deg(2 * np.arctan(camera.intrinsics.height / 2 / focal_length))),
        )


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


def _check_lens(camera: DepthCamera) -> None:
    """Square pixels, the principal point in the picture's middle, no distortion."""
    lens: Intrinsics = camera.intrinsics
    focal_length = lens.matrix[0, 0]
    ideal = [[focal_length, 0, (lens.width - 1) / 2], [0, focal_length, (lens.height - 1) / 2], [0, 0, 1]]
    if not np.allclose(lens.matrix, ideal) or np.any(lens.distortion):
        raise BaggieError(
            f"expected the camera {camera.name!r} to have square pixels, its principal point in the middle and no "
            f"distortion, got the matrix {lens.matrix.tolist()} and distortion {lens.distortion.tolist()}; the "
            "simulator renders no other"
        )
