"""A camera's matrix and lens distortion from pictures of a board.

Wrong corners and views are thrown out, no more distortion terms are taken than views the fit has not seen justify,
and the result says how sure it is.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path

import numpy as np

from baggie.calibration.files import CameraIdentity
from baggie.calibration.intrinsics.agreement import MIN_VIEWS, agreeing, clean
from baggie.calibration.intrinsics.board_views import (
    ENOUGH_VIEWS,
    BoardView,
    all_alike,
    find_views,
    is_new,
    next_view,
    spread,
    warnings_about,
)
from baggie.calibration.intrinsics.camera_calibration import CameraCalibration, ViewError
from baggie.calibration.intrinsics.corner_noise import corner_noise_px
from baggie.calibration.intrinsics.lens_bundle import LensFit
from baggie.calibration.intrinsics.lens_terms import ChosenLens, choose_lens
from baggie.calibration.pose import residuals_px
from baggie.errors import CalibrationError
from baggie.vision.picture_files import read_pictures
from baggie.vision.sag import FLAT, Sag
from baggie.vision.targets import Seen, Target, with_sag

__all__ = [
    "BoardView",
    "calibrate_intrinsics_from",
    "find_views",
    "fit_intrinsics",
    "is_new",
    "next_view",
]

_WORST_RMS = 0.003
"""Of the picture's longer side: worse, and it is no pinhole camera, no flat board, or another board."""
_USUAL_RMS_PX = 1.0
_SMOOTH, _LEAST_NOISE_PX = 10.0, 0.01
"""Further off than so many times the corners' noise, a fit explains not what was seen. Sharp corners in pictures with
two grey levels of noise are found to a hundredth of a pixel (docs/results/bowed-boards.md)."""
_UNSURE, _USELESS = 0.01, 0.05
"""Standard deviation of the focal length, relative."""
_SQUARE, _FAR_FROM_SQUARE = 0.03, 0.1
"""Difference of the focal lengths, relative: sensors have square pixels."""
_FOCAL = (0.2, 20.0)
"""In picture sides: a view across of 136 and of 3 degrees."""


def calibrate_intrinsics_from(source: Path, target: Target, camera_name: str) -> CameraCalibration:
    """Calibrate from a folder of pictures of `target`, one file, or a video.

    Raises `DataError` where pictures cannot be read, `CalibrationError` where too few show the board or the result
    could not be trusted.
    """
    pictures = read_pictures(source)
    name, first = next(pictures)
    height, width = first.shape[:2]
    views, skipped = find_views(chain([(name, first)], pictures), target)
    if len(views) < MIN_VIEWS:
        reasons = Counter(why for _, why in skipped).most_common()
        quoted = "; ".join(f"{why} ({times} pictures)" if times > 1 else why for why, times in reasons[:3])
        raise CalibrationError(
            f"expected {target.spec} in at least {MIN_VIEWS} pictures, {ENOUGH_VIEWS} are good; found it in "
            f"{len(views)} of {len(views) + len(skipped)} in {source}{': ' if quoted else ''}{quoted}"
        )
    calibration = fit_intrinsics(views, CameraIdentity(camera_name, width, height), target)
    return replace(calibration, dropped=(*skipped, *calibration.dropped))


def fit_intrinsics(views: Sequence[BoardView], camera: CameraIdentity, target: Target) -> CameraCalibration:
    """The lens that explains the views that agree, with its covariance and its error on views it has not seen.

    Distortion is OpenCV's five terms, those that are not needed at zero. The board need not be flat: its sag is found
    along. The covariance has the corners' scatter in it, taken as independent from corner to corner, the doubt about
    the sag, and that about the choice of terms.

    Raises `CalibrationError` where fewer than four views agree, all are alike, or the lens is not determined.
    """
    board = with_sag(target, FLAT).points
    cleaned, lost = clean(views)
    _check_enough(cleaned, lost, len(views))
    kept, dropped, rough = agreeing(cleaned, camera.size, board)
    lost += dropped
    _check_enough(kept, lost, len(views))
    seen = [view.seen for view in kept]
    chosen = choose_lens(seen, camera.size, rough, board)
    fit = chosen.fit
    errors = tuple(_view_error(view, pose, fit, board) for view, pose in zip(kept, fit.poses, strict=True))
    rms = _rms(np.concatenate([error.residuals_px for error in errors]))
    noise = corner_noise_px(seen, [error.residuals_px for error in errors])
    _check_trust(chosen, rms, seen, camera)
    return CameraCalibration(
        camera=camera,
        intrinsics=fit.intrinsics,
        covariance=chosen.covariance[:9, :9],
        terms=chosen.terms,
        rms_px=rms,
        held_out_rms_px=chosen.held_out_rms_px,
        views=errors,
        dropped=tuple(lost),
        warnings=tuple(_warnings(chosen, rms, noise, seen, camera)),
        target=target.spec,
        source=f"{len(views)} pictures",
        corner_noise_px=noise,
        sag=fit.sag,
        sag_std=Sag(*np.sqrt(np.diag(chosen.covariance)[9:]).tolist()),
    )


