"""Find the goal card, an evenly coloured rectangle on the table, and its sides to a small part of a pixel.

Its colour says where it may be (`color_mask.py`), its four straight edges where it is. Something that covers less
than half of a side spoils nothing; a lens may bend the sides.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from baggie.errors import BaggieError
from baggie.geometry import FloatArray
from baggie.options.values import CARD_COLOR
from baggie.types import Image
from baggie.vision.color_mask import (
    FIRST_THRESHOLD,
    Chroma,
    Mask,
    blobs,
    chroma_of,
    half_way,
    hue_likeness,
    hue_window,
    inside,
    outline,
    reference_of,
    shrunk,
)
from baggie.vision.draw import region_mask

_POINTS = 48
"""On each side, at which the way across it is looked at."""
_ENDS = 0.08
"""Of a side at each end that is left out: corners are rounded by blur."""
_STEP = 0.5
"""Pixels between samples across an edge."""
_ROUGH, _FINE_PX = 0.14, 6.0
"""How far to look on both sides of an edge: first this share of the shortest side, then this many pixels."""
_LEAST_CONTRAST = 12.0
"""Grey levels between card and surroundings (the norm over R, G and B) for an edge to count."""
_CLEAR = 0.75
"""Of what is even around a bent side, how much is looked at."""
_LEAST_REACH_PX = 1.5
"""Less far on both sides of an edge there is nothing but its blur."""
_ROUNDS = 2
"""Of looking across bent sides, from where they were found the time before."""
_OUTLIER, _NOISE_PX = 4.5, 0.02
"""Points further from a bent side than so many times the median, or the noise, are not of it."""
_MEETING_STEPS = 5
"""Of Newton's method, to where two nearly straight sides meet."""
_STRAIGHT_PX = 1.0
"""From the line, for a point to lie on it: without anti-aliasing an edge is a staircase of whole pixels."""


@dataclass(frozen=True)
class Sides:
    """Four sides found in a picture."""

    corners: FloatArray
    """`(4, 2)` pixels (u, v), where neighbouring sides meet."""
    straight: FloatArray
    """`(4,)`, the share of each side's points that lie on a straight line."""


def refine_sides(image: Image, corners: FloatArray, color: FloatArray) -> Sides | None:
    """The sides near those of a rough quadrilateral `corners` `(4, 2)` whose inside has the RGB `color` `(3,)`.

    None where a side is not to be seen.
    """
    picture = image.astype(np.float32)
    shortest = float(np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1).min())
    straight = np.zeros(4)
    for reach in (max(_ROUGH * shortest, _FINE_PX), _FINE_PX, _FINE_PX):
        lines = np.zeros((4, 3))
        for side in range(4):
            start, end = corners[side], corners[(side + 1) % 4]
            across = np.arange(-reach, reach + _STEP / 2, _STEP)[:, None] * _outwards(
                start, end, corners.mean(axis=0)
            )
            points = _edge_points(picture, _along(start, end), across, color if reach > _FINE_PX else None)
            fitted = _line(points, _STRAIGHT_PX + 0.02 * reach)
            if fitted is None:
                return None
            lines[side], on_it = fitted
            straight[side] = on_it / _POINTS
        met = np.cross(np.roll(lines, 1, axis=0), lines)
        if np.abs(met[:, 2]).min() < 1e-9:
            return None
        corners = met[:, :2] / met[:, 2:]
    return Sides(corners, straight)


