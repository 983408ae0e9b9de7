"""What is black on a printed target: rectangles in the target's own frame, for paper and for the simulator alike."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from baggie.errors import BaggieError
from baggie.geometry import FloatArray
from baggie.vision.targets import ArucoMarker, Charuco, Chessboard, Target


@dataclass(frozen=True)
class Pattern:
    """The drawing of a target: black rectangles on white, none of which overlap. Metres, the target's frame."""

    black: FloatArray
    """`(N, 4)`: left, top, right, bottom; x runs right and y down."""
    bounds: FloatArray
    """`(4,)`: the same of the whole pattern, white squares at its edge included."""

    @property
    def size(self) -> FloatArray:
        """`(2,)`: width and height."""
        return self.bounds[2:] - self.bounds[:2]

    @property
    def middle(self) -> FloatArray:
        """`(2,)`: halfway between its edges."""
        return (self.bounds[:2] + self.bounds[2:]) / 2


def pattern(target: Target) -> Pattern:
    """How a target is drawn."""
    match target:
        case Charuco():
            return _charuco(target)
        case Chessboard():
            # Where its two ends differ, the white one is the first: from there its corners are counted when found.
            white_first = (target.columns + target.rows) % 2 == 1
            squares = (
                _checkers(target.columns + 1, target.rows + 1, target.square_m, white_first) - target.square_m
            )
            right, bottom = target.columns * target.square_m, target.rows * target.square_m
            return Pattern(squares, np.array([-target.square_m, -target.square_m, right, bottom]))
        case ArucoMarker():
            dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, target.dictionary))
            half = target.size_m / 2
            bounds = np.array([-half, -half, half, half])
            return Pattern(_marker(dictionary, target.number, bounds), bounds)
    raise BaggieError(f"expected a ChArUco board, a chessboard or a marker to draw, got {target!r}")


def _charuco(target: Charuco) -> Pattern:
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, target.dictionary))
    corners = np.asarray(target.board.getObjPoints(), float)[
        ..., :2
    ]  # (M, 4, 2), from the top left clockwise
    markers = [
        _marker(dictionary, number, np.r_[corner[0], corner[2]])
        for number, corner in zip(target.board.getIds(), corners, strict=True)
    ]
    squares = _checkers(target.columns, target.rows, target.square_m, white_first=_starts_white(target))
    bounds = np.array([0.0, 0.0, target.columns * target.square_m, target.rows * target.square_m])
    return Pattern(np.concatenate([squares, *markers]), bounds)


def _starts_white(target: Charuco) -> bool:
    """Whether the top left square is a white one; OpenCV counted from the bottom left before 4.6."""
    return target.legacy and target.rows % 2 == 0


def _checkers(columns: int, rows: int, square_m: float, white_first: bool = False) -> FloatArray:
    """The black squares of a chessboard whose top left corner is the origin."""
    row, column = np.nonzero(np.indices((rows, columns)).sum(axis=0) % 2 == int(white_first))
    corner = np.stack([column, row], axis=1) * square_m
    return np.concatenate([corner, corner + square_m], axis=1)


def _marker(dictionary: cv2.aruco.Dictionary, number: int, bounds: FloatArray) -> FloatArray:
    """A marker's black modules within `bounds` (left, top, right, bottom), those side by side as one rectangle."""
    modules = dictionary.markerSize + 2
    picture = cv2.aruco.generateImageMarker(dictionary, number, modules)
    module = (bounds[2:] - bounds[:2]) / modules
    black = np.pad(picture == 0, ((0, 0), (1, 1))).astype(np.int8)
    row, start = np.nonzero(np.diff(black, axis=1) == 1)
    _, end = np.nonzero(np.diff(black, axis=1) == -1)
    runs = np.stack([start, row, end, row + 1], axis=1)
    return np.asarray(bounds[[0, 1, 0, 1]] + runs * np.r_[module, module], float)
