"""Rigid transforms with their uncertainty, and a camera's pose from points of known position in one picture.

Of a flat target two poses explain what is seen; the corners, or depth, say which is the true one.

A true transform is `R = exp(w) R0`, `t = t0 + d` with a small error (w, d), radians and metres, in the frame the
transform maps *to*. Its covariance is `(6, 6)`, w first. Errors travel through inversion and composition to first
order (Barfoot & Furgale, "Associating Uncertainty With Three-Dimensional Poses", 2014, with this choice of error).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from baggie.errors import CalibrationError
from baggie.geometry import FloatArray, invert_transform, is_rigid, rigid, transform_points
from baggie.types import Intrinsics

_ROUNDING = 1e-9
_RIGID = 1e-6
"""How far a rotation's rows may be from orthonormal: these files keep all digits."""


@dataclass(frozen=True)
class UncertainTransform:
    """`T_a_b` and the covariance of its error."""

    transform: FloatArray
    """`(4, 4)`, maps points of frame b into frame a."""
    covariance: FloatArray
    """`(6, 6)`: rotation (radians) and then translation (metres), in frame a."""

    def inverse(self) -> UncertainTransform:
        """`T_b_a`: R' = R0ᵀ exp(-w), t' = -R' t."""
        rotation, t = self.transform[:3, :3], self.transform[:3, 3]
        zero = np.zeros((3, 3))
        jacobian = np.block([[-rotation.T, zero], [-rotation.T @ _cross(t), -rotation.T]])
        return UncertainTransform(invert_transform(self.transform), jacobian @ self.covariance @ jacobian.T)

    def __matmul__(self, other: UncertainTransform) -> UncertainTransform:
        """`T_a_b @ T_b_c`, their errors independent."""
        rotation, zero = self.transform[:3, :3], np.zeros((3, 3))
        ours = np.block([[np.eye(3), zero], [-_cross(rotation @ other.transform[:3, 3]), np.eye(3)]])
        theirs = np.block([[rotation, zero], [zero, rotation]])
        covariance = ours @ self.covariance @ ours.T + theirs @ other.covariance @ theirs.T
        return UncertainTransform(self.transform @ other.transform, covariance)

    @property
    def std_mm(self) -> float:
        """One standard deviation of the position, root mean square over directions in space together."""
        return float(np.sqrt(np.trace(self.covariance[3:, 3:]))) * 1000

    @property
    def std_deg(self) -> float:
        """One standard deviation of the rotation, degrees."""
        return float(np.degrees(np.sqrt(np.trace(self.covariance[:3, :3]))))

    def summary(self) -> dict[str, float]:
        """How sure it is, ready for JSON."""
        return {"std_mm": self.std_mm, "std_deg": self.std_deg}

    def error_of(self, truth: ArrayLike) -> FloatArray:
        """`(6,)`: the error (w, d) that would make this transform the true one."""
        from scipy.spatial.transform import Rotation  # noqa: PLC0415 -- who only reads a pose does not wait for it

        truth = np.asarray(truth, float)
        turn = Rotation.from_matrix(truth[:3, :3] @ self.transform[:3, :3].T).as_rotvec()
        return np.concatenate([turn, truth[:3, 3] - self.transform[:3, 3]])

    def holds(self, truth: ArrayLike, probability: float = 0.95) -> bool:
        """Whether `truth` `(4, 4)` lies in the region that is to hold it with this probability."""
        error = self.error_of(truth)
        # Where there is no uncertainty at all, there may be no error but what rounding leaves.
        distance = error @ np.linalg.inv(self.covariance + _ROUNDING**2 * np.eye(6)) @ error
        return bool(distance <= squared_radius(probability))


def squared_radius(probability: float) -> float:
    """Squared radius, in standard deviations, of the region that holds an error's six numbers with this probability.

    The quantile of a chi-square distribution; from scipy.special, as scipy.stats takes half a second to import.
    """
    from scipy.special import gammaincinv  # noqa: PLC0415 -- as above

    return float(2 * gammaincinv(6 / 2, probability))


def _cross(v: FloatArray) -> FloatArray:
    """`(3, 3)`, with `_cross(a) @ b == cross(a, b)`."""
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


_NOISE_PX, _NOISE_COUNTS = 0.15, 4
"""How far off points usually are, per axis, and for how many residuals that knowledge counts: of a lone marker, with
eight numbers seen and six fitted, the residuals say next to nothing."""

_GROSS_PX = 8.0
"""Further off than this, a point was confused with something else."""
_MAX_COUNTS = 20
"""Corners of one print are off together; more than this many residuals are not counted as independent."""
_DEPTH_TELLS = 1.3
_MIN_DEPTHS = 20
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


