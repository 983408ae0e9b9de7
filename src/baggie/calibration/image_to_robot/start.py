"""A first projection from points some of which are wrong, by linear least squares on those that agree best."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from baggie.calibration.image_to_robot.projection import homogeneous
from baggie.geometry import FloatArray
from baggie.types import Intrinsics

AGREEING = 0.7
"""Share of the points that has to be right."""
_SAMPLES = 100
"""With three of ten points wrong, all of 100 samples of six have a wrong one in 4 of a million cases."""
_STEPS = 4


@dataclass(frozen=True)
class Start:
    """What seven of ten points agree on."""

    matrix: FloatArray
    """`(3, 4)` for space or `(3, 3)` for a plane."""
    agreeing: NDArray[np.bool_]
    """`(N,)`, those points."""
    error: float
    """Their summed squared error, in rays."""


def start(lens: Intrinsics, points: FloatArray, pixels: FloatArray, columns: int) -> Start:
    """The matrix `(3, columns)`, 4 for space and 3 for a plane, that explains seven of ten points best.

    From random samples, refitted to the points nearest to them, then the better half of those, and so on: least trimmed
    squares (Rousseeuw & Van Driessen, "Computing LTS Regression for Large Data Sets", 2006) on the direct linear
    transformation (Hartley & Zisserman, section 4.1) with points `(N, 3)` brought to mean 0 and unit size. The same
    points in the same order give the same matrix.
    """
    mean, size = points.mean(axis=0), max(float(points.std()), 1e-9)
    known = homogeneous(np.empty((3, columns)), (points - mean) / size)
    rays = lens.rays(pixels)
    forms = _quadratic_forms(known, rays)
    most = max(math.ceil(AGREEING * len(points)), columns + 2)
    drawn = np.random.default_rng(0).random((_SAMPLES, len(points)))
    chosen = np.argsort(drawn, axis=1)[:, : 6 if columns == 4 else 4]
    for _ in range(_STEPS):
        matrices = _smallest(forms, chosen).reshape(-1, 3, columns)
        seen = matrices @ known.T  # (S, 3, N)
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = np.linalg.norm(seen[:, :2] / seen[:, 2:] - rays.T, axis=1)
        distance = np.where(np.isfinite(distance), distance, np.inf)
        chosen = np.argsort(distance, axis=1, kind="stable")[:, :most]
        errors = (np.take_along_axis(distance, chosen, axis=1) ** 2).sum(axis=1)
        better = np.argsort(errors, kind="stable")[: max(len(errors) // 2, 1)]
        matrices, chosen, errors = matrices[better], chosen[better], errors[better]
    undo = np.diag([1 / size] * (columns - 1) + [1.0])
    undo[:-1, -1] = -mean[: columns - 1] / size
    agreeing = np.isin(np.arange(len(points)), chosen[0])
    return Start(normalized(matrices[0] @ undo, points), agreeing, float(errors[0]))


def normalized(matrix: FloatArray, points: FloatArray) -> FloatArray:
    """The matrix times a number: `points` `(N, 3)` in front of the camera, depth in metres where it knows space."""
    depth = (homogeneous(matrix, points) @ matrix.T)[:, 2]
    scale = float(np.linalg.norm(matrix[2, :3]) if matrix.shape[1] == 4 else np.linalg.norm(matrix))
    return matrix * math.copysign(1 / scale, float(np.median(depth)))


def _quadratic_forms(known: FloatArray, rays: FloatArray) -> FloatArray:
    """`(N, 3 m, 3 m)`: the squared error of a flattened matrix at each point, linear in it squared."""
    nothing = np.zeros_like(known)
    rows = np.stack(
        [
            np.concatenate([known, nothing, -rays[:, :1] * known], axis=1),
            np.concatenate([nothing, known, -rays[:, 1:] * known], axis=1),
        ],
        axis=1,
    )  # (N, 2, 3 m)
    return np.asarray(rows.transpose(0, 2, 1) @ rows, float)


def _smallest(forms: FloatArray, chosen: NDArray[np.intp]) -> FloatArray:
    """For each row of indices `(S, k)`, the unit vector `(S, 3 m)` with the least error at those points."""
    weights = np.zeros((len(chosen), len(forms)))
    np.put_along_axis(weights, chosen, 1.0, axis=1)
    _, vectors = np.linalg.eigh(np.tensordot(weights, forms, axes=1))
    return np.asarray(vectors[:, :, 0], float)
