"""A lens that bends the picture, as OpenCV's model has it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from baggie.geometry import FloatArray
from baggie.types import Intrinsics

_CENTER_SHARE = 1 / 320
"""Of the picture's width, by which the lens's centre is off the picture's: 4 pixels of 1280."""


@dataclass(frozen=True)
class Lens:
    """A pinhole with radial and tangential distortion in front of a renderer that only knows pinholes.

    The renderer draws an ideal picture with the same size but a field of view wide enough to fill the distorted one
    (`render_fovy`); `distort` resamples it. Distortion: Brown 1966, as `cv2.projectPoints` has it.
    """

    intrinsics: Intrinsics

    @classmethod
    def random(cls, rng: np.random.Generator, size: tuple[int, int], horizontal_fov: float) -> Lens:
        """A lens of the given field of view (radians) whose focal length, centre and distortion vary as made."""
        width, height = size
        focal = width / 2 / np.tan(horizontal_fov / 2) * rng.uniform(0.985, 1.015)
        center = np.array([width - 1, height - 1]) / 2 + rng.normal(0.0, _CENTER_SHARE * width, 2)
        matrix = np.array([[focal, 0.0, center[0]], [0.0, focal, center[1]], [0.0, 0.0, 1.0]])
        k1, k2 = rng.uniform(0.06, 0.10), rng.uniform(-0.07, -0.04)
        p1, p2 = rng.normal(0.0, 6e-4, 2)
        return cls(Intrinsics(width, height, matrix, np.array([k1, k2, p1, p2, rng.uniform(0.0, 0.01)])))

    @property
    def size(self) -> tuple[int, int]:
        """`(width, height)` in pixels."""
        return self.intrinsics.width, self.intrinsics.height

    def project(self, points: FloatArray) -> FloatArray:
        """`(N, 3)` metres in the camera's frame -> `(N, 2)` pixels (u, v)."""
        return self.intrinsics.project(points)

    @cached_property
    def _rays(self) -> FloatArray:
        """`(H, W, 2)`: for each pixel, the ideal ray (x/z, y/z) it sees."""
        width, height = self.size
        v, u = np.mgrid[:height, :width].astype(np.float64)
        pixels = np.stack([u, v], axis=-1).reshape(-1, 2)
        return self.intrinsics.rays(pixels).reshape(height, width, 2)

    @cached_property
    def render_fovy(self) -> float:
        """Vertical field of view, radians, that an ideal picture needs to cover every ray."""
        width, height = self.size
        reach = np.abs(self._rays).reshape(-1, 2).max(axis=0)
        half_height = max(reach[1], reach[0] * height / width) * 1.002
        return float(2 * np.arctan(half_height))

    @cached_property
    def _maps(self) -> tuple[np.ndarray, np.ndarray]:
        """Where in the ideal picture each pixel comes from, in the fixed-point form that `cv2.remap` is fast with."""
        width, height = self.size
        focal = height / 2 / np.tan(self.render_fovy / 2)
        maps = (self._rays * focal + [(width - 1) / 2, (height - 1) / 2]).astype(np.float32)
        return cv2.convertMaps(maps[..., 0], maps[..., 1], cv2.CV_16SC2)

    def distort(self, picture: np.ndarray) -> np.ndarray:
        """Resample an ideal picture `(H, W, ...)`; depth `(H, W)` float is taken from the nearest pixel."""
        nearest = picture.dtype != np.uint8
        return cv2.remap(picture, *self._maps, cv2.INTER_NEAREST if nearest else cv2.INTER_LINEAR)
