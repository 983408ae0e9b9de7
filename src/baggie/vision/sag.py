"""How a printed board that is not flat is bent: two numbers, as paper on a board sags."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from baggie.geometry import FloatArray


@dataclass(frozen=True)
class Sag:
    """How far a board's middle is from the plane through its four outermost corners, metres.

    z = along (1 - x²) + across (1 - y²) in the board's frame, x and y from -1 to 1 between its outermost corners: a
    parabola each way, which is mrcal's `calobject_warp` (mrcal 2.2, `mrcal.ref_calibration_object`). Positive is into
    the paper: the print is hollow.
    """

    along_m: float = 0.0
    """Bowed along its rows, in which x runs."""
    across_m: float = 0.0
    """Bowed along its columns, in which y runs."""

    def __str__(self) -> str:
        return f"{1000 * abs(self.along_m):.1f} mm along, {1000 * abs(self.across_m):.1f} mm across"

    @classmethod
    def from_yaml(cls, content: Mapping[str, Any] | None) -> Sag | None:
        """What `dataclasses.asdict` wrote; None where nothing stands. Raises `KeyError`, `TypeError`, `ValueError`."""
        return None if content is None else cls(float(content["along_m"]), float(content["across_m"]))

    def bend(self, points: FloatArray, board: FloatArray) -> FloatArray:
        """`(N, 3)`: points of the flat board where they are on the bent one, whose corners are `board` `(M, 3)`."""
        depth = bows(points, board) @ np.array([self.along_m, self.across_m])
        return np.column_stack([points[:, :2], depth])


FLAT = Sag()


def bows(points: FloatArray, board: FloatArray) -> FloatArray:
    """`(N, 2)`: how much of the sag along and of that across points `(N, 3)` of a board `(M, 3)` get."""
    low, high = board[:, :2].min(axis=0), board[:, :2].max(axis=0)
    half = np.maximum((high - low) / 2, np.finfo(float).tiny)
    return np.asarray(1 - ((points[:, :2] - (low + high) / 2) / half) ** 2, float)
