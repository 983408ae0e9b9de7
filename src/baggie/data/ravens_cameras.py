"""The three cameras of the Ravens benchmark, as its recordings are read."""

from __future__ import annotations

from baggie.geometry import FloatArray
from baggie.types import Intrinsics
from baggie.vision.depth_camera import RAVENS_DEPTH_CAMERAS

RAVENS_CAMERAS: tuple[tuple[Intrinsics, FloatArray], ...] = tuple(
    (camera.intrinsics, camera.T_base_camera) for camera in RAVENS_DEPTH_CAMERAS
)
"""(intrinsics, `T_base_camera` `(4, 4)`) of the front, left and right camera, in the order of the pictures."""
