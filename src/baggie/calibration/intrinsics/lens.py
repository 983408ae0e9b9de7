"""One lens, how the board sags, and its poses in many pictures, fitted together: least squares on reprojection.

A board bent by a millimetre, taken for flat, makes the focal length wrong by a hundredth, and the corners by so little
that nobody notices. So its sag is fitted along, as mrcal does (`cv2.calibrateCameraRO` frees every point: Strobl &
Hirzinger, "More accurate pinhole camera calibration with imperfect planar target", 2011, and wants all in every view).
It starts from OpenCV's lens and poses of a flat board.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from baggie.errors import CalibrationError
from baggie.geometry import FloatArray, rigid
from baggie.types import Intrinsics
from baggie.vision.corners import FLAT, Sag, bows
from baggie.vision.targets import TargetDetection

DISTORTION = ("k1", "k2", "p1", "p2", "k3")
"""Brown's terms in OpenCV's order: radial k, tangential p."""
PARAMETERS = ("fx", "fy", "cx", "cy", *DISTORTION)
"""The order of a lens's covariance, which is that of the columns of `cv2.projectPoints`' Jacobian."""

_STOP = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-12)


def search_lens(
    seen: Sequence[TargetDetection], size: tuple[int, int], terms: Sequence[str], start: Intrinsics
) -> tuple[Intrinsics, list[FloatArray]]:
    """The lens with these distortion terms, all others zero, and each `T_camera_target`, the board taken as flat.

    By `cv2.calibrateCamera` (Zhang, "A Flexible New Technique for Camera Calibration", 2000), whose corners are in
    single precision: to a ten thousandth of a pixel. Raises `CalibrationError` where these pictures do not determine
    the lens.
    """
    flags = cv2.CALIB_USE_INTRINSIC_GUESS | (0 if "p1" in terms else cv2.CALIB_ZERO_TANGENT_DIST)
    flags |= sum(getattr(cv2, f"CALIB_FIX_{k.upper()}") for k in ("k1", "k2", "k3") if k not in terms)
    free = np.array([term in terms for term in DISTORTION])
    return _search(seen, size, flags, start.matrix, start.distortion * free)


def rough_lens(seen: Sequence[TargetDetection], size: tuple[int, int]) -> Intrinsics:
    """One focal length and k1, the principal point in the middle: what a few pictures determine.

    Raises `CalibrationError` where the pictures do not even determine that.
    """
    flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_ASPECT_RATIO | cv2.CALIB_FIX_PRINCIPAL_POINT
    flags |= cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3
    guess = guessed_lens(size)
    return _search(seen, size, flags, guess.matrix, guess.distortion)[0]


def guessed_lens(size: tuple[int, int]) -> Intrinsics:
    """A lens as most cameras have it: 57 degrees across the longer side, no distortion."""
    width, height = size
    focal = 0.92 * max(size)
    matrix = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]])
    return Intrinsics(width, height, matrix, np.zeros(5))


def board_pose(seen: TargetDetection, intrinsics: Intrinsics) -> FloatArray:
    """`T_camera_target` of a board, flat or nearly so, least squares over all corners, four or more.

    IPPE (Collins & Bartoli, 2014) as if it were flat, then Levenberg-Marquardt as it is. Raises `CalibrationError`
    where that fails.
    """
    lens = intrinsics.matrix, intrinsics.distortion
    flat = seen.points * [1.0, 1.0, 0.0]
    try:
        _, turns, shifts, _ = cv2.solvePnPGeneric(flat, seen.pixels, *lens, flags=cv2.SOLVEPNP_IPPE)
        turn, shift = cv2.solvePnPRefineLM(seen.points, seen.pixels, *lens, turns[0], shifts[0])
    except (cv2.error, IndexError):
        raise CalibrationError(f"no position of the board explains its {len(seen.ids)} corners") from None
    return rigid(cv2.Rodrigues(turn)[0], shift)


def subset(seen: TargetDetection, which: NDArray[np.bool_] | slice) -> TargetDetection:
    """Some of the corners."""
    index = np.arange(len(seen.ids))[which]  # OpenCV takes no arrays with strides
    return TargetDetection(seen.ids[index], seen.pixels[index], seen.points[index])


def _search(
    seen: Sequence[TargetDetection],
    size: tuple[int, int],
    flags: int,
    matrix: FloatArray,
    distortion: FloatArray,
) -> tuple[Intrinsics, list[FloatArray]]:
    points = [view.points.astype(np.float32) for view in seen]
    pixels = [view.pixels.astype(np.float32) for view in seen]
    try:
        _, found, bent, turns, shifts = cv2.calibrateCamera(
            points, pixels, size, matrix.copy(), distortion.copy(), flags=flags, criteria=_STOP
        )
    except cv2.error:
        found = bent = np.full(0, np.nan)
    intrinsics = Intrinsics(*size, np.asarray(found, float), np.asarray(bent, float).ravel()[:5])
    if not (found.size and np.isfinite(intrinsics.matrix).all() and np.isfinite(intrinsics.distortion).all()):
        raise CalibrationError(
            f"these {len(seen)} pictures of the board do not determine the lens; tilt the board by 30 to 45 degrees in "
            "both directions and show it all over the picture"
        )
    return intrinsics, [
        rigid(cv2.Rodrigues(turn)[0], shift) for turn, shift in zip(turns, shifts, strict=True)
    ]


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
    seen: Sequence[TargetDetection],
    size: tuple[int, int],
    terms: Sequence[str],
    start: Intrinsics,
    board: FloatArray,
) -> LensFit:
    """Focal lengths, principal point, the named distortion `terms`, all others at zero, and the sag of a `board`.

    `board` `(M, 3)` are all its corners, flat, of which `seen` are some. `search_lens` takes it for flat, `settle_lens`
    does the rest. Raises `CalibrationError` where these pictures do not determine the lens.
    """
    return settle_lens(seen, terms, LensGuess(*search_lens(seen, size, terms, start)), board)


def settle_lens(
    seen: Sequence[TargetDetection], terms: Sequence[str], state: LensGuess, board: FloatArray
) -> LensFit:
    """Fit a lens from where it is nearly right, by Levenberg and Marquardt's steps."""
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
    seen: Sequence[TargetDetection], state: LensGuess, board: FloatArray, columns: NDArray[np.bool_]
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
