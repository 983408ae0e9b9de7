"""How like a colour the pixels of a picture are, whatever the exposure, and the blobs they form.

A pixel's colour is reduced to the two numbers that do not change with exposure, hue and saturation, as the
plane vector `s = saturation * exp(i hue)`. Its likeness to a reference is the part of `s` along the
reference's own vector less the part across it: 1 on the object, about 0 on anything grey.
"""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from baggie.errors import BaggieError
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


def likeness(chroma: Chroma, reference: Chroma) -> NDArray[np.float32]:
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
    rows, columns = window(blob, 1, blob.shape)
    outside = around[rows, columns]
    level = float(np.median(likeness(chroma[rows, columns], seen)[outside])) if outside.any() else 0.0
    return float(np.clip((1.0 + level) / 2, 0.4, 0.75))


def window(blob: Mask, factor: int, shape: tuple[int, ...]) -> tuple[slice, slice]:
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
