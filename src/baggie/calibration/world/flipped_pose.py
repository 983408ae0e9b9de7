"""Which of the two poses that explain a flat target is the true one: by the corners, or by depth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from baggie.calibration.pose import NOISE_COUNTS, NOISE_PX
from baggie.geometry import FloatArray, transform_points
from baggie.types import Intrinsics

_MAX_COUNTS = 20
"""Corners of one print are off together; more than this many residuals are not counted as independent."""
_DEPTH_TELLS = 1.3
_MIN_DEPTHS = 20


def odds(better_px: float, worse_px: float, corners: int) -> float:
    """How many times likelier the pose with the smaller RMS error is, given the errors of both.

    The ratio of the two likelihoods with the noise integrated out, its prior an inverse gamma distribution around what
    corners usually are off: with 8 numbers seen and 6 fitted, a marker's own residuals say next to nothing about noise.
    """
    prior = NOISE_COUNTS * NOISE_PX**2
    better, worse = (corners * error**2 + prior for error in (better_px, worse_px))
    counts = min(2 * corners - 6 + NOISE_COUNTS, _MAX_COUNTS)
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
        """Between a target's corners `(N, 3)`: the median of the images `(H, W)`; None where too little is known."""
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
