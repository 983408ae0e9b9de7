"""The grid of an orthographic picture: which pixel shows which place on the table."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baggie.errors import BaggieError
from baggie.geometry import FloatArray


@dataclass(frozen=True)
class Grid:
    """The box of space that a height map shows, in the robot's base frame, and the size of its pixels.

    Rows run along y and columns along x, as in Ravens: u grows with x, v with y. Pixels are (u, v) with centres at
    integers, so the middle of pixel 0 is half a pixel inside the lower bound. The defaults are those of Ravens.

    Raises `BaggieError` for bounds that are no whole number of pixels, at least one, or the wrong way round.
    """

    x: tuple[float, float] = (0.25, 0.75)
    """Metres, lower and upper bound."""
    y: tuple[float, float] = (-0.5, 0.5)
    z: tuple[float, float] = (0.0, 0.28)
    pixel_m: float = 0.003125

    def __post_init__(self) -> None:
        if not 0 < self.pixel_m < np.inf:
            raise BaggieError(
                f"expected pixels of a positive size in metres, got {self.pixel_m}; try 0.003125"
            )
        for axis, (low, high) in (("x", self.x), ("y", self.y), ("z", self.z)):
            if not -np.inf < low < high < np.inf:
                raise BaggieError(
                    f"expected bounds of {axis} from low to high, metres, got {low} to {high}; give the lower first"
                )
        for axis, (low, high) in (("x", self.x), ("y", self.y)):
            pixels = (high - low) / self.pixel_m
            whole = max(round(pixels), 1)
            if abs(pixels - whole) > 1e-6:
                raise BaggieError(
                    f"expected bounds of {axis} a whole number of {self.pixel_m} m pixels apart, got {low} to {high} "
                    f"({pixels:.2f} pixels); end at {low + whole * self.pixel_m:.9g}"
                )

    @property
    def shape(self) -> tuple[int, int]:
        """`(rows, columns)` of a height map."""
        rows, columns = (round((high - low) / self.pixel_m) for low, high in (self.y, self.x))
        return rows, columns

    def to_pixels(self, xy: ArrayLike) -> FloatArray:
        """`(N, 2)` metres in the robot's base frame -> `(N, 2)` pixels (u, v), inside the grid or not."""
        return (np.asarray(xy, float).reshape(-1, 2) - [self.x[0], self.y[0]]) / self.pixel_m - 0.5

    def to_robot(self, pixels: ArrayLike) -> FloatArray:
        """The inverse of `to_pixels`: `(N, 2)` pixels (u, v) -> `(N, 2)` metres."""
        return (np.asarray(pixels, float).reshape(-1, 2) + 0.5) * self.pixel_m + [self.x[0], self.y[0]]

    def contains(self, xy: ArrayLike) -> NDArray[np.bool_]:
        """Which points `(N, 2)` metres lie in one of the pixels: `(N,)`. The upper bounds themselves do not."""
        rows, columns = self.shape
        edges = self.to_pixels(xy) + 0.5
        return np.asarray(((edges >= 0) & (edges < [columns, rows])).all(axis=1))