def refine_bent_sides(image: Image, corners: FloatArray, even: float) -> FloatArray | None:
    """Corners `(4, 2)` (u, v) of a picture moved to where the sides near them meet, each side a parabola, as lenses
    bend straight lines; None where a side is not to be seen.

    `even`: how far to both sides of its edge the square and its surroundings are of one colour each, in sides. At
    corners themselves blur draws whatever is found towards the inside (`cv2.cornerSubPix`: 0.2 to 0.3 px).
    """
    picture = np.atleast_3d(image).astype(np.float32)
    for _ in range(_ROUNDS):
        shortest = float(np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1).min())
        reach = min(_FINE_PX, _CLEAR * even * shortest)
        if reach < _LEAST_REACH_PX:
            return None
        sides = [_bent_side(picture, corners, number, reach) for number in range(4)]
        found = [side for side in sides if side is not None]
        if len(found) < 4:
            return None
        corners = np.array([_meeting(found[k - 1], found[k], corners[k]) for k in range(4)])
    return corners


@dataclass(frozen=True)
class _BentSide:
    """Points `start + t way + (c0 t^2 + c1 t + c2) outwards`, t from 0 to 1."""

    start: FloatArray
    way: FloatArray
    outwards: FloatArray
    bend: FloatArray

    def off(self, point: FloatArray) -> tuple[float, FloatArray]:
        """How far outside of it a point is, pixels, and how that grows with the point."""
        along = self.way / (self.way @ self.way)
        t = float((point - self.start) @ along)
        away = float((point - self.start) @ self.outwards - np.polyval(self.bend, t))
        return away, self.outwards - float(np.polyval(np.polyder(self.bend), t)) * along


def _bent_side(
    picture: NDArray[np.float32], corners: FloatArray, number: int, reach: float
) -> _BentSide | None:
    start, end = corners[number], corners[(number + 1) % 4]
    outwards = _outwards(start, end, corners.mean(axis=0))
    across = np.arange(-reach, reach + _STEP / 2, _STEP)[:, None] * outwards
    points = _edge_points(picture, _along(start, end), across, None)
    if len(points) < _POINTS // 2:
        return None
    way = end - start
    t, away = (points - start) @ way / (way @ way), (points - start) @ outwards
    on_it = np.ones(len(points), bool)
    for _ in range(3):
        bend = np.polyfit(t[on_it], away[on_it], 2)
        off = np.abs(away - np.polyval(bend, t))
        on_it = off < max(_OUTLIER * float(np.median(off)), _NOISE_PX)
    return _BentSide(start, way, outwards, bend)


def _meeting(first: _BentSide, second: _BentSide, near: FloatArray) -> FloatArray:
    """The point `(2,)` on both sides, near a point."""
    for _ in range(_MEETING_STEPS):
        (away, grows), (other_away, other_grows) = first.off(near), second.off(near)
        near = near - np.linalg.solve(np.array([grows, other_grows]), np.array([away, other_away]))
    return near


def _outwards(start: FloatArray, end: FloatArray, middle: FloatArray) -> FloatArray:
    """The unit vector `(2,)` across the side from `start` to `end` that leads away from `middle`."""
    along = end - start
    normal = np.array([along[1], -along[0]]) / np.linalg.norm(along)
    return np.asarray(-normal if normal @ (start - middle) < 0 else normal)


def _along(start: FloatArray, end: FloatArray) -> FloatArray:
    """Points of a side at which to look across it: `(48, 2)` pixels."""
    return start + np.linspace(_ENDS, 1 - _ENDS, _POINTS)[:, None] * (end - start)


