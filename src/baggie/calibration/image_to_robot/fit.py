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

from baggie.calibration.image_to_robot.adjust import Adjusted, adjust, fit_projection
from baggie.calibration.image_to_robot.checks import (
    MIN_POINTS,
    MIN_POINTS_TWO_HEIGHTS,
    OFF_PLANE_M,
    at_one_height,
    check_agreement,
    check_not_mirrored,
    check_spread,
    check_two_heights,
    off_plane_m,
)
from baggie.calibration.image_to_robot.projection import to_plane
from baggie.calibration.image_to_robot.start import start
from baggie.calibration.pose import fit_pose
from baggie.geometry import FloatArray, rigid
from baggie.types import Intrinsics

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
