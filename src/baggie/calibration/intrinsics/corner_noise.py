"""How exactly a board's corners were found, told from the pictures themselves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from baggie.geometry import FloatArray
from baggie.vision.targets import Seen

_TIMES = 1 + 9 + 9 + 1
"""The variance of a third difference, over that of what it is of."""
_MEDIAN_SQUARE = 0.4549
"""Of a standard normal distribution: the median of chi squared with one degree of freedom."""


def corner_noise_px(seen: Sequence[Seen], residuals: Sequence[FloatArray]) -> float | None:
    """Of how far corners are off `(N, 2)`, what goes from corner to corner: RMS distance, pixels.

    What a wrong lens or a bent board does goes smoothly over a board, and third differences along its rows and columns
    leave next to nothing of it; noise of independent corners gets twenty times its variance. By their median: a few
    corners may be wrong. None where no four corners lie side by side.
    """
    differences = [_third(view, off) for view, off in zip(seen, residuals, strict=True)]
    squares = np.concatenate(differences) ** 2
    if not squares.size:
        return None
    variance = np.median(squares) / (_MEDIAN_SQUARE * _TIMES)
    return float(np.sqrt(2 * variance))


def _third(view: Seen, residuals: FloatArray) -> FloatArray:
    """`(M,)`: the third differences of what stands side by side, along rows and columns, u and v."""
    steps = [np.unique(view.points[:, axis].round(6), return_inverse=True)[1] for axis in (0, 1)]
    grid = np.full((steps[1].max() + 1, steps[0].max() + 1, 2), np.nan)
    grid[steps[1], steps[0]] = residuals
    found = [np.diff(grid, 3, axis=axis).ravel() if grid.shape[axis] > 3 else np.zeros(0) for axis in (0, 1)]
    every = np.concatenate(found)
    return np.asarray(every[np.isfinite(every)], float)
