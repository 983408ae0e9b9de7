"""Which corners and which views of a board agree on one lens."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from baggie.calibration.intrinsics.board_views import BoardView
from baggie.calibration.intrinsics.lens_bundle import fit_lens
from baggie.calibration.intrinsics.opencv_lens import DISTORTION, board_pose, rough_lens, search_lens, subset
from baggie.calibration.pose import residuals_px
from baggie.errors import CalibrationError
from baggie.geometry import FloatArray
from baggie.types import Intrinsics
from baggie.vision.targets import Seen

MIN_VIEWS = 4
"""Three determine a lens, a fourth can contradict."""
MIN_CORNERS = 8
"""So that half of a view's corners say where the board is, and the other half can be compared."""
_MISPLACED = 0.4
"""Of a square: further from the plane's homography than that, a corner was taken for another one."""
_STDS = 4.0
_FLOOR_PX = 0.1
"""Corners and views this good are never dropped, however good the others are."""
_WORSE = 3.0
"""A view so many times as far off as the median view does not agree with it."""
_DRAWS, _DRAWN, _MOST = 40, 4, 0.6
"""Lenses tried, views each is fitted to, and the fraction of all views it should be near to."""
_CONCENTRATIONS, _FEW_TERMS = 4, ("k1", "k2", "p1", "p2")
_ROUNDS = 20


def clean(views: Sequence[BoardView]) -> tuple[list[BoardView], list[tuple[str, str]]]:
    """Without corners grossly off the plane, and views with hardly any others: kept views, and dropped ones with why.

    No lens is needed: it bends a board by much less than a square.
    """
    kept, dropped = [], []
    for view in views:
        count = len(view.seen.ids)
        homography, near = _plane(view.seen) if count >= MIN_CORNERS else (None, np.zeros(count, np.bool_))
        if count < MIN_CORNERS:
            dropped.append((view.name, f"{count} corners, at least {MIN_CORNERS} are needed"))
        elif homography is None or near.sum() < max(MIN_CORNERS, 0.5 * count):
            dropped.append((view.name, f"only {near.sum()} of {count} corners lie as the board's do"))
        elif np.linalg.det(homography) < 0:
            dropped.append((view.name, "its corners run the wrong way round, as in a mirror"))
        else:
            kept.append(BoardView(view.name, subset(view.seen, near)))
    return kept, dropped


def agreeing(
    views: Sequence[BoardView], size: tuple[int, int], board: FloatArray
) -> tuple[list[BoardView], list[tuple[str, str]], Intrinsics]:
    """The views, without outlying corners, that agree on one lens; those that do not, with why; and that lens.

    `board` `(M, 3)` are all its corners, flat. From the lens that most views are near to, found by drawing a few at a
    time (Fischler & Bolles, "Random Sample Consensus", 1981), the lens with all terms and the board's sag are fitted
    again and again to what lies within four standard deviations of them. Raises `CalibrationError` where no lens is
    determined.
    """
    seen = [view.seen for view in views]
    lens, bent = _near_most(seen, size), list(seen)
    masks = [np.ones(len(view.ids), np.bool_) for view in seen]
    good = np.ones(len(seen), np.bool_)
    for number in range(_ROUNDS):
        distances = [_distances(view, mask, lens) for view, mask in zip(bent, masks, strict=True)]
        before = [*masks, good]
        masks = _inliers(distances)
        errors = np.array([_rms(d[mask]) for d, mask in zip(distances, masks, strict=True)])
        limit = max(_WORSE * float(np.median(errors)), _FLOOR_PX)
        enough = np.array([mask.sum() >= max(MIN_CORNERS, 0.5 * len(mask)) for mask in masks])
        good = enough & (errors <= limit)
        kept = [subset(view, mask) for view, mask, agrees in zip(seen, masks, good, strict=True) if agrees]
        # The first lens is rough and its board flat: beside that, nothing may stand out.
        if len(kept) < MIN_VIEWS or (number and all(map(np.array_equal, before, [*masks, good]))):
            break
        fit = fit_lens(kept, size, DISTORTION, lens, board)
        lens = fit.intrinsics
        bent = [replace(view, points=fit.sag.bend(view.points, board)) for view in seen]
    names = [view.name for view, agrees in zip(views, good, strict=True) if agrees]
    dropped = [
        (views[i].name, _why(masks[i], float(errors[i]), float(np.median(errors))))
        for i in np.flatnonzero(~good).tolist()
    ]
    return [BoardView(name, view) for name, view in zip(names, kept, strict=True)], dropped, lens


