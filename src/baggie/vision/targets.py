"""Printed things whose points a camera finds by itself: ChArUco boards, chessboards, single ArUco markers.

And what is black on them, rectangles in the target's own frame, for paper and for the simulator alike.

A target's frame is OpenCV's: its origin is the pattern's top left corner (of a chessboard, the first inner one; of a
marker, its middle), x runs right along the print, y down it, z into the paper. Marker points follow the same axes.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from baggie.errors import BaggieError
from baggie.geometry import FloatArray
from baggie.types import Image
from baggie.vision.corners import (
    FLAT,
    MAX_MOVE_PX,
    Sag,
    aruco_dictionary,
    grey_of,
    marker_detector,
    radius_px,
    refine_saddles,
    why_no_markers,
)
from baggie.vision.goal_card import refine_bent_sides

MIN_CORNERS = 6
"""Fewer corners of a board in a picture say too little about its pose."""


@dataclass(frozen=True)
class TargetDetection:
    """Points of a target found in one picture."""

    ids: NDArray[np.int64]
    """`(N,)`: which of the target's points."""
    pixels: FloatArray
    """`(N, 2)` (u, v), sub-pixel."""
    points: FloatArray
    """`(N, 3)` metres, the same points in the target's frame."""


class Target(Protocol):
    """Something printed, of known size."""

    @property
    def spec(self) -> str:
        """How a person writes it: what `parse_target` reads."""
        ...

    @property
    def points(self) -> FloatArray:
        """`(N, 3)` metres: all its points in its own frame, in the order of their ids."""
        ...

    @property
    def sag(self) -> Sag:
        """How it is bent: its points are where that puts them."""
        ...

    def detect(self, image: Image) -> TargetDetection | None:
        """Find its points in a picture `(H, W, 3)`; None where too few are found."""
        ...

    def why_not(self, image: Image) -> str:
        """One clause: why `detect` found nothing in this picture, as far as can be told."""
        ...


@dataclass(frozen=True)
class Charuco:
    """A chessboard with an ArUco marker in each white square: found even when partly hidden."""

    columns: int
    rows: int
    square_m: float
    marker_m: float
    dictionary: str
    legacy: bool = False
    """As OpenCV before 4.6 laid out boards with an even number of rows: a marker in the top left square."""
    sag: Sag = FLAT
    """How it is bent."""

    def __post_init__(self) -> None:
        """Raise `BaggieError` where its dictionary has too few markers for it."""
        count = len(aruco_dictionary(self.dictionary).bytesList)
        if self.markers > count:
            raise BaggieError(
                f"{self.spec} needs {self.markers} markers and {self.dictionary} has {count}; take a larger dictionary "
                "(the largest have 1000, as DICT_4X4_1000 has), or fewer squares"
            )

    @property
    def spec(self) -> str:
        """`charuco:COLUMNSxROWS:SQUARE:MARKER:DICTIONARY`, metres."""
        return f"charuco:{self.columns}x{self.rows}:{self.square_m:g}:{self.marker_m:g}:{self.dictionary}"

    @property
    def markers(self) -> int:
        """How many it has: one in each white square."""
        return self.columns * self.rows // 2

    @cached_property
    def board(self) -> cv2.aruco.CharucoBoard:
        """OpenCV's own board."""
        size = (self.columns, self.rows)
        board = cv2.aruco.CharucoBoard(size, self.square_m, self.marker_m, aruco_dictionary(self.dictionary))
        board.setLegacyPattern(self.legacy)
        return board

    @property
    def points(self) -> FloatArray:
        """`(N, 3)` metres: the inner corners, row by row."""
        flat = np.asarray(self.board.getChessboardCorners(), float)
        return self.sag.bend(flat, flat)

    def detect(self, image: Image) -> TargetDetection | None:
        """Find its inner corners in a picture, whichever of the two layouts was printed."""
        found = self._detect_as_laid_out(image)
        other = None if found else replace(self, legacy=not self.legacy)._detect_as_laid_out(image)
        return found or other

    def _detect_as_laid_out(self, image: Image) -> TargetDetection | None:
        grey = grey_of(image)
        parameters = cv2.aruco.CharucoParameters()
        parameters.tryRefineMarkers = (
            True  # a blurred board whose markers are 18 pixels: 71 of 77 corners, not 14
        )
        corners, ids, _, _ = cv2.aruco.CharucoDetector(self.board, parameters).detectBoard(grey)
        if ids is None or len(ids) < MIN_CORNERS:
            return None
        index = np.asarray(ids.ravel(), np.int64)
        pixels = np.asarray(corners, float).reshape(-1, 2)
        # The window's own corner, too, must end before a marker's, which would draw it towards the board's middle.
        clear = (self.square_m - self.marker_m) / 2 / self.square_m
        return TargetDetection(
            index, refine_saddles(grey, pixels, radius_px(pixels, clear)), self.points[index]
        )

    def why_not(self, image: Image) -> str:
        """Markers of another dictionary, a mirrored picture, too few corners, or nothing at all."""
        turned = replace(self, columns=self.rows, rows=self.columns)
        if self.columns != self.rows and turned.detect(image):
            return f"it is a board of {self.rows}x{self.columns} squares, not {self.columns}x{self.rows}; say it so"
        return why_no_markers(image, self.dictionary, self.markers)


