"""Hand-eye calibration from poses by robust least squares, with the noise of rotation and translation estimated.

Unknown are `T_mount_camera` and `T_stand_board` together (Dornaika & Horaud, "Simultaneous robot-world and hand-eye
calibration", 1998). A view's error is how far its own `T_stand_board` is from the common one: a rotation and a
translation of the board's origin. Their scales are not known beforehand and decide how they weigh against each other;
both come from the errors themselves (median), in turns with the fit. Views far off get the weight a Student t
distribution gives them (Lange, Little & Taylor, "Robust statistical modeling using the t distribution", 1989).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from baggie.geometry import FloatArray, rigid

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
