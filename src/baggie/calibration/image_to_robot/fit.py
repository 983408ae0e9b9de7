"""Fitting the camera to points the robot knows: least squares on the error in the picture, where the noise is.

Three cases. With known intrinsics the camera's pose, 6 numbers. Without, from points at two heights, a projection
matrix, 11 numbers; from one height, a homography, 8. In the last two, lens terms about the picture's centre are
estimated along, but only those that make points which were left out come out better.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from baggie.calibration.image_to_robot.projection import (
    MIN_POINTS,
    MIN_POINTS_TWO_HEIGHTS,
    OFF_PLANE_M,
    at_one_height,
    check_agreement,
    check_not_mirrored,
    check_spread,
    check_two_heights,
    derivatives,
    from_numbers,
    normalized,
    off_plane_m,
    project,
    start,
    to_numbers,
    to_plane,
)
from baggie.calibration.pose import fit_pose
from baggie.geometry import FloatArray, rigid
from baggie.types import Intrinsics

_LENS_TERMS = ((), (4,), (4, 5), (2, 3, 4, 5))
"""Places in `to_numbers` of what is estimated along: nothing, k1, k1 and k2, these and the centre of distortion."""
_BETTER = 0.9
"""More terms have to make left-out points this much better; by chance they are a few per cent better or worse."""
_NOISELESS_PX = 1e-3
_STEPS = 100
"""Points of a camera take about ten; nonsense never settles."""
_NEEDED = 1e-9
"""Of det(1 - H): the other points do not determine the fit without this one."""


@dataclass(frozen=True)
class Adjusted:
    """A least squares fit and its first-order statistics."""

    lens: Intrinsics
    matrix: FloatArray
    basis: FloatArray
    """`(4 + D + M, p)`: how the numbers of `to_numbers` follow what was fitted."""
    by_numbers: FloatArray
    """`(2 N, 4 + D + M)`, derivative of the pixels."""
    by_xy: FloatArray
    """`(N, 2, 2)`, pixels per metre."""
    spread: FloatArray
    """`(p, p)`: covariance of what was fitted, for pixels with variance 1."""
    left_out_px: FloatArray
    """`(N, 2)`: residuals from fits to the other points; infinite where those cannot do without the point."""
    variance: float
    """Of a pixel's coordinate."""

    @classmethod
    def of(
        cls, lens: Intrinsics, matrix: FloatArray, basis: FloatArray, points: FloatArray, pixels: FloatArray
    ) -> Adjusted:
        """The statistics of a fit that has converged.

        A residual r of a point with leverage H becomes (1 - H)^-1 r when the point is left out.
        """
        seen, by_xy, by_each = derivatives(lens, matrix, points)
        by_numbers = by_each.reshape(-1, by_each.shape[2])
        jacobian = by_numbers @ basis
        scale = np.linalg.norm(jacobian, axis=0)
        left, singular, right = np.linalg.svd(jacobian / scale, full_matrices=False)
        told = singular > 1e-9 * singular[0]
        left, weighted = left[:, told], right[told].T / singular[told] / scale[:, None]
        blocks = left.reshape(len(points), 2, -1)
        rest = np.eye(2) - blocks @ blocks.transpose(0, 2, 1)
        residuals = seen - pixels
        needed = np.linalg.det(rest) < _NEEDED
        rest[needed] = np.eye(2)
        left_out = np.linalg.solve(rest, residuals[..., None])[..., 0]
        left_out[needed] = np.inf
        # Both allow for the scatter being known from a few points only: Student's t with as many degrees has the
        # first variance; the second, of left-out points, also grows with what the model cannot explain.
        spare = max(residuals.size - int(told.sum()), 3)
        variance = max(float((residuals**2).sum()) / (spare - 2), float((left_out**2).mean()))
        return cls(lens, matrix, basis, by_numbers, by_xy, weighted @ weighted.T, left_out, variance)

    def distance_px(self, points: FloatArray, pixels: FloatArray, used: NDArray[np.bool_]) -> FloatArray:
        """`(N,)`: how far each point is off, in pixels of equal likelihood, where the fit `used` some `(N,)` of them.

        A point the fit was drawn to comes out nearer than it should, with covariance 1 - H, and another one farther,
        with 1 + H.
        """
        seen, _, by_each = derivatives(self.lens, self.matrix, points)
        moved = by_each @ self.basis
        leverage = moved @ self.spread @ moved.transpose(0, 2, 1)
        shape = np.eye(2) + np.where(used, -1.0, 1.0)[:, None, None] * leverage
        residuals = seen - pixels
        shape[np.linalg.det(shape) < _NEEDED] = np.eye(2)
        weighted = np.linalg.solve(shape, residuals[..., None])[..., 0]
        return np.asarray(np.sqrt(np.maximum((residuals * weighted).sum(axis=1), 0.0)), float)

    @property
    def covariance(self) -> FloatArray:
        """`(4 + D + M, 4 + D + M)` of the numbers of `to_numbers`."""
        return self.variance * self.basis @ self.spread @ self.basis.T

    @property
    def left_out_rms_px(self) -> float:
        """Root mean square length."""
        return float(np.sqrt((self.left_out_px**2).sum(axis=1).mean()))