def _check_enough(views: Sequence[BoardView], lost: Sequence[tuple[str, str]], given: int) -> None:
    if len(views) < MIN_VIEWS:
        why = f" ({lost[0][0]}: {lost[0][1]})" if lost else ""
        raise CalibrationError(
            f"expected at least {MIN_VIEWS} views that agree on one lens, got {len(views)} of {given}{why}; check the "
            "board's stated rows and columns, keep it flat, take more pictures"
        )
    if all_alike([view.seen for view in views]):
        raise CalibrationError(
            f"all {len(views)} views show the board in the same place; move it about the picture and tilt it by 30 to "
            "45 degrees in both directions"
        )


def _view_error(view: BoardView, pose: np.ndarray, fit: LensFit, board: np.ndarray) -> ViewError:
    points = fit.sag.bend(view.seen.points, board)
    residuals = residuals_px(pose, points, view.seen.pixels, fit.intrinsics)
    return ViewError(view.name, _rms(residuals), len(residuals), view.seen.pixels, residuals)


def _rms(residuals: np.ndarray) -> float:
    return float(np.sqrt((residuals**2).sum(axis=1).mean()))


def _focal_uncertainty(lens: ChosenLens) -> float:
    """The larger relative standard deviation of fx and fy."""
    return float((np.sqrt(np.diag(lens.covariance)[:2]) / np.diag(lens.fit.intrinsics.matrix)[:2]).max())


def _check_trust(lens: ChosenLens, rms: float, seen: Sequence[Seen], camera: CameraIdentity) -> None:
    side = max(camera.size)
    fx, fy, cx, cy = lens.fit.intrinsics.matrix[[0, 1, 0, 1], [0, 1, 2, 2]]
    sane = all(_FOCAL[0] * side < f < _FOCAL[1] * side for f in (fx, fy))
    sane = sane and 0 < cx < camera.width and 0 < cy < camera.height
    unsure = _focal_uncertainty(lens)
    if not sane or unsure > _USELESS:
        tilt = np.degrees(max(spread(seen, lens.fit.poses, camera.size).tilts.values()))
        raise CalibrationError(
            f"these {len(seen)} views do not determine the lens (focal length {fx:.0f} x {fy:.0f} px +- {unsure:.0%}, "
            f"principal point {cx:.0f}, {cy:.0f}; boards tilted by up to {tilt:.0f} degrees); tilt the board by 30 to "
            "45 degrees in both directions and show it all over the picture"
        )
    # A board of other proportions than stated is half explained by pixels that are not square.
    allowed = _USUAL_RMS_PX if abs(fx / fy - 1) > _FAR_FROM_SQUARE else _WORST_RMS * side
    if rms > allowed:
        raise CalibrationError(
            f"expected corners within {allowed:.1f} pixels of where one lens puts them, they are {rms:.1f} off (RMS) "
            f"with focal lengths {fx:.0f} x {fy:.0f} px; check the board's stated rows, columns and sizes, keep it "
            "flat; fisheye lenses are not supported"
        )


def _warnings(
    lens: ChosenLens, rms: float, noise: float | None, seen: Sequence[Seen], camera: CameraIdentity
) -> list[str]:
    found = warnings_about(seen, lens.fit.poses, camera.size)
    unsure = _focal_uncertainty(lens)
    if unsure > _UNSURE:
        found.append(f"the focal length is known to {unsure:.1%} only; add tilted views")
    across, along = np.diag(lens.fit.intrinsics.matrix)[:2]
    if abs(across / along - 1) > _SQUARE:
        found.append(
            f"the focal lengths differ by {abs(across / along - 1):.0%}, as if pixels were not square; is the board as "
            "stated, are the pictures stretched?"
        )
    if rms > _USUAL_RMS_PX:
        found.append(
            f"corners are {rms:.1f} pixels off (RMS), below {_USUAL_RMS_PX:.0f} is usual; is the board flat, are the "
            "pictures sharp?"
        )
    elif noise is not None and rms > _SMOOTH * max(noise, _LEAST_NOISE_PX):
        found.append(
            f"corners are {rms:.2f} pixels off (RMS), {rms / max(noise, _LEAST_NOISE_PX):.0f} times as far as they are "
            f"found ({noise:.3f}), so something moves them together; is the board twisted or loose, are its sizes as "
            "stated, did it or the camera move?"
        )
    return found
