"""Height maps with things of any outline `(N, 2)`, pixels (u, v)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np

from baggie.geometry import rotation
from helpers.box_scenes import GRID

HEIGHT_M = 0.04


def shape(
    symmetry: int, radius: float, wave: float, middle: Sequence[float] | np.ndarray = (0.0, 0.0)
) -> np.ndarray:
    """`(N, 2)` pixels: an outline about its middle that looks the same `symmetry` times a turn, 0 for a circle."""
    angle = np.linspace(0, 2 * math.pi, 360, endpoint=False)
    reach = radius * (1 + (wave * np.cos(symmetry * angle) if symmetry else 0))
    return np.c_[reach * np.cos(angle), reach * np.sin(angle)] + np.asarray(middle)


def drawn(outline: np.ndarray, height: float = HEIGHT_M, onto: np.ndarray | None = None) -> np.ndarray:
    """A height map with what the outline `(N, 2)` encloses that much higher."""
    heights = np.zeros(GRID.shape, np.float32) if onto is None else onto.copy()
    mask = np.zeros(GRID.shape, np.uint8)
    cv2.fillPoly(mask, [np.round(outline * 16).astype(np.int32)], 1, cv2.LINE_8, 4)
    heights[mask > 0] += height
    return heights


def after(outline: np.ndarray, places: np.ndarray, turn: float) -> np.ndarray:
    """The outline once it was picked and placed at `places` and turned."""
    return (outline - places[0]) @ rotation(turn).T + places[1]