def fit_projection(lens: Intrinsics, matrix: FloatArray, points: FloatArray, pixels: FloatArray) -> Adjusted:
    """The fit with as few lens terms as left-out points allow."""
    best: Adjusted | None = None
    for terms in _LENS_TERMS:
        if best is not None and best.left_out_rms_px < _NOISELESS_PX:
            break
        straight = replace(lens, distortion=np.zeros(4 if terms else 0))
        fit = adjust(straight, matrix, terms, points, pixels)
        if best is None or fit.left_out_rms_px < _BETTER * best.left_out_rms_px:
            best = fit
    assert best is not None
    return best


def adjust(
    lens: Intrinsics, matrix: FloatArray, terms: tuple[int, ...], points: FloatArray, pixels: FloatArray
) -> Adjusted:
    """Least squares on reprojection over the matrix, whose scale has no meaning, and these lens terms."""
    from scipy.linalg import null_space  # noqa: PLC0415 -- who only reads a map does not wait for it
    from scipy.optimize import least_squares  # noqa: PLC0415

    numbers = to_numbers(lens, matrix)
    basis = np.zeros((len(numbers), len(terms) + matrix.size - 1))
    basis[terms, range(len(terms))] = 1.0
    basis[-matrix.size :, len(terms) :] = null_space(matrix.reshape(1, -1))

    def residuals(change: FloatArray) -> FloatArray:
        return (project(*from_numbers(numbers + basis @ change, lens, matrix), points) - pixels).ravel()

    def jacobian(change: FloatArray) -> FloatArray:
        _, _, by_each = derivatives(*from_numbers(numbers + basis @ change, lens, matrix), points)
        return by_each.reshape(-1, len(numbers)) @ basis

    still = np.zeros(basis.shape[1])
    solution = least_squares(
        residuals, still, jacobian, method="lm", xtol=1e-14, ftol=1e-14, gtol=1e-14, max_nfev=_STEPS
    )
    lens, found = from_numbers(numbers + basis @ solution.x, lens, matrix)
    matrix = normalized(found, points)
    basis[-matrix.size :] *= np.linalg.norm(matrix) / np.linalg.norm(found)
    return Adjusted.of(lens, matrix, basis, points, pixels)


LensOrigin = Literal["calibrated", "estimated", "none"]

_FIRST_K1 = (-0.3, -0.2, -0.1, 0.0, 0.1, 0.2)
_STDS = 4.0
_FLOOR_PX = 0.5
_ROUNDS = 10


@dataclass(frozen=True)
class Solution:
    """A fitted camera, and what it makes of the points."""

    lens: Intrinsics
    origin: LensOrigin
    matrix: FloatArray
    """`(3, 4)` or `(3, 3)`, as `baggie.calibration.image_to_robot.projection` has it."""
    covariance: FloatArray
    """`(4 + D + M, 4 + D + M)` of the numbers of `to_numbers`."""
    kept: NDArray[np.bool_]
    """`(N,)`: points that were used; the others are more than four standard deviations off."""
    error_m: FloatArray
    """`(N, 2)`: where each pixel is mapped at its point's height, less where the point was."""
    left_out_m: FloatArray
    """`(N, 2)`: the same from a fit to the other points, to first order."""


def solve(
    points: FloatArray,
    pixels: FloatArray,
    size: tuple[int, int],
    intrinsics: Intrinsics | None,
    intrinsics_covariance: FloatArray | None,
) -> Solution:
    """Fit to points `(N, 3)` metres in the robot's base frame and where they are seen, `(N, 2)` pixels.

    The order of the points makes no difference. Raises `CalibrationError` for points that cannot tell.
    """
    check_spread(points, pixels)
    order = np.lexsort((*pixels.T, *points.T))
    points, pixels = points[order], pixels[order]
    if intrinsics is None:
        found = _fit_unknown(points, pixels, nominal_lens(size))
    else:
        found = _fit_known(points, pixels, intrinsics, intrinsics_covariance)
    back = np.argsort(order)
    return replace(
        found, kept=found.kept[back], error_m=found.error_m[back], left_out_m=found.left_out_m[back]
    )


def nominal_lens(size: tuple[int, int]) -> Intrinsics:
    """A pinhole in the middle of the picture with a focal length of half its width: 90 degrees wide."""
    width, height = size
    half = width / 2
    matrix = np.array([[half, 0.0, (width - 1) / 2], [0.0, half, (height - 1) / 2], [0.0, 0.0, 1.0]])
    return Intrinsics(width, height, matrix, np.zeros(0))


