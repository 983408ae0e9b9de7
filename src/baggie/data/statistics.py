"""Statistics of a growing dataset, exact at any time, at a cost per attempt that hardly grows.

LeRobot's own writer averages the quantiles of its episodes, which for one-frame episodes gives q01 = q99 =
mean. Here every value seen is kept, sorted, column by column (8 bytes a number), and pictures are kept as
histograms: 256 counts a channel hold all there is to know about 8-bit pixels.
"""

from __future__ import annotations

from array import array
from bisect import insort
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from baggie.geometry import FloatArray
from baggie.types import Image

QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}

_PLAIN: dict[str, Callable[[float], Any]] = {"f": float, "i": int, "b": bool}
"""How a minimum or maximum is written, by the kind of its feature's dtype."""

FeatureStats = dict[str, list[Any]]
"""`min`, `max`, `mean`, `std`, `count` and the quantiles of one feature, as LeRobot stores them."""


def histogram(color: Image) -> NDArray[np.int32]:
    """How many pixels have each value: RGB `(H, W, 3)` uint8 -> `(3, 256)`."""
    counts = [cv2.calcHist([color], [c], None, [256], [0, 256]) for c in range(3)]
    return np.stack([count.ravel() for count in counts]).astype(np.int32)


def pixel_stats(counts: ArrayLike, pictures: int) -> FeatureStats:
    """Statistics in [0, 1] of all pixels behind a histogram `(3, 256)`; every entry is `(3, 1, 1)`."""
    counts = np.asarray(counts, np.int64)
    values = np.arange(256)
    total = counts.sum(axis=1)
    mean = counts @ values / total
    std = np.sqrt(np.maximum(0, counts @ values**2 / total - mean**2))
    cumulative = counts.cumsum(axis=1)

    def ranked(q: float) -> FloatArray:
        """The q-quantile of each channel, interpolated between neighbours as numpy does by default."""
        rank = q * (total - 1)
        low = np.floor(rank)
        below, above = (
            np.array([int(np.searchsorted(c, r, "right")) for c, r in zip(cumulative, rs, strict=True)])
            for rs in (low, np.ceil(rank))
        )
        return np.asarray(below + (above - below) * (rank - low))

    stats = {"min": ranked(0), "max": ranked(1), "mean": mean, "std": std}
    stats |= {name: ranked(q) for name, q in QUANTILES.items()}
    shaped = {name: (value / 255).reshape(3, 1, 1).tolist() for name, value in stats.items()}
    return {**shaped, "count": [pictures]}


def value_stats(values: Sequence[ArrayLike]) -> FeatureStats:
    """Statistics of a feature in an episode: a number or a vector `(length,)` for each of its frames."""
    rows = np.stack([np.atleast_1d(value) for value in values])
    numbers = rows.astype(float)
    ranked = np.quantile(numbers, list(QUANTILES.values()), axis=0)
    return {
        "min": rows.min(axis=0).tolist(),
        "max": rows.max(axis=0).tolist(),
        "mean": numbers.mean(axis=0).tolist(),
        **dict(zip(QUANTILES, ranked.tolist(), strict=True)),
        "std": numbers.std(axis=0).tolist(),
        "count": [len(rows)],
    }


class RunningStats:
    """Exact statistics of numbers seen so far; `add` costs microseconds a number.

    Features are named vectors of a fixed length; NumPy dtypes tell how their minimum and maximum are written.
    """

    def __init__(self, rows: Sequence[Mapping[str, ArrayLike]], dtypes: Mapping[str, np.dtype[Any]]) -> None:
        """Start from the rows seen already; `dtypes` names the features, in order."""
        self._dtypes = dtypes
        self._columns: list[array[float]] = []
        self._lengths: dict[str, int] = {}
        self._count = len(rows)
        self._mean = np.zeros(0)
        self._squares = np.zeros(0)
        if rows:
            self._start(np.array([self._flat(row) for row in rows]), rows[0])

    def _flat(self, row: Mapping[str, ArrayLike]) -> FloatArray:
        return np.concatenate([np.ravel(np.asarray(row[name], float)) for name in self._dtypes])

    def _start(self, values: FloatArray, row: Mapping[str, ArrayLike]) -> None:
        self._lengths = {name: np.size(np.asarray(row[name])) for name in self._dtypes}
        self._columns = [array("d", column.tobytes()) for column in np.sort(values, axis=0).T.copy()]
        self._mean = values.mean(axis=0)
        self._squares = ((values - self._mean) ** 2).sum(axis=0)

    def add(self, row: Mapping[str, ArrayLike]) -> None:
        """See one row more."""
        values = self._flat(row)
        self._count += 1
        if self._count == 1:
            self._start(values[None], row)
            return
        # Welford, "Note on a method for calculating corrected sums of squares and products", 1962.
        delta = values - self._mean
        self._mean = self._mean + delta / self._count
        self._squares = self._squares + delta * (values - self._mean)
        for column, value in zip(self._columns, values.tolist(), strict=True):
            insort(column, value)

    def stats(self) -> dict[str, FeatureStats]:
        """Statistics of every feature."""
        std = np.sqrt(self._squares / max(self._count, 1))
        result, start = {}, 0
        for name, length in self._lengths.items():
            part = slice(start, start + length)
            columns, plain = self._columns[part], _PLAIN[self._dtypes[name].kind]
            stats: FeatureStats = {
                "min": [plain(column[0]) for column in columns],
                "max": [plain(column[-1]) for column in columns],
                "mean": self._mean[part].tolist(),
                "std": std[part].tolist(),
                "count": [self._count],
            }
            stats |= {key: [_quantile(column, q) for column in columns] for key, q in QUANTILES.items()}
            result[name] = stats
            start += length
        return result


def _quantile(ordered: Sequence[float], q: float) -> float:
    """The q-quantile of sorted numbers, interpolated between neighbours as numpy does by default."""
    rank = q * (len(ordered) - 1)
    low = int(rank)
    high = min(low + 1, len(ordered) - 1)
    return ordered[low] + (ordered[high] - ordered[low]) * (rank - low)
