"""Find the goal card, an evenly coloured rectangle that lies on the table, to a small part of a pixel.

Its colour says where it may be (`hue.py`), its four straight edges where it is (`edges.py`). Something that covers less
than half of a side spoils nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from baggie.errors import BaggieError
from baggie.geometry import FloatArray
from baggie.types import Image
from baggie.vision import hue
from baggie.vision.draw import region_mask
from baggie.vision.edges import refine_sides

CARD_COLOR = (26, 140, 51)
"""RGB of the cards that `baggie print-target goal-card` makes."""

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
    reference = hue.reference_of(color, "card")
    small, factor = hue.shrunk(image)
    chroma = hue.chroma_of(small)
    picture_px = small.shape[0] * small.shape[1]
    alike = hue.likeness(chroma, reference) > hue.FIRST_THRESHOLD
    found = [
        card
        for blob, area in hue.blobs(alike, _MIN_AREA * picture_px)
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
    image: Image, chroma: hue.Chroma, first: hue.Mask, factor: int, reference: hue.Chroma
) -> CardDetection | None:
    """The card that a blob `first` of the small picture is, if it is one."""
    seen = np.median(chroma[hue.inside(first)], axis=0)
    rows, columns = hue.window(first, factor, image.shape)
    part = image[rows, columns]
    alike = hue.likeness(hue.chroma_of(part), seen)
    large = next(
        hue.blobs(alike > hue.half_way(chroma, first, seen), _MIN_AREA * image.shape[0] * image.shape[1]),
        None,
    )
    if large is None:
        return None
    blob, area = large
    rectangle = cv2.minAreaRect(hue.outline(blob))
    _, (a, b), _ = rectangle
    if min(a, b) < 1 or max(a, b) > _MAX_ASPECT * min(a, b) or area < _MIN_FILL * a * b:
        return None
    sides = refine_sides(
        part, np.asarray(cv2.boxPoints(rectangle), float), np.median(part[hue.inside(blob)], axis=0)
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
    return float(np.mean(np.abs(within - 1.0) < hue.FIRST_THRESHOLD)) if len(within) else 0.0
