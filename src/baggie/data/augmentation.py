"""Random changes to pictures that leave the label known: warps of the plane, and of the light."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from baggie.geometry import FloatArray, apply_homography
from baggie.types import Image


@dataclass(frozen=True)
class WarpRange:
    """How far random warps go."""

    rotation: float = math.radians(30)
    """Radians, either way."""
    scale: float = 1.2
    """Times larger or smaller."""
    shear: float = 0.1
    perspective: float = 0.1
    """Change of scale across the picture's longer side."""
    shift: float = 0.2
    """Of the picture's longer side, either way."""
    margin: float = 0.07
    """Points that must stay in the picture keep this distance from its edge, of its longer side."""


def random_warp(
    rng: np.random.Generator,
    size: tuple[int, int],
    keep: FloatArray,
    limits: WarpRange = WarpRange(),
    tries: int = 8,
) -> FloatArray:
    """A random homography of the picture `(3, 3)`, pixels -> pixels of the warped picture.

    Points `keep` `(N, 2)` pixels (u, v) end inside the `(width, height)` picture; when `tries` draws do not
    fit, the picture is left as it is.
    """
    width, height = size
    longer = max(size)
    center = (np.array([width, height]) - 1) / 2
    low, high = np.full(2, limits.margin * longer), np.array([width, height]) - 1 - limits.margin * longer
    for _ in range(tries):
        warp = _about(_linear(rng, limits), center)
        warp = _about(_tilt(rng, limits.perspective / longer), center) @ warp
        moved = apply_homography(warp, keep)
        shift_low = np.maximum(low - moved.min(axis=0), -limits.shift * longer)
        shift_high = np.minimum(high - moved.max(axis=0), limits.shift * longer)
        if (shift_low <= shift_high).all():
            shift = np.eye(3)
            shift[:2, 2] = rng.uniform(shift_low, shift_high)
            return shift @ warp
    return np.eye(3)


def random_light(rng: np.random.Generator, strength: float = 1.0) -> Image:
    """A random exposure, white balance, black level and contrast: a table `(256, 3)` uint8 to look colours up
    in.
    """
    level = np.linspace(0, 1, 256)[:, None]
    gamma = math.exp(strength * rng.normal(0, 0.1))
    gain = np.exp(strength * (rng.normal(0, 0.12) + rng.normal(0, 0.05, 3)))
    black = strength * rng.normal(0, 0.02)
    return np.asarray(np.clip(255 * (gain * level**gamma + black), 0, 255).round(), np.uint8)


def _linear(rng: np.random.Generator, limits: WarpRange) -> FloatArray:
    angle = rng.uniform(-limits.rotation, limits.rotation)
    scale = limits.scale ** rng.uniform(-1, 1)
    c, s = scale * math.cos(angle), scale * math.sin(angle)
    sheared = np.array([[c, -s], [s, c]]) @ [[1.0, rng.uniform(-limits.shear, limits.shear)], [0.0, 1.0]]
    return np.block([[sheared, np.zeros((2, 1))], [np.zeros((1, 2)), np.ones((1, 1))]])


def _tilt(rng: np.random.Generator, slope: float) -> FloatArray:
    tilt = np.eye(3)
    tilt[2, :2] = rng.uniform(-slope, slope, 2)
    return tilt


def _about(matrix: FloatArray, center: FloatArray) -> FloatArray:
    """The same map with its origin moved to `center`."""
    to_center = np.eye(3)
    to_center[:2, 2] = center
    from_center = np.eye(3)
    from_center[:2, 2] = -center
    return np.asarray(to_center @ matrix @ from_center)
