"""What the lens's own uncertainty does to a hand-eye calibration: the same error in every view, which no view shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from baggie.calibration.hand_eye.refine import Pair
from baggie.calibration.hand_eye.reproject import reproject
from baggie.calibration.hand_eye.views import HandEyeViews
from baggie.calibration.uncertain import UncertainTransform
from baggie.geometry import FloatArray
from baggie.types import Intrinsics


def lens_share(views: HandEyeViews, pair: Pair) -> FloatArray:
    """`(6, 6)`: the part of the covariance of `T_mount_camera` that is the lens's; zero where that is not known.

    Each parameter is moved by its standard deviation and the transforms are fitted again.
    """
    lens, covariance = views.intrinsics, views.intrinsics_covariance
    if lens is None or covariance is None or views.seen is None:
        return np.zeros((6, 6))
    start = reproject(pair, views.T_stand_mount, views.seen, lens).pair
    still = UncertainTransform(start[0], np.zeros((6, 6)))
    stds = np.sqrt(np.diag(covariance))
    moves = np.zeros((6, len(stds)))
    for k in np.flatnonzero(stds):
        fitted = reproject(start, views.T_stand_mount, views.seen, _moved(lens, int(k), stds[k])).pair
        moves[:, k] = still.error_of(fitted[0]) / stds[k]
    return np.asarray(moves @ covariance @ moves.T)


def _moved(lens: Intrinsics, parameter: int, by: float) -> Intrinsics:
    """With one of fx, fy, cx, cy and then the distortion moved."""
    matrix, distortion = lens.matrix.copy(), lens.distortion.copy()
    distortion.resize(max(5, distortion.size))  # zeros, where `np.resize` would begin again
    if parameter < 4:
        matrix[[(0, 0), (1, 1), (0, 2), (1, 2)][parameter]] += by
    else:
        distortion[parameter - 4] += by
    return replace(lens, matrix=matrix, distortion=distortion)
