"""A lens and the poses of a flat board, by OpenCV: where the bundle starts."""

from __future__ import annotations

from collections.abc import Sequence

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


def search_lens(
    seen: Sequence[Seen], size: tuple[int, int], terms: Sequence[str], start: Intrinsics
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


def subset(seen: Seen, which: NDArray[np.bool_] | slice) -> Seen:
    """Some of the corners."""
    index = np.arange(len(seen.ids))[which]  # OpenCV takes no arrays with strides
    return Seen(seen.ids[index], seen.pixels[index], seen.points[index])


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
