"""A camera's lens, OpenCV's model of it, and its sensor: exposure, white balance, vignetting, noise, 8 bits."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from baggie.geometry import FloatArray
from baggie.types import Image, Intrinsics

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


READ_NOISE = 1.6  # standard deviation of a dark pixel, in 8-bit steps
SHOT_NOISE = 1.8  # what is added at full brightness
DEPTH_NOISE_M = 0.0015
_SLACK = 128  # pixels by which the noise tile is larger than a picture


@dataclass(frozen=True)
class Exposure:
    """Exposure and colour cast of one picture."""

    gain: float = 1.0
    cast: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Gain of R, G and B."""

    @classmethod
    def random(cls, rng: np.random.Generator) -> Exposure:
        """The drift of daylight and of automatic exposure from one attempt to the next."""
        cast = 1.0 + rng.normal(0.0, 0.025, 3)
        return cls(float(rng.uniform(0.88, 1.12)), (float(cast[0]), float(cast[1]), float(cast[2])))

    def times(self, other: Exposure) -> Exposure:
        """Multiply two exposures."""
        (a, b, c), (d, e, f) = self.cast, other.cast
        return Exposure(self.gain * other.gain, (a * d, b * e, c * f))


class Sensor:
    """Turns an ideal picture into a recorded one. One per camera: the vignette belongs to it."""

    def __init__(
        self, size: tuple[int, int], vignette: float = 0.18, depth_noise_m: float = DEPTH_NOISE_M
    ) -> None:
        width, height = size
        v, u = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j]
        fall_off = 1.0 - vignette * (u**2 + v**2) / 2
        self._depth_noise_m = depth_noise_m
        self._vignette = np.repeat((fall_off * 255).astype(np.uint8)[..., None], 3, axis=2)
        # Fresh noise for a million pixels costs more than the picture. One tile with room to spare is drawn once, and
        # every picture takes its window from another corner of it.
        tile = np.random.default_rng(0x5E7502).standard_normal(
            (height + _SLACK, width + _SLACK, 3), np.float32
        )
        self._noise = (64 * tile).round().astype(np.int16)

    def expose(self, picture: Image, exposure: Exposure, rng: np.random.Generator) -> Image:
        """The picture as this sensor would record it: `(H, W, 3)` uint8 -> the same."""
        levels = np.arange(256)[:, None] * (exposure.gain * np.array(exposure.cast))
        lit = cv2.LUT(picture, np.clip(levels, 0, 255).astype(np.uint8)[:, None, :])
        lit = cv2.multiply(lit, self._vignette, scale=1 / 255)
        height, width = picture.shape[:2]
        top, left = rng.integers(_SLACK, size=2)
        noise = np.ascontiguousarray(self._noise[top : top + height, left : left + width])
        strength = cv2.LUT(lit, _NOISE_STRENGTH)
        noisy = cv2.multiply(noise, strength.astype(np.int16), scale=1 / (64 * 64))
        return np.asarray(cv2.add(noisy, lit, dtype=cv2.CV_8U))

    def pass_over(self, rng: np.random.Generator) -> None:
        """Draw what noise of depth would be made of, for nothing."""
        rng.integers(_SLACK, size=2)

    def measure_depth(self, depth: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Depth with a time-of-flight camera's noise, in whole millimetres: `(H, W)` float32 metres."""
        height, width = depth.shape
        top, left = rng.integers(_SLACK, size=2)
        noise = self._noise[top : top + height, left : left + width, 0] * np.float32(self._depth_noise_m / 64)
        return np.asarray(np.round((depth + noise) * 1000) / 1000, np.float32)


# Standard deviation of the noise at each brightness, in 1/64 of an 8-bit step.
_NOISE_STRENGTH = (
    (64 * np.sqrt(READ_NOISE**2 + SHOT_NOISE**2 * np.arange(256) / 255)).round().astype(np.uint8)
)