@dataclass(frozen=True)
class Chessboard:
    """A plain chessboard; the whole of it must be in the picture.

    `columns` x `rows` are its inner corners, as OpenCV and ROS count; who counted squares is understood, too.
    """

    columns: int
    rows: int
    square_m: float
    sag: Sag = FLAT
    """How it is bent."""

    @property
    def spec(self) -> str:
        """`chessboard:COLUMNSxROWS:SQUARE`, metres."""
        return f"chessboard:{self.columns}x{self.rows}:{self.square_m:g}"

    @property
    def points(self) -> FloatArray:
        """`(N, 3)` metres: the inner corners, row by row."""
        return self.sag.bend(self._flat, self._flat)

    @property
    def _flat(self) -> FloatArray:
        v, u = np.mgrid[: self.rows, : self.columns]
        return np.stack([u, v, np.zeros_like(u)], axis=-1).reshape(-1, 3) * self.square_m

    def detect(self, image: Image) -> TargetDetection | None:
        """Find all its inner corners, or None."""
        grey = grey_of(image)
        for board in (self, Chessboard(self.columns - 1, self.rows - 1, self.square_m)):
            if min(board.columns, board.rows) < 2:
                continue
            size = (board.columns, board.rows)
            found, corners = cv2.findChessboardCornersSB(grey, size, flags=cv2.CALIB_CB_ACCURACY)
            if not found:
                quick = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_FAST_CHECK
                found, corners = cv2.findChessboardCorners(grey, size, flags=quick)
                if found:
                    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 40, 1e-3)
                    corners = cv2.cornerSubPix(grey, corners, (5, 5), (-1, -1), stop)
                    if (board.columns + board.rows) % 2:
                        # Its two ends differ then: this function counts from the black one, the other from the white.
                        corners = corners[::-1]
            if found:
                pixels = np.asarray(corners, float).reshape(-1, 2)
                pixels = refine_saddles(grey, pixels, radius_px(pixels, 0.5))
                points = self.sag.bend(board._flat, self._flat)
                return TargetDetection(np.arange(len(pixels), dtype=np.int64), pixels, points)
        return None

    def why_not(self, image: Image) -> str:
        """A chessboard is found whole or not at all."""
        return f"no chessboard with {self.columns} x {self.rows} inner corners (or squares) is wholly in the picture"


@dataclass(frozen=True)
class ArucoMarker:
    """One ArUco marker."""

    dictionary: str
    number: int
    size_m: float
    """Side of the black square."""

    @property
    def spec(self) -> str:
        """`aruco:DICTIONARY:NUMBER:SIZE`, metres."""
        return f"aruco:{self.dictionary}:{self.number}:{self.size_m:g}"

    @property
    def points(self) -> FloatArray:
        """`(4, 3)` metres: its corners from the top left one clockwise; the origin is its middle."""
        half = self.size_m / 2
        return np.array([[-half, -half, 0], [half, -half, 0], [half, half, 0], [-half, half, 0]])

    @property
    def sag(self) -> Sag:
        """None: four corners say nothing of it."""
        return FLAT

    def detect(self, image: Image) -> TargetDetection | None:
        """Find its four corners in a picture."""
        corners, ids, _ = marker_detector(self.dictionary).detectMarkers(grey_of(image))
        matches = [] if ids is None else np.flatnonzero(ids.ravel() == self.number)
        if len(matches) != 1:
            return None
        found = np.asarray(corners[matches[0]], float).reshape(4, 2)
        cell = 1 / (
            aruco_dictionary(self.dictionary).markerSize + 2
        )  # its black border, and the white around it
        better = refine_bent_sides(image, found, cell)
        if better is not None and np.linalg.norm(better - found, axis=1).max() < MAX_MOVE_PX:
            found = better
        return TargetDetection(np.arange(4, dtype=np.int64), found, self.points)

    def why_not(self, image: Image) -> str:
        """Seen twice, another marker or dictionary, a mirrored picture, or nothing at all."""
        _, ids, _ = marker_detector(self.dictionary).detectMarkers(grey_of(image))
        if ids is not None and (ids == self.number).sum() > 1:
            return f"marker {self.number} is in the picture {(ids == self.number).sum()} times; leave one"
        if ids is not None:
            others = ", ".join(map(str, sorted(set(ids.ravel().tolist()))))
            return f"marker {self.number} of {self.dictionary} is not in the picture, but {others} is"
        return why_no_markers(image, self.dictionary, 1)