def _plane(seen: Seen) -> tuple[FloatArray | None, NDArray[np.bool_]]:
    """The homography `(3, 3)` from the board to the picture, pixels, and which corners `(N,)` it maps."""
    apart = np.linalg.norm(seen.pixels[:, None] - seen.pixels, axis=2)
    square = float(np.median(np.sort(apart, axis=1)[:, 1]))
    limit = max(_MISPLACED * square, 1.0)
    homography, near = cv2.findHomography(seen.points[:, :2], seen.pixels, cv2.RANSAC, limit)
    if homography is None:
        return None, np.zeros(len(seen.ids), np.bool_)
    return np.asarray(homography, float), near.ravel().astype(np.bool_)


def _near_most(seen: Sequence[Seen], size: tuple[int, int]) -> Intrinsics:
    """Of rough lenses, each fitted to a few views drawn at random, the one that most views are nearest to."""
    rng = np.random.default_rng(0)
    drawn = {tuple(sorted(rng.choice(len(seen), _DRAWN, replace=False).tolist())) for _ in range(_DRAWS)}
    most = max(MIN_VIEWS, int(np.ceil(_MOST * len(seen))))
    best, found = np.inf, None
    for draw in sorted(drawn):
        try:
            lens = rough_lens([seen[i] for i in draw], size)
            errors = [float(np.median(_distances(view, slice(None), lens))) for view in seen]
        except CalibrationError:
            continue
        error = float(np.sort(errors)[:most].mean())
        if error < best:
            best, found = error, lens
    if found is None:
        raise CalibrationError(
            f"no {_DRAWN} of these {len(seen)} views determine a lens; tilt the board by 30 to 45 degrees in both "
            "directions and show it all over the picture"
        )
    # Concentration (Rousseeuw & Van Driessen, "Computing LTS Regression for Large Data Sets", 2006): a lens with more
    # terms for the nearest views, and again, so that a view is not judged by a lens that is itself rough.
    for _ in range(_CONCENTRATIONS):
        errors = [float(np.median(_distances(view, slice(None), found))) for view in seen]
        nearest = np.argsort(errors)[:most].tolist()
        found, _ = search_lens([seen[i] for i in nearest], size, _FEW_TERMS, found)
    return found


def _distances(seen: Seen, placed_by: NDArray[np.bool_] | slice, lens: Intrinsics) -> FloatArray:
    """`(N,)` pixels: how far all corners are off, the board's pose fitted to some."""
    pose = board_pose(subset(seen, placed_by), lens)
    return np.asarray(np.linalg.norm(residuals_px(pose, seen.points, seen.pixels, lens), axis=1), float)


def _inliers(distances: Sequence[FloatArray]) -> list[NDArray[np.bool_]]:
    """Corners within four standard deviations, those of their own view or of all views, whichever is more."""
    # The median of a two-dimensional normal distribution's length is 1.18 standard deviations.
    usual = float(np.median(np.concatenate(distances)))
    return [d <= max(_STDS * max(float(np.median(d)), usual) / 1.18, _FLOOR_PX) for d in distances]


def _rms(distances: FloatArray) -> float:
    return float(np.sqrt((distances**2).mean()))


def _why(mask: NDArray[np.bool_], error: float, usual: float) -> str:
    if mask.sum() < max(MIN_CORNERS, 0.5 * len(mask)):
        return f"only {mask.sum()} of {len(mask)} corners agree with the other views"
    return f"corners are {error:.2f} px off (RMS), those of the median view {usual:.2f}"
