"""The pose of a camera from points of known position in one picture, robustly and with its uncertainty."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from baggie.calibration.uncertain import UncertainTransform
from baggie.errors import CalibrationError
from baggie.geometry import FloatArray, rigid
from baggie.types import Intrinsics

NOISE_PX, NOISE_COUNTS = 0.15, 4
"""How far off points usually are, per axis, and for how many residuals that knowledge counts: of a lone marker, with
eight numbers seen and six fitted, the residuals say next to nothing."""

_GROSS_PX = 8.0
"""Further off than this, a point was confused with something else."""
_STDS = 4.0
_FLOOR_PX = 0.5
"""A point is kept up to four standard deviations, or half a pixel: noise-free points differ by rounding alone."""


@dataclass(frozen=True)
class PoseFit:
    """Where a frame is for a camera, and how well that explains the picture."""

    pose: UncertainTransform
    """`T_camera_frame`."""
    residuals_px: FloatArray
    """`(N, 2)`, of all points, outliers included."""
    inliers: NDArray[np.bool_]
    """`(N,)`."""

    @property
    def rms_px(self) -> float:
        """Root mean square distance of the inliers, pixels."""
        return float(np.sqrt((self.residuals_px[self.inliers] ** 2).sum(axis=1).mean()))


def fit_pose(
    points: ArrayLike,
    pixels: ArrayLike,
    intrinsics: Intrinsics,
    intrinsics_covariance: FloatArray | None = None,
    start: FloatArray | None = None,
) -> PoseFit:
    """`T_camera_frame` from points `(N, 3)` metres and where they are seen `(N, 2)`, at least four.

    RANSAC finds those that agree (skipped where a `start` `(4, 4)` is given), least squares on reprojection settles
    the rest, points four standard deviations off are left out. The covariance has the points' own scatter in it and,
    where `intrinsics_covariance` `(4 + D, 4 + D)` of fx, fy, cx, cy and the distortion is given, the lens's.

    Raises `CalibrationError` when no pose explains enough of the points.
    """
    points, pixels = np.asarray(points, float).reshape(-1, 3), np.asarray(pixels, float).reshape(-1, 2)
    if len(points) < 4:
        raise CalibrationError(f"expected at least 4 points for a camera's pose, got {len(points)}")
    pose = _ransac(points, pixels, intrinsics) if start is None else start
    inliers = np.linalg.norm(residuals_px(pose, points, pixels, intrinsics), axis=1) < _GROSS_PX
    for _ in range(10):
        if inliers.sum() < max(4, 0.5 * len(points)):
            raise CalibrationError(
                f"expected most of {len(points)} points to agree on where the camera is, {inliers.sum()} do; "
                "check what was detected, the stated sizes, and that no axes are swapped or mirrored"
            )
        pose = _refine(pose, points[inliers], pixels[inliers], intrinsics)
        residuals = residuals_px(pose, points, pixels, intrinsics)
        distance = np.linalg.norm(residuals, axis=1)
        # The median of a two-dimensional normal distribution's length is 1.18 standard deviations.
        limit = max(_STDS * np.median(distance[inliers]) / 1.18, _FLOOR_PX)
        kept = distance < limit
        if np.array_equal(kept, inliers):
            break
        inliers = kept
    covariance = _covariance(pose, points[inliers], residuals[inliers], intrinsics, intrinsics_covariance)
    return PoseFit(UncertainTransform(pose, covariance), residuals, inliers)


def both_planar_poses(
    points: ArrayLike, pixels: ArrayLike, intrinsics: Intrinsics
) -> list[tuple[FloatArray, float]]:
    """The two poses that nearly explain a flat target, better one first, each with its error in pixels (RMS).

    Seen from afar, a slanted plane and its mirror image look alike (Collins & Bartoli, "Infinitesimal Plane-Based Pose
    Estimation", 2014). Each is refined by least squares before they are compared; what sags a little is taken as flat
    until then.
    """
    points, pixels = np.asarray(points, float).reshape(-1, 3), np.asarray(pixels, float).reshape(-1, 2)
    count, turns, shifts, _ = cv2.solvePnPGeneric(
        points * [1.0, 1.0, 0.0], pixels, intrinsics.matrix, intrinsics.distortion, flags=cv2.SOLVEPNP_IPPE
    )
    found = []
    for turn, shift in zip(turns[:count], shifts[:count], strict=True):
        pose = _refine(rigid(cv2.Rodrigues(turn)[0], shift), points, pixels, intrinsics)
        error = residuals_px(pose, points, pixels, intrinsics)
        found.append((pose, float(np.sqrt((error**2).sum(axis=1).mean()))))
    return sorted(found, key=lambda candidate: candidate[1])


def residuals_px(
    pose: FloatArray, points: FloatArray, pixels: FloatArray, intrinsics: Intrinsics
) -> FloatArray:
    """`(N, 2)`: where points appear with `T_camera_frame`, less where they were seen."""
    turn, _ = cv2.Rodrigues(pose[:3, :3])
    seen, _ = cv2.projectPoints(points, turn, pose[:3, 3], intrinsics.matrix, intrinsics.distortion)
    return np.asarray(seen.reshape(-1, 2) - pixels, float)


def _ransac(points: FloatArray, pixels: FloatArray, intrinsics: Intrinsics) -> FloatArray:
    cv2.setRNGSeed(0)
    found, turn, shift, _ = cv2.solvePnPRansac(
        points,
        pixels,
        intrinsics.matrix,
        intrinsics.distortion,
        iterationsCount=500,
        reprojectionError=_GROSS_PX,
        confidence=0.9999,
        flags=cv2.SOLVEPNP_SQPNP,
    )
    if not found:
        raise CalibrationError(
            f"no position of the camera explains these {len(points)} points; check what was detected, the stated "
            "sizes, and that no axes are swapped or mirrored"
        )
    return rigid(cv2.Rodrigues(turn)[0], shift)


def _refine(pose: FloatArray, points: FloatArray, pixels: FloatArray, intrinsics: Intrinsics) -> FloatArray:
    def moved(error: FloatArray) -> FloatArray:
        turned = Rotation.from_rotvec(error[:3]).as_matrix() @ pose[:3, :3]
        return rigid(turned, pose[:3, 3] + error[3:])

    def residuals(error: FloatArray) -> FloatArray:
        return residuals_px(moved(error), points, pixels, intrinsics).ravel()

    solution = least_squares(residuals, np.zeros(6), method="lm", xtol=1e-14, ftol=1e-14, gtol=1e-14)
    return moved(solution.x)


def _covariance(
    pose: FloatArray,
    points: FloatArray,
    residuals: FloatArray,
    intrinsics: Intrinsics,
    intrinsics_covariance: FloatArray | None,
) -> FloatArray:
    in_camera = points @ pose[:3, :3].T
    still = np.zeros(3)
    # Turned about the camera's own axes: exactly the error (w, d) of `UncertainTransform`.
    _, jacobian = cv2.projectPoints(in_camera, still, pose[:3, 3], intrinsics.matrix, intrinsics.distortion)
    by_pose = jacobian[:, :6]
    # The noise is itself known from few residuals only: the mean of an inverse gamma distribution.
    counts = residuals.size - 6 + NOISE_COUNTS
    variance = (float((residuals**2).sum()) + NOISE_COUNTS * NOISE_PX**2) / (counts - 2)
    inverse = np.linalg.pinv(by_pose.T @ by_pose)
    covariance = variance * inverse
    if intrinsics_covariance is not None:
        gain = inverse @ by_pose.T @ jacobian[:, 6 : 6 + len(intrinsics_covariance)]
        covariance = covariance + gain @ intrinsics_covariance @ gain.T
    return np.asarray(covariance, float)