def _edge_points(
    picture: NDArray[np.float32], places: FloatArray, across: FloatArray, color: FloatArray | None
) -> FloatArray:
    """Where the colour turns from inside to outside on the ways `across` `(K, 2)`, from inside, at `places` `(N, 2)`.

    `(M, 2)` pixels, M at most N. Without the inside's `color` it is taken from each way's own beginning, right in any
    shade.
    """
    at = (places[:, None] + across).astype(np.float32)
    seen = cv2.remap(picture, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    ends = max(3, len(across) // 4)
    outer = np.median(seen[:, -ends:], axis=1)
    inner = np.median(seen[:, :ends], axis=1) if color is None else np.broadcast_to(color, outer.shape)
    way = inner - outer
    contrast = np.linalg.norm(way, axis=1)
    # 1 inside, 0 outside, and linear in the share of a pixel that either covers.
    share = ((seen - outer[:, None]) * way[:, None]).sum(axis=2) / np.maximum(contrast, 1e-6)[:, None] ** 2
    below = share < 0.5
    last = below.argmax(axis=1)  # the first sample outside, counted from inside
    good = (contrast >= _LEAST_CONTRAST) & below.any(axis=1) & (last > 0)
    rows, last = np.flatnonzero(good), last[good]
    before, after = share[rows, last - 1], share[rows, last]
    fraction = ((before - 0.5) / (before - after))[:, None]
    return np.asarray(places[rows] + across[last - 1] + fraction * (across[last] - across[last - 1]), float)


def _line(points: FloatArray, tolerance: float) -> tuple[FloatArray, int] | None:
    """The line `(3,)`, a u + b v + c = 0, that most points lie on, and how many do; None for too few points."""
    if len(points) < 4:
        return None
    first, second = np.triu_indices(len(points), k=max(len(points) // 6, 1))
    along = points[second] - points[first]
    normals = np.column_stack([-along[:, 1], along[:, 0]])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    away = np.abs(points @ normals.T - (points[first] * normals).sum(axis=1))  # (points, pairs)
    best = int(np.minimum(away, tolerance).sum(axis=0).argmin())
    near = points[away[:, best] <= tolerance]
    if len(near) < 4:
        return None
    middle = near.mean(axis=0)
    _, _, axes = np.linalg.svd(near - middle)
    return np.array([*axes[1], -axes[1] @ middle]), len(near)


_MIN_AREA, _MAX_AREA = 8e-4, 0.25
"""Of the picture: a card 6 cm wide, 1 m from a camera that sees 1.8 m of table; one right under it."""
_MAX_ASPECT = 2.5
_MIN_FILL = 0.6
"""Of its rectangle of least area that a card's blob fills; a corner may be covered."""
_MIN_SIDE, _MIN_EDGES = 0.35, 0.7
"""Of the points of one side, and of all sides, that lie on straight edges: a bag's sides bulge, a disk has none."""
_MIN_EVEN = 0.85
"""Of the pixels inside that have the card's colour."""
_PARALLEL = 0.25
"""How much opposite sides may differ in length; perspective does little to something this small."""
_SQUARE_CORNER = 0.35
"""The cosine of a corner's angle, at most."""
_INNER = 0.7
"""The middle of the card whose colour is measured, in each direction: free of rims and soft shadows."""


@dataclass(frozen=True)
class CardDetection:
    """A card found in a picture; pixels are (u, v) with centres at integers."""

    corners: FloatArray
    """`(4, 2)`, sub-pixel, in turn around the card."""
    color: tuple[int, int, int]
    """RGB as seen in this light."""
    confidence: float
    """In [0, 1]: straight edges, an even colour, and the colour asked for."""


def find_card(image: Image, color: tuple[int, int, int] = CARD_COLOR) -> CardDetection | None:
    """The most card-like of all rectangles of a colour in a picture `(H, W, 3)`, or None.

    `color` is the card's RGB colour as printed, or as `measure_color` found it. Raises `BaggieError` when it is grey.
    """
    reference = reference_of(color, "card")
    small, factor = shrunk(image)
    chroma = chroma_of(small)
    picture_px = small.shape[0] * small.shape[1]
    alike = hue_likeness(chroma, reference) > FIRST_THRESHOLD
    found = [
        card
        for blob, area in blobs(alike, _MIN_AREA * picture_px)
        if area <= _MAX_AREA * picture_px and (card := _examine(image, chroma, blob, factor, reference))
    ]
    return max(found, key=lambda card: card.confidence, default=None)


def measure_color(images: Sequence[Image], corners: FloatArray) -> tuple[int, int, int]:
    """The RGB colour of a card with `corners` `(4, 2)` in pictures of one still camera: the median inside.

    Right as long as less than half of it is covered or glares. Raises `BaggieError` without a picture, or where the
    card's middle is not in one.
    """
    corners = np.asarray(corners, float)
    middle = corners.mean(axis=0) + _INNER * (corners - corners.mean(axis=0))
    seen = []
    for image in images:
        height, width = image.shape[:2]
        if not (
            np.isfinite(middle).all() and (middle >= 0).all() and (middle <= [width - 1, height - 1]).all()
        ):
            (u0, v0), (u1, v1) = middle.min(axis=0), middle.max(axis=0)
            raise BaggieError(
                f"expected a card inside the picture of {width} x {height} pixels, got its middle from ({u0:.0f}, "
                f"{v0:.0f}) to ({u1:.0f}, {v1:.0f}); lay it into the camera's view"
            )
        pixels = image[region_mask(middle, (width, height)) == 255]
        if len(pixels) == 0:
            raise BaggieError(
                "expected a card of several pixels, got one of less; give pictures of more pixels"
            )
        seen.append(np.median(pixels, axis=0))
    if not seen:
        raise BaggieError("expected at least one picture of the card, got none; take one")
    red, green, blue = (round(float(value)) for value in np.median(seen, axis=0))
    return red, green, blue


def _examine(
    image: Image, chroma: Chroma, first: Mask, factor: int, reference: Chroma
) -> CardDetection | None:
    """The card that a blob `first` of the small picture is, if it is one."""
    seen = np.median(chroma[inside(first)], axis=0)
    rows, columns = hue_window(first, factor, image.shape)
    part = image[rows, columns]
    alike = hue_likeness(chroma_of(part), seen)
    large = next(
        blobs(alike > half_way(chroma, first, seen), _MIN_AREA * image.shape[0] * image.shape[1]),
        None,
    )
    if large is None:
        return None
    blob, area = large
    rectangle = cv2.minAreaRect(outline(blob))
    _, (a, b), _ = rectangle
    if min(a, b) < 1 or max(a, b) > _MAX_ASPECT * min(a, b) or area < _MIN_FILL * a * b:
        return None
    sides = refine_sides(
        part, np.asarray(cv2.boxPoints(rectangle), float), np.median(part[inside(blob)], axis=0)
    )
    if sides is None or not _is_rectangle(sides.corners):
        return None
    edges = sides.straight
    even = _evenness(alike, sides.corners)
    if min(edges) < _MIN_SIDE or np.mean(edges) < _MIN_EDGES or even < _MIN_EVEN:
        return None
    match = max(0.0, 1.0 - float(np.linalg.norm(seen - reference) / np.linalg.norm(reference)))
    corners = sides.corners + np.array([columns.start, rows.start])
    return CardDetection(corners, measure_color([image], corners), float(np.mean(edges)) * even * match)


def _is_rectangle(corners: FloatArray) -> bool:
    """Whether a quadrilateral `(4, 2)` may be a rectangle seen by a camera above it."""
    ways = np.roll(corners, -1, axis=0) - corners
    lengths = np.linalg.norm(ways, axis=1)
    if lengths.min() < 1 or lengths.max() > _MAX_ASPECT * lengths.min():
        return False
    turns = (ways * np.roll(ways, -1, axis=0)).sum(axis=1) / (lengths * np.roll(lengths, -1))
    uneven = np.abs(np.log(lengths[:2] / lengths[2:]))
    return bool(np.abs(turns).max() <= _SQUARE_CORNER and uneven.max() <= _PARALLEL)


def _evenness(alike: NDArray[np.float32], corners: FloatArray) -> float:
    """The share of the pixels inside that have the colour of most of them."""
    within = alike[region_mask(corners, (alike.shape[1], alike.shape[0])) == 255]
    return float(np.mean(np.abs(within - 1.0) < FIRST_THRESHOLD)) if len(within) else 0.0
