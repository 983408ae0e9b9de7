"""How many distortion terms the pictures justify, judged on views the fit has not seen, and what doubt remains."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from baggie.calibration.intrinsics.lens_bundle import LensFit, LensGuess, fit_lens, settle_lens
from baggie.calibration.intrinsics.opencv_lens import board_pose, subset
from baggie.calibration.pose import residuals_px
from baggie.errors import CalibrationError
from baggie.geometry import FloatArray
from baggie.types import Intrinsics
from baggie.vision.targets import Seen

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
    seen: Sequence[Seen], size: tuple[int, int], start: Intrinsics, board: FloatArray
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


def held_out_error(seen: Seen, lens: Intrinsics) -> float:
    """Square pixels: half of the corners say where the board is, the error is that of the other half; both ways.

    A view's own pose would absorb much of a lens's error if it were fitted to the same corners.
    """
    first = _every_other(seen)
    halves = subset(seen, first), subset(seen, ~first)
    squares = [
        (residuals_px(board_pose(placed, lens), judged.points, judged.pixels, lens) ** 2).sum(axis=1)
        for placed, judged in (halves, halves[::-1])
    ]
    return float(np.concatenate(squares).mean())


def _every_other(seen: Seen) -> NDArray[np.bool_]:
    """`(N,)`: about half of the corners, as the white squares of a chessboard lie, so that no half is on one line."""
    columns, rows = (np.unique(seen.points[:, axis].round(6), return_inverse=True)[1] for axis in (0, 1))
    white = np.asarray((columns + rows) % 2 == 0, np.bool_)
    even = 4 <= white.sum() <= len(white) - 4
    return white if even else np.arange(len(white)) % 2 == 0


def _held_out(seen: Sequence[Seen], fit: LensFit, terms: Sequence[str], board: FloatArray) -> FloatArray:
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
