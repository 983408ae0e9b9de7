"""Height maps as other cameras and other lamps would show them: gaps that nobody looks into, shadows cast elsewhere.

Cameras look from aside, so what they see between things depends on which way these stand. From one demonstration a
network takes that, and which way the shadow fell, for the task.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from baggie.types import Image

_GAP_M = 0.01
"""A gap is deeper."""
_SHADOW_PX = 16
"""Shadows are no longer."""


class Light(NamedTuple):
    """A lamp aside."""

    way: float
    """Where it comes from, radians from u towards v."""
    rise: float
    """Metres by which it falls a metre of its way."""
    dark: float
    """The share of all light that is missing in its shadow."""

    @classmethod
    def random(cls, rng: np.random.Generator) -> Self:
        """From anywhere."""
        return cls(rng.uniform(-math.pi, math.pi), rng.uniform(0.5, 3.0), rng.uniform(0.1, 0.5))


def with_gaps_closed(
    color: Image, height: NDArray[np.float32], size_px: int
) -> tuple[Image, NDArray[np.float32]]:
    """Colours `(H, W, 3)` and heights `(H, W)` metres of a map whose gaps look like the highest thing beside them.

    Closed are those narrower than `size_px`, an odd number of pixels; none where that is 1.
    """
    square = np.ones((size_px, size_px), np.uint8)
    closed = cv2.morphologyEx(height, cv2.MORPH_CLOSE, square)
    gaps = closed > height + _GAP_M
    if not gaps.any():
        return color, height
    # Of each pixel's surroundings the highest, told by its height in tenths of millimetres and its number: exact only
    # in double precision.
    numbers = np.arange(height.size, dtype=float).reshape(height.shape)
    highest = cv2.dilate(np.round(height.astype(float) * 1e4) * height.size + numbers, square)
    beside = (highest[gaps] % height.size).astype(int)
    closed_color = color.copy()
    closed_color[gaps] = color.reshape(-1, 3)[beside]
    return closed_color, np.where(gaps, closed, height)


def with_shadow(color: Image, height: NDArray[np.float32], light: Light, pixel_m: float) -> Image:
    """The colours `(H, W, 3)` of a map with a shadow cast over its heights `(H, W)`; pixels are of `pixel_m` metres."""
    shadow = np.zeros(height.shape, np.uint8)
    rows, columns = height.shape
    for far in range(1, _SHADOW_PX + 1):
        move = np.array([[1.0, 0.0, -far * math.cos(light.way)], [0.0, 1.0, -far * math.sin(light.way)]])
        # What is so far towards the light.
        there = cv2.warpAffine(
            height, move, (columns, rows), flags=cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE
        )
        shadow |= there > height + far * pixel_m * light.rise
    left = 1 - light.dark * cv2.blur(shadow.astype(np.float32), (3, 3))
    return np.asarray((color * left[..., None]).round(), np.uint8)
