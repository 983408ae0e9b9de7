"""One lens and the poses of the board in many pictures, fitted together: least squares on reprojection."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from baggie.errors import CalibrationError
from baggie.geometry import FloatArray, rigid
from baggie.types import Intrinsics
from baggie.vision.targets import Seen

DISTORTION = ("k1", "k2", "p1", "p2", "k3")
"""Brown's terms in OpenCV's order: radial k, tangential p."""
PARAMETERS = ("fx", "fy", "cx", "cy", *DISTORTION)
"""The order of a lens's covariance, which is that of the columns of `cv2.projectPoints`' Jacobian."""

_STOP = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-12)


@dataclass(frozen=True)
class LensFit:
    """A lens, and where the board was in each picture."""

    intrinsics: Intrinsics
    poses: tuple[FloatArray, ...]
    """`T_camera_target` of each picture."""
    covariance: FloatArray
    """`(9, 9)` in the order of `PARAMETERS`; zero where a term was held."""
    squares: float
    """Sum of squared residuals, square pixels."""
    variance: float
    """The same for each degree of freedom that is left."""


def fit_lens(seen: Sequence[Seen], size: tuple[int, int], terms: Sequence[str], start: Intrinsics) -> LensFit:
    """Focal lengths, principal point and the named distortion `terms`, all others held at zero.

    `search_lens`, whose corners are in single precision, and two Gauss-Newton steps that settle the last digits.
    Raises `CalibrationError` where these pictures do not determine the lens.
    """
    intrinsics, poses = search_lens(seen, size, terms, start)
    columns = np.array([True] * 4 + [term in terms for term in DISTORTION])
    blocks = _eliminated(seen, intrinsics, poses, columns)
    squares = _squares(blocks)
    for _ in range(2):
        closer = _step(blocks, intrinsics, poses, columns)
        after = _eliminated(seen, *closer, columns)
        if _squares(after) >= squares:  # nothing left to settle, or nearly singular
            break
        (intrinsics, poses), blocks, squares = closer, after, _squares(after)
    count = sum(len(block.residuals) for block in blocks)
    variance = squares / max(count - 6 * len(seen) - int(columns.sum()), 1)
    return LensFit(intrinsics, tuple(poses), variance * _inverse_normal(blocks, columns), squares, variance)


def search_lens(
    seen: Sequence[Seen], size: tuple[int, int], terms: Sequence[str], start: Intrinsics
) -> tuple[Intrinsics, list[FloatArray]]:
    """The lens and each `T_camera_target` by `cv2.calibrateCamera` (Zhang, "A Flexible New Technique for Camera
    Calibration", 2000), to a ten thousandth of a pixel. Raises `CalibrationError` as `fit_lens` does.
    """
    flags = cv2.CALIB_USE_INTRINSIC_GUESS | (0 if "p1" in terms else cv2.CALIB_ZERO_TANGENT_DIST)
    flags |= sum(getattr(cv2, f"CALIB_FIX_{k.upper()}") for k in ("k1", "k2", "k3") if k not in terms)
    free = np.array([term in terms for term in DISTORTION])
    return _search(seen, size, flags, start.matrix, start.distortion * free)


def rough_lens(seen: Sequence[Seen], size: tuple[int, int]) -> Intrinsics:
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


def board_pose(seen: Seen, intrinsics: Intrinsics) -> FloatArray:
    """`T_camera_target` of a flat board, least squares over all corners, four or more.

    IPPE (Collins & Bartoli, 2014), then Levenberg-Marquardt. Raises `CalibrationError` where that fails.
    """
    lens = intrinsics.matrix, intrinsics.distortion
    try:
        _, turns, shifts, _ = cv2.solvePnPGeneric(seen.points, seen.pixels, *lens, flags=cv2.SOLVEPNP_IPPE)
        turn, shift = cv2.solvePnPRefineLM(seen.points, seen.pixels, *lens, turns[0], shifts[0])
    except (cv2.error, IndexError):
        raise CalibrationError(f"no position of the board explains its {len(seen.ids)} corners") from None
    return rigid(cv2.Rodrigues(turn)[0], shift)


def subset(seen: Seen, which: NDArray[np.bool_] | slice) -> Seen:
    """Some of the corners."""
    index = np.arange(len(seen.ids))[which]  # OpenCV takes no arrays with strides
    return Seen(seen.ids[index], seen.pixels[index], seen.points[index])


@dataclass(frozen=True)
class _Eliminated:
    """One picture's corners, linearized, with the board's pose taken out by QR: `by_pose = q @ upper`."""

    residuals: FloatArray
    """`(2N,)`."""
    q: FloatArray
    """`(2N, 6)`."""
    upper: FloatArray
    """`(6, 6)`."""
    by_lens: FloatArray
    """`(2N, L)`."""

    def without_pose(self, values: FloatArray) -> FloatArray:
        """The part of `values` `(2N, ...)` that no motion of the board explains."""
        return np.asarray(values - self.q @ (self.q.T @ values), float)


def _search(
    seen: Sequence[Seen], size: tuple[int, int], flags: int, matrix: FloatArray, distortion: FloatArray
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


def _eliminated(
    seen: Sequence[Seen], intrinsics: Intrinsics, poses: Sequence[FloatArray], columns: NDArray[np.bool_]
) -> list[_Eliminated]:
    lens = intrinsics.matrix, intrinsics.distortion
    blocks = []
    for view, pose in zip(seen, poses, strict=True):
        turn, _ = cv2.Rodrigues(pose[:3, :3])
        shown, jacobian = cv2.projectPoints(view.points, turn, pose[:3, 3], *lens)
        residuals = (view.pixels - shown.reshape(-1, 2)).ravel()
        by_lens = np.asarray(jacobian[:, 6:15][:, columns], float)
        blocks.append(_Eliminated(residuals, *np.linalg.qr(jacobian[:, :6]), by_lens))
    return blocks


def _squares(blocks: Sequence[_Eliminated]) -> float:
    return sum(float(block.residuals @ block.residuals) for block in blocks)


def _step(
    blocks: Sequence[_Eliminated],
    intrinsics: Intrinsics,
    poses: Sequence[FloatArray],
    columns: NDArray[np.bool_],
) -> tuple[Intrinsics, list[FloatArray]]:
    """One Gauss-Newton step."""
    design = np.concatenate([block.without_pose(block.by_lens) for block in blocks])
    target = np.concatenate([block.without_pose(block.residuals) for block in blocks])
    scale = np.linalg.norm(design, axis=0)  # k3 and fx differ by orders of magnitude
    change = np.zeros(9)
    change[columns] = np.linalg.lstsq(design / scale, target)[0] / scale
    matrix = intrinsics.matrix.copy()
    matrix[[0, 1, 0, 1], [0, 1, 2, 2]] += change[:4]
    moved = []
    for pose, block in zip(poses, blocks, strict=True):
        motion = np.linalg.solve(block.upper, block.q.T @ (block.residuals - block.by_lens @ change[columns]))
        turn = cv2.Rodrigues(pose[:3, :3])[0].ravel() + motion[:3]
        moved.append(rigid(cv2.Rodrigues(turn)[0], pose[:3, 3] + motion[3:]))
    size = intrinsics.width, intrinsics.height
    return Intrinsics(*size, matrix, intrinsics.distortion + change[4:]), moved


def _inverse_normal(blocks: Sequence[_Eliminated], columns: NDArray[np.bool_]) -> FloatArray:
    """`(9, 9)`: the inverse of the normal matrix's Schur complement (Triggs et al., "Bundle Adjustment -- A Modern
    Synthesis", 2000, section 6.1), which is the normal matrix of the lens's columns less the poses' part.
    """
    design = np.concatenate([block.without_pose(block.by_lens) for block in blocks])
    scale = np.linalg.norm(design, axis=0)
    inverse = np.zeros((9, 9))
    scaled = np.linalg.pinv((design / scale).T @ (design / scale), hermitian=True)
    inverse[np.ix_(columns, columns)] = scaled / np.outer(scale, scale)
    return inverse