def _fit_known(
    points: FloatArray, pixels: FloatArray, lens: Intrinsics, lens_covariance: FloatArray | None
) -> Solution:
    begun = start(lens, points, pixels, columns=4 if off_plane_m(points) >= OFF_PLANE_M else 3)
    check_not_mirrored(lens, begun.matrix, points[begun.agreeing])
    first = _pose(points[begun.agreeing], pixels[begun.agreeing], lens)
    fit = fit_pose(points, pixels, lens, start=first)
    check_agreement(fit.inliers, MIN_POINTS)
    check_spread(points[fit.inliers], pixels[fit.inliers])
    matrix = fit.pose.transform[:3]
    fixed = 4 + len(lens.distortion)
    # Turned about the camera by w and moved by d, row i of [R | t] becomes that of [(1 + w x) R | t + d].
    basis = np.zeros((fixed + 12, 6))
    for axis in range(3):
        turned = np.cross(np.eye(3)[axis], matrix[:, :3], axisb=0, axisc=0)
        basis[fixed:, axis] = np.column_stack([turned, np.zeros(3)]).ravel()
        basis[fixed + 4 * axis + 3, 3 + axis] = 1.0
    adjusted = Adjusted.of(lens, matrix, basis, points[fit.inliers], pixels[fit.inliers])
    covariance = adjusted.covariance
    if lens_covariance is not None:
        # A wrong lens also moves the pose that was fitted with it.
        by_lens = adjusted.by_numbers[:, :fixed]
        through = np.eye(fixed + 12)[:, :fixed] - basis @ (
            adjusted.spread @ (adjusted.by_numbers @ basis).T @ by_lens
        )
        covariance = covariance + through @ lens_covariance @ through.T
    solution = _solution(adjusted, fit.inliers, points, pixels)
    return replace(solution, origin="calibrated", covariance=covariance)


def _fit_unknown(points: FloatArray, pixels: FloatArray, lens: Intrinsics) -> Solution:
    space = not at_one_height(points)
    least = MIN_POINTS_TWO_HEIGHTS if space else MIN_POINTS
    check_spread(points, pixels, least)
    if space:
        check_two_heights(points)
    kept, fit = _first(points, pixels, lens, columns=4 if space else 3)
    check_not_mirrored(fit.lens, fit.matrix, points[kept])
    for _ in range(_ROUNDS):
        distance = fit.distance_px(points, pixels, kept)
        # The median of a two-dimensional normal distribution's length is 1.18 standard deviations; what was chosen
        # for agreeing scatters too little (Rousseeuw & Leroy, "Robust Regression", 1987, section 5.1).
        few = 1 + 5 / max(len(points) - fit.basis.shape[1] / 2, 1)
        within = distance < max(_STDS * few * float(np.median(distance)) / 1.18, _FLOOR_PX)
        check_agreement(within, least)
        fit, before, kept = fit_projection(lens, fit.matrix, points[within], pixels[within]), kept, within
        if np.array_equal(before, kept):
            break
    check_spread(points[kept], pixels[kept], least)
    if space:
        check_two_heights(points[kept])
    return _solution(fit, kept, points, pixels)


def _first(
    points: FloatArray, pixels: FloatArray, lens: Intrinsics, columns: int
) -> tuple[NDArray[np.bool_], Adjusted]:
    """Seven of ten points that agree on a camera with some radial distortion, and that camera."""
    lenses = [replace(lens, distortion=np.array([k1, 0.0, 0.0, 0.0])) for k1 in _FIRST_K1]
    starts = [start(bent, points, pixels, columns) for bent in lenses]
    best = min(range(len(starts)), key=lambda i: starts[i].error)
    kept = starts[best].agreeing
    return kept, adjust(lenses[best], starts[best].matrix, (4,), points[kept], pixels[kept])


def _pose(points: FloatArray, pixels: FloatArray, lens: Intrinsics) -> FloatArray:
    """`T_camera_base` from points all of which are right."""
    _, turn, shift = cv2.solvePnP(points, pixels, lens.matrix, lens.distortion, flags=cv2.SOLVEPNP_SQPNP)
    return rigid(cv2.Rodrigues(turn)[0], shift)


def _solution(
    adjusted: Adjusted, kept: NDArray[np.bool_], points: FloatArray, pixels: FloatArray
) -> Solution:
    error = to_plane(adjusted.lens, adjusted.matrix, pixels, points[:, 2]) - points[:, :2]
    left_out = error.copy()
    # The map leads from the pixel to the table, so the error there has the opposite sign.
    left_out[kept] = -np.linalg.solve(adjusted.by_xy, adjusted.left_out_px[..., None])[..., 0]
    origin: LensOrigin = "estimated" if adjusted.lens.distortion.size else "none"
    return Solution(adjusted.lens, origin, adjusted.matrix, adjusted.covariance, kept, error, left_out)
