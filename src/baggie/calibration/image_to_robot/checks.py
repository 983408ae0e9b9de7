"""Which points a map from the picture to the robot can be fitted to, and why others are refused."""

from __future__ import annotations

import math

import numpy as np

from baggie.calibration.image_to_robot.projection import derivatives
from baggie.calibration.image_to_robot.start import AGREEING
from baggie.errors import CalibrationError
from baggie.geometry import FloatArray
from baggie.types import Intrinsics

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
