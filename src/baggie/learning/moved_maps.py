"""Height maps to learn from: turned, shifted or rearranged, as other cameras and lamps would show them, labels exact.

Gaps are where nobody looks into, shadows are cast elsewhere. Cameras look from aside, so what they see between things
depends on which way these stand. From one demonstration a network takes that, and which way the shadow fell, for the
task.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from baggie.geometry import FloatArray, apply_homography, wrap_angle
from baggie.learning.demonstrations import Demonstrations
from baggie.learning.rearranged import MarkedMap, rearranged, turn_about
from baggie.types import Image
from baggie.vision.carried import ObjectMap, place_belongs_to

_GAP_M = 0.01
"""A gap is deeper."""
_SHADOW_PX = 16
"""Shadows are no longer."""


class Light(NamedTuple):
    """The direction and strength of a lamp that stands aside and casts shadows."""

    way: float
    """Where it comes from, radians from u towards v."""
    rise: float
    """Metres by which it falls a metre of its way."""
    dark: float
    """The share of all light that is missing in its shadow."""

    @classmethod
    def random(cls, rng: np.random.Generator) -> Self:
        """From anywhere."""
        return cls(rng.uniform(-math.pi, math.pi), rng.uniform(0.5, 3.0), rng.uniform(0.1, 0.5))


def with_gaps_closed(
    color: Image, height: NDArray[np.float32], size_px: int
) -> tuple[Image, NDArray[np.float32]]:
    """Colours `(H, W, 3)` and heights `(H, W)` metres of a map whose gaps look like the highest thing beside them.

    Closed are those narrower than `size_px`, an odd number of pixels; none where that is 1.
    """
    square = np.ones((size_px, size_px), np.uint8)
    closed = cv2.morphologyEx(height, cv2.MORPH_CLOSE, square)
    gaps = closed > height + _GAP_M
    if not gaps.any():
        return color, height
    # Of each pixel's surroundings the highest, told by its height in tenths of millimetres and its number: exact only
    # in double precision.
    numbers = np.arange(height.size, dtype=float).reshape(height.shape)
    highest = cv2.dilate(np.round(height.astype(float) * 1e4) * height.size + numbers, square)
    beside = (highest[gaps] % height.size).astype(int)
    closed_color = color.copy()
    closed_color[gaps] = color.reshape(-1, 3)[beside]
    return closed_color, np.where(gaps, closed, height)


def with_shadow(color: Image, height: NDArray[np.float32], light: Light, pixel_m: float) -> Image:
    """The colours `(H, W, 3)` of a map with a shadow cast over its heights `(H, W)`; pixels are of `pixel_m` metres."""
    shadow = np.zeros(height.shape, np.uint8)
    rows, columns = height.shape
    for far in range(1, _SHADOW_PX + 1):
        move = np.array([[1.0, 0.0, -far * math.cos(light.way)], [0.0, 1.0, -far * math.sin(light.way)]])
        # What is so far towards the light.
        there = cv2.warpAffine(
            height, move, (columns, rows), flags=cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE
        )
        shadow |= there > height + far * pixel_m * light.rise
    left = 1 - light.dark * cv2.blur(shadow.astype(np.float32), (3, 3))
    return np.asarray((color * left[..., None]).round(), np.uint8)


_TRIES = 100
_GAIN, _BIAS, _GAMMA = 0.08, 8.0, 0.1
_INSIDE_PX = 16.0
"""So far inside a window are pick and place, with what is around them, unless the map ends there."""
_GAPS_M = 0.009375, 0.015625
"""Narrower gaps are closed: 3 or 5 of the usual pixels. Into wider ones cameras look, and things are put."""


@dataclass(frozen=True)
class Moves:
    """What is changed in maps."""

    share: float = 0.9
    """Of the samples that are moved; the rest stay as they were recorded, as maps at work are."""
    turn_rad: float = math.pi
    """Turned by at most so much either way."""
    shift_px: float = 40.0
    """Standard deviation of the shift along each axis."""
    margin_px: float = 2.0
    """Pick and place stay at least this far inside the map."""
    recolor: bool = True
    """Whether light and colour vary a little."""
    other_views: float = 0.5
    """The share of samples in which gaps are closed, and of those with another shadow; none unless colours vary."""


class MovedMap(NamedTuple):
    """One sample: a map and its labels in pixels of the map."""

    color: Image
    """`(H, W, 3)`."""
    height: NDArray[np.float32]
    """`(H, W)` metres."""
    places: FloatArray
    """`(2, 2)`: pick and place, (u, v) pixels."""
    yaws: FloatArray
    """`(2,)`: of pick and place, radians, from u towards v."""
    middle: FloatArray
    """`(2,)`: of what is picked, (u, v) pixels."""


class MovedMaps:
    """Demonstrations as N maps to draw samples from. A sample is a function of the generator alone."""

    def __init__(
        self,
        demonstrations: Demonstrations,
        moves: Moves,
        rearranged: float = 0.0,
        window: tuple[int, int] | None = None,
    ) -> None:
        """`rearranged`: the share of samples in which everything that stands alone is moved by itself. `window` (width,
        height) pixels: of the map that a sample shows; all of it unless given.
        """
        self._shown, self._moves, self._share, self._window = demonstrations, moves, rearranged, window
        self._places = demonstrations.places
        self._yaws: FloatArray = demonstrations.poses[:, [2, 5]]
        self._known: dict[int, tuple[ObjectMap, NDArray[np.int32] | None]] = {}
        # What comes in from outside looks like the table, which is most of every map.
        self._table_color = np.median(demonstrations.colors[:, ::4, ::4], axis=(1, 2))
        self._table_height = np.median(demonstrations.heights[:, ::4, ::4], axis=(1, 2))

    def __len__(self) -> int:
        return len(self._places)

    def draw(self, rng: np.random.Generator, numbers: Sequence[int]) -> list[MovedMap]:
        """Demonstrations `numbers`, each moved at random: all in windows of the map where all fit, else all whole.

        Whole maps are as they are where no move that was tried keeps pick and place in.
        """
        rows, columns = self._shown.grid.shape
        whole = columns, rows
        window = (
            whole if self._window is None else (min(columns, self._window[0]), min(rows, self._window[1]))
        )
        moved = [self._drawn(rng, number, window) for number in numbers]
        if window != whole and any(each is None for each in moved):
            moved = [self._drawn(rng, number, whole) for number in numbers]
        drawn = [
            self.moved(number, np.eye(3)) if each is None else each
            for number, each in zip(numbers, moved, strict=True)
        ]
        return [self._seen_otherwise(rng, each) for each in drawn] if self._moves.recolor else drawn

    def _seen_otherwise(self, rng: np.random.Generator, moved: MovedMap) -> MovedMap:
        """Redraw a map in slightly other light, and now and then as from another side."""
        color, height, pixel_m = moved.color, moved.height, self._shown.grid.pixel_m
        if rng.random() < self._moves.other_views:
            odd = 2 * round((rng.choice(_GAPS_M) / pixel_m - 1) / 2) + 1
            color, height = with_gaps_closed(color, height, odd)
        if rng.random() < self._moves.other_views:
            color = with_shadow(color, height, Light.random(rng), pixel_m)
        gain = 1 + _GAIN * rng.uniform(-1, 1, 3)
        bias = _BIAS * rng.uniform(-1, 1)
        gamma = math.exp(_GAMMA * rng.uniform(-1, 1))
        levels = np.linspace(0, 1, 256)[:, None] ** gamma * 255 * gain + bias
        table = np.clip(levels, 0, 255).round().astype(np.uint8)
        return moved._replace(color=np.asarray(cv2.LUT(color, table[:, None]), np.uint8), height=height)

    def _drawn(self, rng: np.random.Generator, number: int, size: tuple[int, int]) -> MovedMap | None:
        moved = self._rearranged(rng, number, size) if rng.random() < self._share else None
        if moved is None:
            move = self._random_move(rng, self._places[number], size)
            moved = None if move is None else self.moved(number, move, size)
        return moved

    def _random_move(
        self, rng: np.random.Generator, places: FloatArray, size: tuple[int, int]
    ) -> FloatArray | None:
        rows, columns = self._shown.grid.shape
        return random_move(rng, places, (columns, rows), self._moves, size)

    def _rearranged(self, rng: np.random.Generator, number: int, size: tuple[int, int]) -> MovedMap | None:
        """None where nothing stands alone, no room was found, or nothing tells what the place belongs to."""
        places, (things, at) = self._places[number], self._things(number)
        if at is None or not at.any():
            return None
        scene = MarkedMap(self._shown.colors[number], self._shown.heights[number], places, at)
        table_move = self._random_move(rng, places[at == 0], size)
        found = None if table_move is None else rearranged(rng, scene, things, table_move, size)
        if found is None:
            return None
        turns = np.arctan2(found.moves[:, 1, 0], found.moves[:, 0, 0])
        there = [apply_homography(*each)[0] for each in zip(found.moves, places[:, None], strict=True)]
        middle = apply_homography(found.moves[0], self._shown.middles[number])[0]
        yaws = wrap_angle(self._yaws[number] + turns)
        return MovedMap(found.color, found.height, np.stack(there), yaws, middle)

    def _things(self, number: int) -> tuple[ObjectMap, NDArray[np.int32] | None]:
        """What stands in demonstration `number`, and to which of it pick and place `(2,)` belong, if anything tells."""
        if number not in self._known:
            places, height = self._places[number], self._shown.heights[number]
            things = ObjectMap.on(height)
            at: NDArray[np.int32] | None = things.at(places)
            carried = self._shown.carried[number] if self._shown.carried else None
            if carried is not None and at is not None:
                lies = carried.moved(places, float(self._yaws[number] @ [-1, 1]))
                belongs = place_belongs_to(things, self._shown.colors[number], lies)
                picked = things.under(carried.stood) or at[0]
                at = None if belongs is None else np.array([picked, belongs], np.int32)
            self._known[number] = things, at
        return self._known[number]

    def moved(self, number: int, move: FloatArray, size: tuple[int, int] | None = None) -> MovedMap:
        """Demonstration `number` after a rigid motion of the plane: `(3, 3)`, pixels -> pixels.

        `size` (width, height) pixels: of what is kept; the whole map unless given.
        """
        rows, columns = self._shown.grid.shape
        size = size or (columns, rows)
        color = cv2.warpPerspective(
            self._shown.colors[number],
            move,
            size,
            flags=cv2.INTER_LINEAR,
            borderValue=self._table_color[number].tolist(),
        )
        height = cv2.warpPerspective(
            self._shown.heights[number],
            move,
            size,
            flags=cv2.INTER_LINEAR,
            borderValue=float(self._table_height[number]),
        )
        turn = math.atan2(move[1, 0], move[0, 0])
        return MovedMap(
            np.asarray(color, np.uint8),
            np.asarray(height, np.float32),
            apply_homography(move, self._places[number]),
            wrap_angle(self._yaws[number] + turn),
            apply_homography(move, self._shown.middles[number])[0],
        )


def rigid_move(turn: float, shift: FloatArray, size: tuple[int, int]) -> FloatArray:
    """A turn (radians, from u towards v) about the middle of a map of `(width, height)` pixels, then a shift `(2,)`
    (u, v) pixels: `(3, 3)`, pixels -> pixels, centres at integers.
    """
    middle = (np.asarray(size) - 1) / 2
    return turn_about(middle, turn, middle + shift)


def random_move(
    rng: np.random.Generator,
    places: FloatArray,
    size: tuple[int, int],
    moves: Moves,
    window: tuple[int, int],
) -> FloatArray | None:
    """A rigid motion that keeps `places` `(N, 2)` (u, v) pixels within the map of `size` (width, height) pixels, and
    within a `window` of it: `(3, 3)`, pixels -> pixels of the window; None where no try does.
    """
    is_moved = rng.random() < moves.share
    for _ in range(_TRIES if is_moved else 1):
        move: FloatArray = np.eye(3)
        if is_moved:
            turn = rng.uniform(-moves.turn_rad, moves.turn_rad)
            move = rigid_move(turn, rng.normal(0, moves.shift_px, 2), size)
        there = apply_homography(move, places) if len(places) else places
        least, most = there.min(axis=0, initial=math.inf), there.max(axis=0, initial=-math.inf)
        on_map = (least >= moves.margin_px).all() and (most <= np.array(size) - 1 - moves.margin_px).all()
        # A window's rim is further off than the map's own, where there is nothing more to see.
        first = np.clip(np.ceil(most + _INSIDE_PX + 1 - window), 0, np.subtract(size, window)).astype(int)
        last = np.clip(np.floor(least - _INSIDE_PX), 0, np.subtract(size, window)).astype(int)
        if on_map and (first <= last).all():
            move[:2, 2] -= rng.integers(first, last + 1)
            return move
    return None
