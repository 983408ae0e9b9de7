"""One lens, how the board sags, and its poses in many pictures, fitted together: least squares on reprojection.

A board bent by a millimetre, taken for flat, makes the focal length wrong by a hundredth, and the corners by so little
that nobody notices. So its sag is fitted along, as mrcal does (`cv2.calibrateCameraRO` frees every point: Strobl &
Hirzinger, "More accurate pinhole camera calibration with imperfect planar target", 2011, and wants all in every view).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from baggie.calibration.intrinsics.opencv_lens import DISTORTION, search_lens
from baggie.geometry import FloatArray, rigid
from baggie.types import Intrinsics
from baggie.vision.sag import FLAT, Sag, bows
from baggie.vision.targets import Seen

USUAL_SAG = 1 / 500
"""Of a board's length: the prior's standard deviation of its sag that way, 0.45 mm on 225 mm.

A board in use, taken for flat, was found to sag by half of that, and one that sags by twice as much looks bent. Twenty
pictures tell the sag to a hundredth of it, so it counts only where they do not: from the front and afar a sag shows in
nothing, and the board is then taken for flat, give or take the usual."""
_ROUNDS = 20
_POINT_M = 1e-9
"""A board with one row of corners is no longer across than this."""
_DAMPING = 1e-4
_SETTLED = 1e-10
"""Of the sum of squares: a step that saves less ends the fit."""


@dataclass(frozen=True)
class LensFit:
    """A lens, the board's sag, and where the board was in each picture."""

    intrinsics: Intrinsics
    sag: Sag
    poses: tuple[FloatArray, ...]
    """`T_camera_target` of each picture."""
    covariance: FloatArray
    """`(11, 11)` in the order of `PARAMETERS`, then the sag along and across, metres; zero where a term was held."""
    squares: float
    """Sum of squared residuals, square pixels."""
    variance: float
    """The same for each degree of freedom that is left."""

    @property
    def values(self) -> FloatArray:
        """`(11,)`, in the order of the covariance."""
        lens = self.intrinsics.matrix[[0, 1, 0, 1], [0, 1, 2, 2]], self.intrinsics.distortion
        return np.concatenate([*lens, [self.sag.along_m, self.sag.across_m]])


@dataclass(frozen=True)
class LensGuess:
    """A lens, poses `T_camera_target` and a sag that are nearly right."""

    intrinsics: Intrinsics
    poses: Sequence[FloatArray]
    sag: Sag = FLAT

    @property
    def sag_m(self) -> FloatArray:
        """`(2,)`."""
        return np.array([self.sag.along_m, self.sag.across_m])


def fit_lens(
    seen: Sequence[Seen], size: tuple[int, int], terms: Sequence[str], start: Intrinsics, board: FloatArray
) -> LensFit:
    """Focal lengths, principal point, the named distortion `terms`, all others at zero, and the sag of a `board`.

    `board` `(M, 3)` are all its corners, flat, of which `seen` are some. `search_lens` takes it for flat, `settle_lens`
    does the rest. Raises `CalibrationError` where these pictures do not determine the lens.
    """
    return settle_lens(seen, terms, LensGuess(*search_lens(seen, size, terms, start)), board)


def settle_lens(seen: Sequence[Seen], terms: Sequence[str], state: LensGuess, board: FloatArray) -> LensFit:
    """The same from where it is nearly right, by Levenberg and Marquardt's steps."""
    columns = np.array([True] * 4 + [term in terms for term in DISTORTION] + [True] * 2)
    spare = max(sum(2 * len(view.ids) - 6 for view in seen) - int(columns.sum()), 1)
    blocks = _eliminated(seen, state, board, columns)
    damping = 0.0
    for _ in range(_ROUNDS):
        stiffness = _stiffness(board, _squares(blocks) / spare)
        closer = _step(blocks, state, columns, stiffness, damping)
        after = _eliminated(seen, closer, board, columns)
        before, now = (
            _squares(b) + float(((stiffness * s.sag_m) ** 2).sum())
            for b, s in ((blocks, state), (after, closer))
        )
        if now < before:
            state, blocks, damping = closer, after, damping / 10
        elif damping > 1:  # nothing left to settle, or nearly singular
            break
        else:
            damping = max(10 * damping, _DAMPING)
        if abs(before - now) < _SETTLED * before:
            break
    variance = _squares(blocks) / spare
    inverse = _inverse_normal(blocks, columns, _stiffness(board, variance))
    return LensFit(
        state.intrinsics, state.sag, tuple(state.poses), variance * inverse, _squares(blocks), variance
    )


