"""Find one evenly coloured object in a picture by its colour, as the published system does.

One pass with the colour as given finds the object (as `hue_likeness` says); a second, with the colour it has in
*this* light, draws its outline half way to its surroundings.

A pixel's colour is reduced to the two numbers that do not change with exposure, hue and saturation, as the
plane vector `s = saturation * exp(i hue)`. Its likeness to a reference is the part of `s` along the
reference's own vector less the part across it: 1 on the object, about 0 on anything grey.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from baggie.errors import BaggieError
from baggie.geometry import FloatArray, wrap_angle
from baggie.types import Image

Mask = NDArray[np.bool_]
Chroma = NDArray[np.float32]
"""`(..., 2)`: saturation times the cosine and the sine of the hue."""

FIRST_THRESHOLD = 0.5
"""The likeness to the colour as given from which a pixel may be the object, in any light."""
_ACROSS_WEIGHT = 1.5
"""How much a difference in hue counts against a pixel; 1.5 rejects wood (25 degrees) when looking for red."""
_DARK = 24.0
"""Pixels whose brightest channel is below this have no reliable hue (of 255)."""
_GREY = 0.2
_SEARCH_WIDTH = 320

# (R, G, B) -> saturation * brightness * (cos hue, sin hue)
_CHROMA = np.array([[1.0, -0.5, -0.5], [0.0, 3**0.5 / 2, -(3**0.5) / 2]], np.float32)


def reference_of(color: tuple[int, int, int], what: str) -> Chroma:
    """The chroma `(2,)` of the RGB colour of `what` is looked for.

    Raises `BaggieError` when it is grey, so that no hue tells it from the table.
    """
    reference = np.asarray(chroma_of(np.array([[color]], np.uint8))[0, 0], np.float32)
    if np.linalg.norm(reference) < _GREY:
        raise BaggieError(
            f"expected a colour of the {what} with a clear hue, got the grey RGB {color}; choose another {what}"
        )
    return reference


def shrunk(image: Image) -> tuple[Image, int]:
    """The picture about 320 pixels wide, in which things are looked for, and how many times smaller it is."""
    factor = max(1, round(image.shape[1] / _SEARCH_WIDTH))
    small = cv2.resize(image, None, fx=1 / factor, fy=1 / factor, interpolation=cv2.INTER_AREA)
    return np.asarray(small, np.uint8), factor


def chroma_of(image: Image) -> Chroma:
    """Saturation vector of each pixel: `(H, W, 3)` -> `(H, W, 2)`; zero where it is too dark to tell."""
    pixels = image.astype(np.float32)
    brightness = pixels.max(axis=2, keepdims=True)
    vectors = cv2.transform(pixels, _CHROMA) / np.maximum(brightness, 1.0)
    return np.asarray(vectors * (brightness >= _DARK), np.float32)


def hue_likeness(chroma: Chroma, reference: Chroma) -> NDArray[np.float32]:
    """1 where the colour is the reference, 0 where it is grey, negative for other hues: `(H, W)`."""
    along_axis = reference / np.dot(reference, reference)
    across_axis = np.array([-along_axis[1], along_axis[0]], np.float32)
    return np.asarray(chroma @ along_axis - _ACROSS_WEIGHT * np.abs(chroma @ across_axis), np.float32)


def inside(blob: Mask) -> Mask:
    """A blob without its rim, where colours mix; the whole of it where nothing else is left."""
    inner = cv2.erode(blob.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)
    return inner if inner.any() else blob


def half_way(chroma: Chroma, blob: Mask, seen: Chroma) -> float:
    """The likeness to `seen` half way between a blob of that colour and what surrounds it."""
    around = ~cv2.dilate(blob.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)
    rows, columns = hue_window(blob, 1, blob.shape)
    outside = around[rows, columns]
    level = float(np.median(hue_likeness(chroma[rows, columns], seen)[outside])) if outside.any() else 0.0
    return float(np.clip((1.0 + level) / 2, 0.4, 0.75))


def hue_window(blob: Mask, factor: int, shape: tuple[int, ...]) -> tuple[slice, slice]:
    """Rows and columns around a blob, in a picture of `shape` that is `factor` times larger."""
    u, v, width, height = cv2.boundingRect(blob.astype(np.uint8))
    pad = max(width, height) // 3 + 2
    rows = slice(max(v - pad, 0) * factor, min((v + height + pad) * factor, shape[0]))
    return rows, slice(max(u - pad, 0) * factor, min((u + width + pad) * factor, shape[1]))


def blobs(mask: Mask, least_px: float) -> Iterator[tuple[Mask, float]]:
    """The connected parts of a mask, cleaned, of at least `least_px`, the largest first, and their areas."""
    cross = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (3, 3))
    disk = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5))
    clean = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, cross)
    clean = cv2.morphologyEx(clean, cv2.MORPH_CLOSE, disk)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(clean)
    for label in 1 + np.argsort(stats[1:count, cv2.CC_STAT_AREA])[::-1]:
        area = float(stats[label, cv2.CC_STAT_AREA])
        if area < least_px:
            return
        yield np.asarray(labels == label), area


def outline(blob: Mask) -> NDArray[np.int32]:
    """The outer contour with the most points: `(N, 1, 2)` pixels."""
    contours, _ = cv2.findContours(blob.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return np.asarray(max(contours, key=len), np.int32)


_MIN_AREA = 4e-4
_MAX_AREA = 0.25
"""Of the picture: a marker 4 cm across, 1 m from a camera that sees 1.8 m of table; a bag right under it."""
_MIN_FILL = 0.6
_MAX_ASPECT = 2.5


@dataclass(frozen=True)
class Detection:
    """An object found in a picture; pixels are (u, v) with centres at integers."""

    center: FloatArray
    """`(2,)`, centroid of the mask, sub-pixel."""
    yaw: float
    """Angle of an edge from the u axis towards v, radians, modulo a quarter turn: in [-pi/4, pi/4)."""
    corners: FloatArray
    """`(4, 2)`, of the rectangle of least area around the mask."""
    area_px: float
    confidence: float
    """In [0, 1]: how well the blob fills its rectangle and keeps to one colour; halved at the picture's
    edge."""
    mask: Mask
    """`(H, W)`, True on the object."""


def find_bag(image: Image, color: tuple[int, int, int]) -> Detection | None:
    """The largest plausible blob of a colour, or None.

    `color` is the object's RGB colour in ordinary light. Raises `BaggieError` when it is grey, so that no hue
    tells the object from the table.
    """
    return next(iter(find_bags(image, color)), None)


def find_bags(image: Image, color: tuple[int, int, int]) -> Iterator[Detection | None]:
    """Every plausible blob of a colour, the largest first; None for one that is none seen closely.

    Raises `BaggieError` as `find_bag` does.
    """
    reference = reference_of(color, "object")
    small, factor = shrunk(image)
    chroma = chroma_of(small)
    alike = hue_likeness(chroma, reference) > FIRST_THRESHOLD
    for first in _plausible(alike, small.shape[0] * small.shape[1]):
        yield _seen_closely(image, chroma, first, factor)


def _seen_closely(image: Image, chroma: Chroma, first: Mask, factor: int) -> Detection | None:
    """What is a blob of a picture's `chroma`, which is `factor` times smaller than the picture."""
    seen = np.median(chroma[inside(first)], axis=0)
    window = hue_window(first, factor, image.shape)
    likeness = hue_likeness(chroma_of(image[window]), seen)
    alike = likeness > half_way(chroma, first, seen)
    blob = next(_plausible(alike, image.shape[0] * image.shape[1]), None)
    if blob is None:
        return None
    match = float(np.clip(likeness[blob].mean(), 0.0, 1.0))
    mask = np.zeros(image.shape[:2], bool)
    mask[window] = blob
    return _describe(mask, match)


