"""How far apart two maps from the picture to the robot place the same pixel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from baggie.errors import CalibrationError
from baggie.geometry import FloatArray, Rectangle


@dataclass(frozen=True)
class Comparison:
    """Where map `b` places what map `a` sees at each point of a grid, less where `a` places it."""

    area: Rectangle
    height_m: float
    points: FloatArray
    """`(N, 2)` metres, robot base frame, spread evenly over the area."""
    difference_mm: FloatArray
    """`(N, 2)`; NaN where b does not reach the plane."""

    @property
    def rms_mm(self) -> float:
        """Root mean square distance."""
        return float(np.sqrt((self.difference_mm**2).sum(axis=1).mean()))

    @property
    def max_mm(self) -> float:
        """The greatest distance."""
        return float(np.linalg.norm(self.difference_mm, axis=1).max())

    @property
    def shift_mm(self) -> FloatArray:
        """`(2,)`: the mean difference, x and y; a camera or robot that was moved shows here."""
        return np.asarray(self.difference_mm.mean(axis=0))

    def summary(self) -> dict[str, Any]:
        """Ready for JSON."""
        return {
            "height_m": self.height_m,
            "rms_mm": self.rms_mm,
            "max_mm": self.max_mm,
            "shift_mm": self.shift_mm.tolist(),
        }


def lattice(area: Rectangle, rows: int, columns: int) -> FloatArray:
    """Points spread evenly over an area, edges included, x slowest: `(rows * columns, 2)` metres."""
    x = np.linspace(area.x_min, area.x_max, rows)
    y = np.linspace(area.y_min, area.y_max, columns)
    return np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)


def shared_area(a: Rectangle, b: Rectangle) -> Rectangle:
    """What both areas cover. Raises `CalibrationError` where they do not meet."""
    x_min, x_max = max(a.x_min, b.x_min), min(a.x_max, b.x_max)
    y_min, y_max = max(a.y_min, b.y_min), min(a.y_max, b.y_max)
    if x_min >= x_max or y_min >= y_max:
        raise CalibrationError(
            f"expected maps of one area, got {a} and {b}; compare maps of the same workspace"
        )
    return Rectangle(x_min, x_max, y_min, y_max)