@dataclass(frozen=True)
class _Eliminated:
    """One picture's corners, linearized, with the board's pose taken out by QR: `by_pose = q @ upper`."""

    residuals: FloatArray
    """`(2N,)`."""
    q: FloatArray
    """`(2N, 6)`."""
    upper: FloatArray
    """`(6, 6)`."""
    by_shared: FloatArray
    """`(2N, L)`: by what all pictures share, the lens and the sag."""

    def without_pose(self, values: FloatArray) -> FloatArray:
        """The part of `values` `(2N, ...)` that no motion of the board explains."""
        return np.asarray(values - self.q @ (self.q.T @ values), float)


def _eliminated(
    seen: Sequence[Seen], state: LensGuess, board: FloatArray, columns: NDArray[np.bool_]
) -> list[_Eliminated]:
    lens = state.intrinsics.matrix, state.intrinsics.distortion
    blocks = []
    for view, pose in zip(seen, state.poses, strict=True):
        turn, _ = cv2.Rodrigues(pose[:3, :3])
        shown, jacobian = cv2.projectPoints(state.sag.bend(view.points, board), turn, pose[:3, 3], *lens)
        residuals = (view.pixels - shown.reshape(-1, 2)).ravel()
        # A point that moves along the board's z moves as the whole board would.
        by_depth = jacobian[:, 3:6] @ pose[:3, 2]
        by_sag = by_depth[:, None] * np.repeat(bows(view.points, board), 2, axis=0)
        by_shared = np.hstack([jacobian[:, 6:15], by_sag])[:, columns]
        blocks.append(_Eliminated(residuals, *np.linalg.qr(jacobian[:, :6]), by_shared))
    return blocks


def _squares(blocks: Sequence[_Eliminated]) -> float:
    return sum(float(block.residuals @ block.residuals) for block in blocks)


def _stiffness(board: FloatArray, variance: float) -> FloatArray:
    """`(2,)` pixels a metre: the prior on the sag, as two more residuals beside the corners' of this `variance`."""
    length = np.maximum(np.ptp(board[:, :2], axis=0), _POINT_M)
    return np.asarray(np.sqrt(variance) / (USUAL_SAG * length), float)


def _design(
    blocks: Sequence[_Eliminated], columns: NDArray[np.bool_], stiffness: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """`(R, L)`: all corners by what is shared, less what poses explain, and the prior; and each column's length."""
    prior = np.hstack([np.zeros((2, int(columns.sum()) - 2)), np.diag(stiffness)])
    design = np.concatenate([*(block.without_pose(block.by_shared) for block in blocks), prior])
    # k3 and fx differ by orders of magnitude; of a board with two rows nothing shows the sag across.
    return design, np.maximum(np.linalg.norm(design, axis=0), np.finfo(float).tiny)


def _step(
    blocks: Sequence[_Eliminated],
    state: LensGuess,
    columns: NDArray[np.bool_],
    stiffness: FloatArray,
    damping: float,
) -> LensGuess:
    """One step of Levenberg and Marquardt's; of Gauss and Newton's without damping."""
    design, scale = _design(blocks, columns, stiffness)
    target = np.concatenate(
        [*(block.without_pose(block.residuals) for block in blocks), -stiffness * state.sag_m]
    )
    held = np.concatenate([design / scale, np.sqrt(damping) * np.eye(len(scale))])
    change = np.zeros(11)
    change[columns] = np.linalg.lstsq(held, np.concatenate([target, np.zeros(len(scale))]))[0] / scale
    matrix = state.intrinsics.matrix.copy()
    matrix[[0, 1, 0, 1], [0, 1, 2, 2]] += change[:4]
    moved = []
    for pose, block in zip(state.poses, blocks, strict=True):
        left = block.residuals - block.by_shared @ change[columns]
        motion = np.linalg.solve(block.upper, block.q.T @ left)
        turn = cv2.Rodrigues(pose[:3, :3])[0].ravel() + motion[:3]
        moved.append(rigid(cv2.Rodrigues(turn)[0], pose[:3, 3] + motion[3:]))
    size = state.intrinsics.width, state.intrinsics.height
    lens = Intrinsics(*size, matrix, state.intrinsics.distortion + change[4:9])
    along, across = (state.sag_m + change[9:]).tolist()
    return LensGuess(lens, moved, Sag(along, across))


def _inverse_normal(
    blocks: Sequence[_Eliminated], columns: NDArray[np.bool_], stiffness: FloatArray
) -> FloatArray:
    """`(11, 11)`: the inverse of the normal matrix's Schur complement (Triggs et al., "Bundle Adjustment -- A Modern
    Synthesis", 2000, section 6.1), which is the normal matrix of the shared columns less the poses' part.
    """
    design, scale = _design(blocks, columns, stiffness)
    inverse = np.zeros((11, 11))
    scaled = np.linalg.pinv((design / scale).T @ (design / scale), hermitian=True)
    inverse[np.ix_(columns, columns)] = scaled / np.outer(scale, scale)
    return inverse