def _plausible(mask: Mask, picture_px: int) -> Iterator[Mask]:
    """The connected parts that could be bags, the largest first, by shape and size in a picture of `picture_px`."""
    for blob, area in blobs(mask, _MIN_AREA * picture_px):
        _, (a, b), _ = cv2.minAreaRect(outline(blob))
        square_enough = max(a, b) <= _MAX_ASPECT * max(min(a, b), 1.0)
        if area <= _MAX_AREA * picture_px and square_enough and area >= _MIN_FILL * a * b:
            yield blob


def _describe(blob: Mask, match: float) -> Detection:
    moments = cv2.moments(blob.astype(np.uint8), binaryImage=True)
    area = moments["m00"]
    center = np.array([moments["m10"] / area, moments["m01"] / area])
    rectangle = cv2.minAreaRect(outline(blob))
    _, (a, b), degrees = rectangle
    fill = min(1.0, area / max((a + 1) * (b + 1), 1.0))
    cut = blob[0].any() or blob[-1].any() or blob[:, 0].any() or blob[:, -1].any()
    return Detection(
        center=center,
        yaw=wrap_angle(np.deg2rad(degrees), np.pi / 2),
        corners=np.asarray(cv2.boxPoints(rectangle), float),
        area_px=float(area),
        confidence=fill * match * (0.5 if cut else 1.0),
        mask=blob,
    )
