"""A camera's matrix and lens distortion from pictures of a board.

Wrong corners and views are thrown out, no more distortion terms are taken than views the fit has not seen justify,
and the result says how sure it is and what doubt remains.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from baggie.calibration.files import CameraIdentity
from baggie.calibration.intrinsics.camera_calibration import CameraCalibration, ViewError
from baggie.calibration.intrinsics.lens import LensFit, LensGuess, board_pose, fit_lens, settle_lens, subset
from baggie.calibration.intrinsics.views import (
    ENOUGH_VIEWS,
    MIN_VIEWS,
    BoardView,
    agreeing_views,
    all_alike,
    clean,
    corner_noise_px,
    find_views,
    is_new,
    next_view,
    spread,
    warnings_about,
)
from baggie.calibration.pose import residuals_px
from baggie.errors import CalibrationError
from baggie.geometry import FloatArray
from baggie.pictures import read_pictures
from baggie.types import Intrinsics
from baggie.vision.corners import FLAT, Sag
from baggie.vision.targets import Target, TargetDetection, with_sag

CANDIDATES: tuple[tuple[str, ...], ...] = (
    (),
    ("k1",),
    ("k1", "k2"),
    ("k1", "k2", "p1", "p2"),
    ("k1", "k2", "p1", "p2", "k3"),
)
_FOLDS = 10
_TOLERANCE = 0.5
"""Standard errors. On simulated lenses a whole one left out tangential terms that were there."""
_MOST_TIMES = 9.0
"""The median view's square error: more says something of a view, and nothing of the lens."""
_ROUNDING = 1e-12
"""Square pixels: corners without noise still differ by this."""


@dataclass(frozen=True)
class ChosenLens:
    """The lens with the terms that are justified."""

    terms: tuple[str, ...]
    fit: LensFit
    covariance: FloatArray
    """`(11, 11)`: that of the fit and the doubt about the terms; zero where a term is held."""
    held_out_rms_px: float
    """Of corners in views the lens was not fitted to."""


def choose_lens(
    seen: Sequence[TargetDetection], size: tuple[int, int], start: Intrinsics, board: FloatArray
) -> ChosenLens:
    """The lens with the fewest terms whose error on held-out views is not significantly above that of the best.

    Cross-validation in ten folds over views. Candidates are compared view by view: worse is one whose mean difference
    is above half of its standard error (after the one-standard-error rule of Hastie et al., "The Elements of
    Statistical Learning", section 7.10). Raises `CalibrationError` where the views do not determine a lens.
    """
    fits = [fit_lens(seen, size, terms, start, board) for terms in CANDIDATES]
    errors = [_held_out(seen, fit, terms, board) for fit, terms in zip(fits, CANDIDATES, strict=True)]
    best = errors[int(np.argmin([error.mean() for error in errors]))]
    worse = [error - best for error in errors]
    limits = [_TOLERANCE * difference.std(ddof=1) / np.sqrt(len(seen)) for difference in worse]
    chosen = next(i for i, (d, limit) in enumerate(zip(worse, limits, strict=True)) if d.mean() <= limit)
    rms = float(np.sqrt(errors[chosen].mean()))
    return ChosenLens(CANDIDATES[chosen], fits[chosen], _with_doubt(fits, chosen), rms)


def held_out_error(seen: TargetDetection, lens: Intrinsics) -> float:
    """Mean squared error, square pixels, of either half of the corners, where the other half says where the board is.

    A view's own pose would absorb much of a lens's error if it were fitted to the same corners.
    """
    first = _every_other(seen)
    halves = subset(seen, first), subset(seen, ~first)
    squares = [
        (residuals_px(board_pose(placed, lens), judged.points, judged.pixels, lens) ** 2).sum(axis=1)
        for placed, judged in (halves, halves[::-1])
    ]
    return float(np.concatenate(squares).mean())


def _every_other(seen: TargetDetection) -> NDArray[np.bool_]:
    """`(N,)`: about half of the corners, as the white squares of a chessboard lie, so that no half is on one line."""
    columns, rows = (np.unique(seen.points[:, axis].round(6), return_inverse=True)[1] for axis in (0, 1))
    white = np.asarray((columns + rows) % 2 == 0, np.bool_)
    even = 4 <= white.sum() <= len(white) - 4
    return white if even else np.arange(len(white)) % 2 == 0


def _held_out(
    seen: Sequence[TargetDetection], fit: LensFit, terms: Sequence[str], board: FloatArray
) -> FloatArray:
    """`(V,)` square pixels: the error of each view by a lens fitted to the others, a few views' far too great ones cut.

    `fit` is that to all of them, from which the others' is not far. Of a board that is hardly in the picture, half of
    the corners may lie in one line and place it anywhere, or nowhere: such a view takes no part.
    """
    folds = min(_FOLDS, len(seen))
    errors = np.full(len(seen), np.nan)
    for fold in range(folds):
        others = [i for i in range(len(seen)) if i % folds != fold]
        kept, poses = [seen[i] for i in others], [fit.poses[i] for i in others]
        without = settle_lens(kept, terms, LensGuess(fit.intrinsics, poses, fit.sag), board)
        for i in range(fold, len(seen), folds):
            bent = replace(seen[i], points=without.sag.bend(seen[i].points, board))
            with suppress(CalibrationError):
                errors[i] = held_out_error(bent, without.intrinsics)
    usual = float(np.nanmedian(errors))
    return np.asarray(np.minimum(np.nan_to_num(errors, nan=usual), _MOST_TIMES * usual))


def _with_doubt(fits: Sequence[LensFit], chosen: int) -> FloatArray:
    """The chosen lens's covariance if any candidate may be the true one: the mean of each one's own and of its
    distance squared (Buckland, Burnham & Augustin, "Model Selection: An Integral Part of Inference", 1997). Without it
    a term held at zero makes the others look surer than they are.

    The weights are likelihoods, less what a term that is not there gains on average: Akaike's criterion with a penalty
    of 1 for each term, for doubt is not to be dismissed as readily as a term.
    """
    variance = max(fits[-1].variance, _ROUNDING)
    criterion = np.array(
        [fit.squares / variance + len(terms) for fit, terms in zip(fits, CANDIDATES, strict=True)]
    )
    weights = np.exp((criterion.min() - criterion) / 2)
    free = np.diag(fits[chosen].covariance) > 0
    total = np.zeros((11, 11))
    for weight, fit in zip(weights / weights.sum(), fits, strict=True):
        away = fit.values - fits[chosen].values
        total += weight * (fit.covariance + np.outer(away, away))
    return total * np.outer(free, free)


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
    kept, dropped, rough = agreeing_views(cleaned, camera.size, board)
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


def _check_trust(
    lens: ChosenLens, rms: float, seen: Sequence[TargetDetection], camera: CameraIdentity
) -> None:
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
    lens: ChosenLens, rms: float, noise: float | None, seen: Sequence[TargetDetection], camera: CameraIdentity
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