def odds(better_px: float, worse_px: float, corners: int) -> float:
    """How many times likelier the pose with the smaller RMS error is, given the errors of both.

    The ratio of the two likelihoods with the noise integrated out, its prior an inverse gamma distribution around what
    corners usually are off: with 8 numbers seen and 6 fitted, a marker's own residuals say next to nothing about noise.
    """
    prior = _NOISE_COUNTS * _NOISE_PX**2
    better, worse = (corners * error**2 + prior for error in (better_px, worse_px))
    counts = min(2 * corners - 6 + _NOISE_COUNTS, _MAX_COUNTS)
    return float(min((worse / better) ** (counts / 2), 1e12))


@dataclass(frozen=True)
class MeasuredDepth:
    """Depth over a flat target, measured."""

    points: FloatArray
    """`(M, 3)` metres, target frame, spread over it."""
    depth_m: FloatArray
    """`(M,)` along the optical axis."""

    @classmethod
    def over(
        cls,
        corners: FloatArray,
        T_camera_target: FloatArray,
        intrinsics: Intrinsics,
        images: Sequence[NDArray[np.float32]],
    ) -> MeasuredDepth | None:
        """Median depth of images `(H, W)` between corners `(N, 3)` of a target; None where too little is known."""
        low, high = corners.min(axis=0), corners.max(axis=0)
        x, y = np.meshgrid(np.linspace(low[0], high[0], 20), np.linspace(low[1], high[1], 20))
        points = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
        u, v = np.rint(intrinsics.project(transform_points(T_camera_target, points))).astype(int).T
        inside = (u >= 0) & (u < intrinsics.width) & (v >= 0) & (v < intrinsics.height)
        samples = np.array([image[v[inside], u[inside]] for image in images], float)
        known = np.isfinite(samples) & (samples > 0)
        enough = 2 * known.sum(axis=0) >= len(images)
        if enough.sum() < _MIN_DEPTHS:
            return None
        depth = np.nanmedian(np.where(known, samples, np.nan)[:, enough], axis=0)
        return cls(points[inside][enough], depth)

    def ratio(self, T_camera_target: FloatArray) -> float:
        """Measured over what the pose says, the median."""
        return float(np.median(self.depth_m / self._expected(T_camera_target)))

    def choose(self, pose: FloatArray, other: FloatArray) -> FloatArray | None:
        """The one of two poses `T_camera_target` that depth supports; None where it cannot tell either."""
        first, second = self._misfit(pose), self._misfit(other)
        if max(first, second) < _DEPTH_TELLS * min(first, second):
            return None
        return pose if first < second else other

    def _expected(self, pose: FloatArray) -> FloatArray:
        return transform_points(pose, self.points)[:, 2]

    def _misfit(self, pose: FloatArray) -> float:
        """Relative, once a wrong scale is taken out: slant is what tells the two apart."""
        relative = self.depth_m / self._expected(pose)
        return float(np.median(np.abs(relative / np.median(relative) - 1)))


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
    from scipy.optimize import least_squares  # noqa: PLC0415 -- as above
    from scipy.spatial.transform import Rotation  # noqa: PLC0415

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
    counts = residuals.size - 6 + _NOISE_COUNTS
    variance = (float((residuals**2).sum()) + _NOISE_COUNTS * _NOISE_PX**2) / (counts - 2)
    inverse = np.linalg.pinv(by_pose.T @ by_pose)
    covariance = variance * inverse
    if intrinsics_covariance is not None:
        gain = inverse @ by_pose.T @ jacobian[:, 6 : 6 + len(intrinsics_covariance)]
        covariance = covariance + gain @ intrinsics_covariance @ gain.T
    return np.asarray(covariance, float)


def uncertainty_to_yaml(pose: UncertainTransform) -> dict[str, Any]:
    """What stands beside `T_a_b`; the covariance is of rotation (radians) and translation (metres), in frame a."""
    return {**pose.summary(), "covariance": pose.covariance}


def pose_from_yaml(content: Mapping[str, Any], name: str) -> UncertainTransform:
    """`T_a_b` called `name`, with its `uncertainty`. Raises `KeyError`, `TypeError` or `ValueError` when damaged."""
    covariance = np.array(content["uncertainty"]["covariance"], float).reshape(6, 6)
    return UncertainTransform(rigid_from_yaml(content, name), covariance)


def rigid_from_yaml(content: Mapping[str, Any], name: str) -> FloatArray:
    """`(4, 4)` called `name`. Raises `KeyError`, `TypeError` or `ValueError` when it is no rigid transform."""
    transform = np.array(content[name], float)
    if not is_rigid(transform, _RIGID):
        raise ValueError(f"{name} is not a rotation and a translation, 4 x 4 numbers")
    return transform