def with_sag(target: Target, sag: Sag) -> Target:
    """A board bent so; a marker, which is too small for that, as it is."""
    return replace(target, sag=sag) if isinstance(target, Charuco | Chessboard) else target


def parse_target(spec: str) -> Target:
    """The target a person wrote down.

    `charuco:COLUMNSxROWS:SQUARE:MARKER:DICTIONARY`, `chessboard:COLUMNSxROWS:SQUARE` or
    `aruco:DICTIONARY:NUMBER:SIZE`, all sizes in metres. Raises `BaggieError` for anything else.
    """
    kind, *words = spec.split(":")
    try:
        if kind == "charuco" and len(words) == 4:
            columns, rows = _grid(words[0])
            board = Charuco(columns, rows, float(words[1]), float(words[2]), _dictionary_name(words[3]))
            _check(board.columns >= 2 and board.rows >= 2, "at least 2 x 2 squares")
            _check(0 < board.marker_m < board.square_m, "markers smaller than the squares, both above 0")
            _check(board.square_m < 1, "sizes in metres, squares under 1 m")
            return board
        if kind == "chessboard" and len(words) == 2:
            chessboard = Chessboard(*_grid(words[0]), float(words[1]))
            _check(min(chessboard.columns, chessboard.rows) >= 3, "at least 3 x 3 corners")
            _check(0 < chessboard.square_m < 1, "sizes in metres, squares between 0 and 1 m")
            return chessboard
        if kind == "aruco" and len(words) == 3:
            marker = ArucoMarker(_dictionary_name(words[0]), int(words[1]), float(words[2]))
            count = len(aruco_dictionary(marker.dictionary).bytesList)
            _check(0 <= marker.number < count, f"a number below {count} in {marker.dictionary}")
            _check(0 < marker.size_m < 1, "sizes in metres, between 0 and 1 m")
            return marker
        raise ValueError("a target of one of the kinds below")
    except (ValueError, IndexError) as error:
        raise BaggieError(
            f"cannot read the target {spec!r} (expected {error}); write charuco:COLUMNSxROWS:SQUARE:MARKER:DICTIONARY, "
            "chessboard:COLUMNSxROWS:SQUARE or aruco:DICTIONARY:NUMBER:SIZE, sizes in metres, "
            "for example charuco:7x5:0.030:0.021:DICT_4X4_50"
        ) from None


def _check(right: bool, expected: str) -> None:
    if not right:
        raise ValueError(expected)


def _grid(words: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d{1,3})x(\d{1,3})", words)
    if match is None:
        raise ValueError("a grid such as 7x5, at most 999x999")
    return int(match[1]), int(match[2])


def _dictionary_name(name: str) -> str:
    full = name if name.startswith("DICT_") else f"DICT_{name}"
    if not isinstance(getattr(cv2.aruco, full, None), int):
        raise ValueError("a dictionary of OpenCV's such as DICT_4X4_50")
    return full


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
            dictionary = aruco_dictionary(target.dictionary)
            half = target.size_m / 2
            bounds = np.array([-half, -half, half, half])
            return Pattern(_marker(dictionary, target.number, bounds), bounds)
    raise BaggieError(f"expected a ChArUco board, a chessboard or a marker to draw, got {target!r}")


def _charuco(target: Charuco) -> Pattern:
    dictionary = aruco_dictionary(target.dictionary)
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
