"""Hand-eye calibration from pictures: the board's corners as they must appear, against where they were seen.

Only `T_mount_camera` and `T_stand_board` are unknown (Tabb & Ahmad Yousef, "Solving the robot-world hand-eye(s)
calibration problem with iterative methods", 2017; Koide & Menegatti, "General hand-eye calibration based on
reprojection error minimization", 2019), and corners far off count less (soft L1).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.optimize import least_squares

from baggie.calibration.hand_eye.refine import Pair, cross_matrices, moved
from baggie.geometry import FloatArray
from baggie.types import Intrinsics
from baggie.vision.targets import Seen

_FLOOR_PX = 0.01
"""Corners are not found better than this, whatever a perfect rendering says."""
_NEAREST_M = 1e-3
"""Corners at or behind the lens, in a bad start, are taken as this far in front of it."""


@dataclass(frozen=True)
class Reprojected:
    """A fit to corners."""

    pair: Pair
    covariance: FloatArray
    """`(12, 12)`: rotation (radians) and translation (metres) of both; the corners' errors taken as independent."""


def reproject(
    start: Pair, stand_mount: FloatArray, seen: Sequence[Seen], intrinsics: Intrinsics
) -> Reprojected:
    """The best transforms near the given ones, for poses `(N, 4, 4)`, metres, and the board as seen from each."""
    view = np.repeat(np.arange(len(seen)), [len(board.pixels) for board in seen])
    points = np.concatenate([board.points for board in seen])
    pixels = np.concatenate([board.pixels for board in seen])
    turns, shifts = stand_mount[view, :3, :3], stand_mount[view, :3, 3]

    def in_mount(z: FloatArray) -> FloatArray:
        in_stand = points @ z[:3, :3].T + z[:3, 3]
        return np.asarray(np.einsum("nji,nj->ni", turns, in_stand - shifts), float)

    def projected(x: FloatArray, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        in_camera = (in_mount(z) - x[:3, 3]) @ x[:3, :3]
        in_camera[:, 2] = np.maximum(in_camera[:, 2], _NEAREST_M)
        still = np.zeros(3)
        uv, by_all = cv2.projectPoints(in_camera, still, still, intrinsics.matrix, intrinsics.distortion)
        errors, by_point = uv.reshape(-1, 2) - pixels, by_all[:, 3:6].reshape(-1, 2, 3)
        return np.asarray(errors, float), np.asarray(by_point, float)

    def at(step: FloatArray) -> Pair:
        return moved(pair[0], step[:6]), moved(pair[1], step[6:])

    def residuals(step: FloatArray) -> FloatArray:
        return projected(*at(step))[0].ravel()

    def jacobian(step: FloatArray) -> FloatArray:
        x, z = at(step)
        by_point = projected(x, z)[1] @ x[:3, :3].T
        by_stand_point = by_point @ turns.transpose(0, 2, 1)
        parts = [
            by_point @ cross_matrices(in_mount(z) - x[:3, 3]),
            -by_point,
            -by_stand_point @ cross_matrices(points @ z[:3, :3].T),
            by_stand_point,
        ]
        return np.concatenate(parts, axis=2).reshape(-1, 12)

    # The second round starts near the solution: there the Jacobian, of errors about no rotation, is exact, and the
    # median says how large a usual error is.
    pair, step = start, np.zeros(12)
    for _ in range(2):
        pair = at(step)
        usual = max(1.4826 * float(np.median(np.abs(residuals(np.zeros(12))))), _FLOOR_PX)
        solution = least_squares(
            residuals,
            np.zeros(12),
            jac=jacobian,
            loss="soft_l1",
            f_scale=2 * usual,
            x_scale="jac",
            xtol=1e-10,
            ftol=1e-10,
        )
        step = solution.x
    # The solution's Jacobian has the weights of the loss in it.
    inverse = np.linalg.pinv(solution.jac.T @ solution.jac, hermitian=True)
    return Reprojected(at(step), usual**2 * inverse)
