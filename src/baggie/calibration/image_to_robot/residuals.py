"""What a map from the picture to the robot makes of the points it was fitted to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baggie.geometry import FloatArray

_COLUMNS = ("x_m", "y_m", "z_m", "dx_mm", "dy_mm", "left_out_dx_mm", "left_out_dy_mm", "kept")


@dataclass(frozen=True)
class Residuals:
    """One row a point, those that were dropped included, which take no part in the figures."""

    points: FloatArray
    """`(N, 3)` metres, robot base frame."""
    error_mm: FloatArray
    """`(N, 2)`: where the point's pixel is mapped at the point's height, less where it was."""
    left_out_mm: FloatArray
    """`(N, 2)`: the same, mapped by a fit to the other points: what to expect of a new point."""
    kept: NDArray[np.bool_]
    """`(N,)`; False for a point that is more than four standard deviations off, and was left out of the fit."""

    @property
    def rms_mm(self) -> float:
        """Root mean square distance."""
        return _rms(self.error_mm[self.kept])

    @property
    def max_mm(self) -> float:
        """The greatest distance."""
        return float(np.linalg.norm(self.error_mm[self.kept], axis=1).max())

    @property
    def leave_one_out_mm(self) -> float:
        """Root mean square distance of left-out points."""
        return _rms(self.left_out_mm[self.kept])

    @property
    def leave_one_out_max_mm(self) -> float:
        """The greatest distance of a left-out point."""
        return float(np.linalg.norm(self.left_out_mm[self.kept], axis=1).max())

    def to_yaml(self) -> dict[str, Any]:
        """As they stand in a file."""
        numbers = np.hstack([self.points, self.error_mm, self.left_out_mm]).tolist()
        rows = [[*row, bool(kept)] for row, kept in zip(numbers, self.kept, strict=True)]
        return {"columns": list(_COLUMNS), "rows": rows}

    @classmethod
    def from_yaml(cls, content: Mapping[str, Any]) -> Residuals:
        """The inverse of `to_yaml`."""
        rows = content["rows"]
        numbers = np.array([row[:7] for row in rows], float).reshape(-1, 7)
        return cls(
            numbers[:, :3], numbers[:, 3:5], numbers[:, 5:], np.array([bool(row[7]) for row in rows], bool)
        )


def _rms(vectors: FloatArray) -> float:
    """Of the lengths of `(N, 2)`."""
    return float(np.sqrt((vectors**2).sum(axis=1).mean()))
