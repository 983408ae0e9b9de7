"""Hand-eye calibration, one method at a time: closed forms, and least squares on poses or on pictures.

Unknown are `T_mount_camera` and `T_stand_board` together (Dornaika & Horaud, "Simultaneous robot-world and hand-eye
calibration", 1998). A view's error is how far its own `T_stand_board` is from the common one: a rotation and a
translation of the board's origin. Their scales are not known beforehand and decide how they weigh against each other;
both come from the errors themselves (median), in turns with the fit. Views far off get the weight a Student t
distribution gives them (Lange, Little & Taylor, "Robust statistical modeling using the t distribution", 1989).

The mount carries the camera, the stand carries the board, so that for every view

    T_stand_mount @ T_mount_camera @ T_camera_board = T_stand_board

with the same two unknown transforms. For a camera on the hand the mount is the hand and the stand the base; for a
fixed camera the mount is the base and the stand the hand.

From pictures, the errors are between the board's corners as they must appear and where they were seen (Tabb & Ahmad
Yousef, "Solving the robot-world hand-eye(s) calibration problem with iterative methods", 2017; Koide & Menegatti,
"General hand-eye calibration based on reprojection error minimization", 2019), and corners far off count less (soft
L1).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from baggie.errors import CalibrationError
from baggie.geometry import FloatArray, rigid
from baggie.types import Intrinsics
from baggie.vision.targets import TargetDetection

MIN_VIEWS = 3
"""Two motions; fewer leave the translation along the one axis open."""

CLOSED_FORMS = {"park": cv2.CALIB_HAND_EYE_PARK, "daniilidis": cv2.CALIB_HAND_EYE_DANIILIDIS}
"""Rotation before translation (Park & Martin 1994), and both at once (Daniilidis 1999). From what OpenCV has besides
(Tsai, Horaud, Andreff, Shah, Li) refinements end within micrometres of where they end from these."""


def closed_form(method: str, stand_mount: FloatArray, camera_board: FloatArray) -> FloatArray:
    """`T_mount_camera` `(4, 4)` from `T_stand_mount` and `T_camera_board`, both `(N, 4, 4)` in metres.

    Raises `CalibrationError` where the method finds no rigid transform.
    """
    try:
        turn, shift = cv2.calibrateHandEye(
            *_parts(stand_mount), *_parts(camera_board), method=CLOSED_FORMS[method]
        )
    except cv2.error as error:
        raise CalibrationError(f"{method} finds no solution for {len(stand_mount)} views") from error
    if not (np.isfinite(turn).all() and np.isfinite(shift).all()) or np.linalg.det(turn) <= 0:
        raise CalibrationError(f"{method} finds no rigid transform for {len(stand_mount)} views")
    return rigid(Rotation.from_matrix(turn).as_matrix(), shift)


def _parts(poses: FloatArray) -> tuple[Sequence[FloatArray], Sequence[FloatArray]]:
    return list(poses[:, :3, :3]), list(poses[:, :3, 3])


Noise = Literal["alike", "depth apart"]
"""Translation equally noisy along all axes, or with a scale of its own along the optical axis."""

_GROUPS = {"alike": (0, 0, 0, 1, 1, 1), "depth apart": (0, 0, 0, 1, 1, 2)}
_FREEDOM = 20.0
"""Degrees of freedom of the t distribution."""
_EXACT = 1e-9
"""Radians and metres: rounding, below which noise is not estimated."""
_ROUNDS = 12
_SETTLED = 0.001
"""Of a standard deviation: smaller steps change nothing that matters."""

Pair = tuple[FloatArray, FloatArray]
"""`T_mount_camera` and `T_stand_board`, each `(4, 4)`."""


@dataclass(frozen=True)
class Refined:
    """A fit to poses."""

    pair: Pair
    scale: float
    """The true size of the board over the stated one; 1 where it was not asked for."""
    covariance: FloatArray
    """`(12, 12)` or, with the scale, `(13, 13)`: rotation (radians) and translation (metres) of both transforms, as of
    an `UncertainTransform`, then the scale."""


def refine(
    start: Pair,
    stand_mount: FloatArray,
    camera_board: FloatArray,
    *,
    noise: Noise = "alike",
    with_scale: bool = False,
) -> Refined:
    """The best transforms near the given ones, for poses `(N, 4, 4)`, metres, of at least 3 views."""
    pair, scale = start, 1.0
    size = 13 if with_scale else 12
    for _ in range(_ROUNDS):
        errors = view_errors(pair, stand_mount, scaled(camera_board, scale))
        whiten = _whiten(errors, (stand_mount @ pair[0])[:, :3, :3], noise, size)
        step, covariance = _solve(pair, stand_mount, scaled(camera_board, scale), whiten, size)
        pair = moved(pair[0], step[:6]), moved(pair[1], step[6:12])
        scale *= 1 + step[12] if with_scale else 1.0
        if (np.abs(step) < _SETTLED * np.sqrt(np.diag(covariance))).all():
            break
    return Refined(pair, scale, covariance)


def view_errors(pair: Pair, stand_mount: FloatArray, camera_board: FloatArray) -> FloatArray:
    """`(N, 6)`: each view's own `T_stand_board` against the pair's: rotation (radians), translation (metres)."""
    own = stand_mount @ pair[0] @ camera_board
    turns = Rotation.from_matrix(own[:, :3, :3] @ pair[1][:3, :3].T).as_rotvec()
    return np.hstack([turns, own[:, :3, 3] - pair[1][:3, 3]])


def mean_board(mount_camera: FloatArray, stand_mount: FloatArray, camera_board: FloatArray) -> FloatArray:
    """`T_stand_board` `(4, 4)` as the views have it: the mean of their rotations, the median of each coordinate."""
    own = stand_mount @ mount_camera @ camera_board
    turn = Rotation.from_matrix(own[:, :3, :3]).mean().as_matrix()
    return rigid(turn, np.median(own[:, :3, 3], axis=0))


def moved(transform: FloatArray, error: FloatArray) -> FloatArray:
    """`transform` with the error (w, d) of an `UncertainTransform`: `exp(w) R`, `t + d`."""
    turn = Rotation.from_rotvec(error[:3]).as_matrix()
    return rigid(turn @ transform[:3, :3], transform[:3, 3] + error[3:])


def scaled(poses: FloatArray, scale: float) -> FloatArray:
    """Poses `(N, 4, 4)` with their translations times `scale`."""
    result = poses.copy()
    result[:, :3, 3] *= scale
    return result


def cross_matrices(vectors: FloatArray) -> FloatArray:
    """`(N, 3)` -> `(N, 3, 3)`, with `cross_matrices(a) @ b == cross(a, b)`."""
    x, y, z = np.asarray(vectors).T
    o = np.zeros_like(x)
    return np.stack([o, -z, y, z, o, -x, -y, x, o], axis=-1).reshape(-1, 3, 3)


def _whiten(errors: FloatArray, camera_axes: FloatArray, noise: Noise, unknowns: int) -> FloatArray:
    """`(N, 6, 6)`: what makes each view's error one of unit variance in the camera's axes, and weighs outliers down."""
    groups = np.array(_GROUPS[noise])
    to_camera = np.zeros((len(errors), 6, 6))
    to_camera[:, :3, :3] = to_camera[:, 3:, 3:] = camera_axes.transpose(0, 2, 1)
    in_camera = np.einsum("nij,nj->ni", to_camera, errors)
    spare = errors.size / (errors.size - unknowns)
    std = np.empty(6)
    for group in range(groups.max() + 1):
        members = groups == group
        squares = (in_camera[:, members] ** 2).sum(axis=1)
        std[members] = np.sqrt(spare * np.median(squares) / chi2.median(members.sum()))
    std = np.hypot(std, _EXACT)
    distance = ((in_camera / std) ** 2).sum(axis=1)
    weight = np.sqrt((_FREEDOM + 6) / (_FREEDOM + distance))
    return np.asarray(to_camera / std[:, None] * weight[:, None, None], float)


def _solve(
    start: Pair, stand_mount: FloatArray, camera_board: FloatArray, whiten: FloatArray, size: int
) -> tuple[FloatArray, FloatArray]:
    """The step `(12,)`, or `(13,)` with the board's scale, to the least squares of whitened errors; its covariance."""

    def at(step: FloatArray) -> tuple[Pair, FloatArray]:
        board = scaled(camera_board, 1 + step[12]) if size == 13 else camera_board
        return (moved(start[0], step[:6]), moved(start[1], step[6:12])), board

    def residuals(step: FloatArray) -> FloatArray:
        pair, board = at(step)
        return np.asarray(
            np.einsum("nij,nj->ni", whiten, view_errors(pair, stand_mount, board)).ravel(), float
        )

    def jacobian(step: FloatArray) -> FloatArray:
        pair, board = at(step)
        turns = stand_mount[:, :3, :3]
        reach = board[:, :3, 3] @ pair[0][:3, :3].T
        # The rotation error's own derivative, to first order in it (Solà et al., "A micro Lie theory", 2018, eq. 144).
        half = cross_matrices(view_errors(pair, stand_mount, board)[:, :3]) / 2
        full = np.zeros((len(turns), 6, size))
        full[:, :3, :3] = (np.eye(3) - half) @ turns
        full[:, :3, 6:9] = -(np.eye(3) + half)
        full[:, 3:, :3] = -turns @ cross_matrices(reach)
        full[:, 3:, 3:6] = turns
        full[:, 3:, 9:12] = -np.eye(3)
        if size == 13:
            full[:, 3:, 12] = np.einsum("nij,nj->ni", turns, reach) / (1 + step[12])
        return np.asarray((whiten @ full).reshape(-1, size), float)

    solution = least_squares(residuals, np.zeros(size), jac=jacobian, method="lm", x_scale="jac", ftol=1e-6)
    return solution.x, np.linalg.pinv(solution.jac.T @ solution.jac, hermitian=True)


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
    start: Pair, stand_mount: FloatArray, seen: Sequence[TargetDetection], intrinsics: Intrinsics
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
