"""Lenses that their makers describe in another way than OpenCV does."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from baggie.geometry import FloatArray
from baggie.types import Intrinsics

_GRID = 21
"""Rays looked along for each side of the picture."""


def fit_distortion(
    size: tuple[int, int], matrix: FloatArray, pixel: Callable[[FloatArray], FloatArray]
) -> Intrinsics:
    """OpenCV's k1, k2, p1, p2, k3 of a lens that is known by the pixels that see rays.

    `pixel` maps a ray (x/z, y/z) to (u, v). With the camera matrix given, the model is linear in its coefficients:

        x_d - x = x (k1 r² + k2 r⁴ + k3 r⁶) + p1 2xy + p2 (r² + 2x²)

    and likewise for y, so this is one least-squares problem over the whole picture.
    """
    width, height = size
    u, v = np.meshgrid(np.linspace(0, width - 1, _GRID), np.linspace(0, height - 1, _GRID))
    middle, focal = matrix[:2, 2], np.diag(matrix)[:2]
    rays = (np.c_[u.ravel(), v.ravel()] - middle) / focal
    seen = (np.array([pixel(ray) for ray in rays]) - middle) / focal
    x, y = rays.T
    r2 = x**2 + y**2
    terms_x = np.c_[x * r2, x * r2**2, 2 * x * y, r2 + 2 * x**2, x * r2**3]
    terms_y = np.c_[y * r2, y * r2**2, r2 + 2 * y**2, 2 * x * y, y * r2**3]
    terms, moved = np.r_[terms_x, terms_y], np.r_[seen[:, 0] - x, seen[:, 1] - y]
    coefficients = np.linalg.lstsq(terms, moved, rcond=None)[0]
    return Intrinsics(width, height, np.asarray(matrix, float), np.asarray(coefficients, float))
