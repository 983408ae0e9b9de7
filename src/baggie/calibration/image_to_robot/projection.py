"""From the robot's base frame to pixels: a lens and a matrix, and how pixels follow each of their numbers.

The matrix takes homogeneous points of the base frame to rays of the camera's frame (z forward, up to a positive
factor), which the lens bends into the picture. It is `(3, 4)` for points (x, y, z, 1) of space, or `(3, 3)`, a
homography, for points (x, y, 1) of one plane (Hartley & Zisserman, "Multiple View Geometry", sections 6.1 and 2.3). A
first one comes from linear least squares on the points that agree best; points that no map can be fitted to are
refused.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from baggie.errors import CalibrationError
from baggie.geometry import FloatArray
from baggie.types import Intrinsics


def homogeneous(matrix: FloatArray, points: FloatArray) -> FloatArray:
    """Points `(N, 3)` metres as the matrix takes them: `(N, 4)`, or `(N, 3)` without their height for a homography."""
    columns = points if matrix.shape[1] == 4 else points[:, :2]
    return np.column_stack([columns, np.ones(len(points))])


def project(lens: Intrinsics, matrix: FloatArray, points: FloatArray) -> FloatArray:
    """Where points `(N, 3)` metres appear: `(N, 2)` pixels."""
    return lens.project(homogeneous(matrix, points) @ matrix.T)


def derivatives(
    lens: Intrinsics, matrix: FloatArray, points: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """`project` and its derivatives at points `(N, 3)` metres.

    Returns the pixels `(N, 2)`, their change with x and y `(N, 2, 2)` in pixels per metre, and with the numbers of
    `to_numbers` `(N, 2, 4 + D + M)`.
    """
    seen_as = homogeneous(matrix, points)
    rays = seen_as @ matrix.T
    still = np.zeros(3)
    pixels, all_of_them = cv2.projectPoints(
        rays.reshape(-1, 1, 3), still, still, lens.matrix, lens.distortion
    )
    jacobian = np.asarray(all_of_them, float).reshape(len(points), 2, -1)
    by_ray = jacobian[:, :, 3:6]  # of a camera that stands still, moving the point is moving the frame
    by_lens = jacobian[:, :, 6 : 10 + len(lens.distortion)]
    by_matrix = (by_ray[..., None] * seen_as[:, None, None, :]).reshape(len(points), 2, -1)
    by_numbers = np.concatenate([by_lens, by_matrix], axis=2)
    return np.asarray(pixels.reshape(-1, 2), float), by_ray @ matrix[:, :2], by_numbers


def to_plane(lens: Intrinsics, matrix: FloatArray, pixels: FloatArray, heights: FloatArray) -> FloatArray:
    """Where the lines of sight of pixels `(N, 2)` meet planes at `heights` `(N,)` metres: `(N, 2)` x, y metres.

    A homography knows one plane and takes no notice of the heights. NaN where a line leads away from its plane.
    """
    rays = np.column_stack([lens.rays(pixels), np.ones(len(pixels))])
    planes = np.broadcast_to(matrix[:, [0, 1, -1]], (len(pixels), 3, 3)).copy()
    if matrix.shape[1] == 4:
        planes[:, :, 2] += heights[:, None] * matrix[:, 2]
    points = np.linalg.solve(planes, rays[..., None])[..., 0]
    points[points[:, 2] <= 0] = np.nan
    return np.asarray(points[:, :2] / points[:, 2:], float)


def to_numbers(lens: Intrinsics, matrix: FloatArray) -> FloatArray:
    """`(4 + D + M,)`: fx, fy, cx, cy, the D distortion coefficients, the matrix row by row."""
    k = lens.matrix
    return np.concatenate([[k[0, 0], k[1, 1], k[0, 2], k[1, 2]], lens.distortion, matrix.ravel()])


def from_numbers(numbers: FloatArray, lens: Intrinsics, matrix: FloatArray) -> tuple[Intrinsics, FloatArray]:
    """The inverse of `to_numbers`; `lens` and `matrix` give size and shapes."""
    fx, fy, cx, cy = (float(number) for number in numbers[:4])
    camera = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    end = 4 + len(lens.distortion)
    return Intrinsics(lens.width, lens.height, camera, numbers[4:end]), numbers[end:].reshape(matrix.shape)


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


MIN_POINTS = 6
MIN_POINTS_TWO_HEIGHTS = 8
_ONE_HEIGHT_M = 0.002
"""Points this close are at one height: a camera 80 cm up, 30 cm to the side, sees the difference as under 0.4 mm."""
_HEIGHTS_APART_M = 0.03
_PER_HEIGHT = 4
OFF_PLANE_M = 0.005


def check_spread(points: FloatArray, pixels: FloatArray, least: int = MIN_POINTS) -> None:
    """Raise `CalibrationError` for fewer than `least` pairs of point and pixel, or pairs nearly on one line."""
    if len(pixels) != len(points) or len(pixels) < least:
        raise CalibrationError(
            f"expected at least {least} pairs of pixel and robot position, got {len(pixels)} pixels and "
            f"{len(points)} positions; collect more points"
        )
    for values, where in ((pixels, "picture"), (points[:, :2], "workspace")):
        if not np.isfinite(values).all():
            raise CalibrationError(f"expected finite points in the {where}, got NaN; leave such points out")
        spread = np.linalg.svd(values - values.mean(axis=0), compute_uv=False)
        if spread[1] < 0.05 * spread[0] or spread[0] == 0:
            raise CalibrationError(
                f"expected points spread over the {where}, got points nearly on one line; move the arm sideways too"
            )


def check_not_mirrored(lens: Intrinsics, matrix: FloatArray, points: FloatArray) -> None:
    """Raise `CalibrationError` where turning left in the picture is turning right on the table.

    Seen from above with u right and v down, det d(x, y)/d(u, v) is negative. `matrix` must be free to be a mirror's,
    as a fitted projection is and a pose is not.
    """
    _, by_xy, _ = derivatives(lens, matrix, points)
    if np.median(np.linalg.det(by_xy)) > 0:
        raise CalibrationError(
            "expected a camera that looks down on x forward, y left, but the picture is mirrored against that; switch "
            "the camera's mirroring off, and check that x and y (or u and v) are not swapped"
        )


def check_agreement(kept: np.ndarray, least: int) -> None:
    """Raise `CalibrationError` unless seven of ten points `(N,)`, and `least`, agree on one camera."""
    needed = max(least, math.ceil(AGREEING * len(kept)))
    if kept.sum() < needed:
        raise CalibrationError(
            f"expected at least {needed} of {len(kept)} points to agree on where the camera is, {kept.sum()} do; "
            "check what was detected in the pictures and that the camera stood still, then collect them again"
        )


def heights_of(points: FloatArray) -> tuple[float, ...]:
    """The heights, metres to a micrometre, at which points `(N, 3)` lie: means of those within 2 mm of a neighbour."""
    z = np.sort(points[:, 2])
    groups = np.split(z, np.flatnonzero(np.diff(z) > _ONE_HEIGHT_M) + 1)
    return tuple(round(float(group.mean()), 6) for group in groups)


def off_plane_m(points: FloatArray) -> float:
    """How far points `(N, 3)` are from their best plane, root mean square, metres."""
    return float(np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[2]) / math.sqrt(len(points))


def at_one_height(points: FloatArray) -> bool:
    """Whether points `(N, 3)` lie within 2 mm of height."""
    return bool(np.ptp(points[:, 2]) <= _ONE_HEIGHT_M)


def check_two_heights(points: FloatArray) -> None:
    """Raise `CalibrationError` unless points `(N, 3)` are high and low enough to tell all of a camera."""
    z = points[:, 2]
    high = z > (z.min() + z.max()) / 2
    apart = z[high].mean() - z[~high].mean()
    few = int(min(high.sum(), (~high).sum()))
    if apart < _HEIGHTS_APART_M or few < _PER_HEIGHT or off_plane_m(points) < OFF_PLANE_M:
        raise CalibrationError(
            f"expected points at one height (within {_ONE_HEIGHT_M * 1000:.0f} mm), or at two at least "
            f"{_HEIGHTS_APART_M * 100:.0f} cm apart with {_PER_HEIGHT} points or more at each, got {few} points "
            f"{apart * 100:.1f} cm from the others; collect a whole grid at each height"
        )
