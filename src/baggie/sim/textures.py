"""Procedural textures: a table top with grain, cloth woven or printed."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from baggie.geometry import FloatArray
from baggie.sim.bag import BagParameters, Fabric
from baggie.types import Image


def table_top(rng: np.random.Generator, color: tuple[int, int, int], grain: float, size: int = 512) -> Image:
    """A wooden or laminated surface, `(size, size, 3)`: streaks along one side, blotches, a few marks."""
    streaks = cv2.GaussianBlur(rng.normal(size=(size, size)), (0, 0), sigmaX=40, sigmaY=1.2)
    blotches = cv2.resize(rng.normal(size=(12, 12)), (size, size), interpolation=cv2.INTER_CUBIC)
    pattern = streaks / streaks.std() + 0.5 * blotches
    picture = np.array(color) * (1 + grain * pattern[..., None] / 2)
    for _ in range(6):  # pencil marks and scratches
        start, end = rng.integers(0, size, (2, 2))
        end = start + (end - start) // 6
        shade = [int(value) for value in np.array(color) * rng.uniform(0.6, 0.9)]
        cv2.line(picture, start.tolist(), end.tolist(), shade, 1, cv2.LINE_AA)
    return np.asarray(np.clip(picture, 0, 255), np.uint8)


def cloth(rng: np.random.Generator, bag: BagParameters, size: int = 128) -> Image:
    """A bag's cloth, `(size, size, 3)`, stretched over its length and width: threads or a print, a seam at the edge."""
    v, u = np.mgrid[:size, :size]
    threads = np.sin(u * 2 * np.pi / 8) * np.sin(v * 2 * np.pi / 8) if bag.fabric == "weave" else 0.0
    mottle = cv2.resize(rng.normal(size=(8, 8)), (size, size), interpolation=cv2.INTER_CUBIC)
    if bag.shape == "round":
        edge = size / 2 - np.hypot(u - (size - 1) / 2, v - (size - 1) / 2)
    else:
        edge = np.minimum(np.minimum(u, v), np.minimum(size - 1 - u, size - 1 - v))
    seam = -1.5 * np.exp(-(((edge - 8) / 2.0) ** 2))
    printed = _print(
        bag.fabric, u * bag.length_m / size / bag.repeat_m, v * bag.width_m / size / bag.repeat_m
    )
    color = np.where(printed[..., None], bag.accent, bag.color)
    picture = color * (1 + bag.weave * (0.5 * threads + 0.3 * mottle + seam)[..., None])
    return np.asarray(np.clip(picture, 0, 255), np.uint8)


def _print(fabric: Fabric, x: FloatArray, y: FloatArray) -> NDArray[np.bool_]:
    """Where on the cloth the accent's colour is; `x` and `y` in repeats of the print."""
    if fabric == "stripes":
        return np.asarray(y % 1 < 0.5)
    if fabric == "checks":
        return np.asarray((x % 1 < 0.5) ^ (y % 1 < 0.5))
    if fabric == "dots":
        return np.asarray(np.hypot(x % 1 - 0.5, y % 1 - 0.5) < 0.28)
    return np.zeros(np.shape(x), bool)
