"""Random changes to what things look like: cloth, table, and clutter that has nothing to do with the task.

The object keeps its shape and its shading, so a policy has to learn what a bag is, and not that bags are red.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from baggie.geometry import FloatArray
from baggie.types import Image
from baggie.vision.color_mask import find_bag

Mask = NDArray[np.float32]
"""`(H, W)`: 1 on the object, 0 beside it, between along its edge."""

_BRIGHTEST = 1.4
"""Times the mean: the table beside a dark cloth is no highlight on it."""
_PIXEL = np.ones((3, 3), np.uint8)
"""Makes a mask a pixel wider all around, or narrower."""
_CLUTTER = 4
"""Things at most."""
_PRINTED = 0.3
"""The share of them that have something else on them: a magazine's picture, a cup's contents."""


def object_mask(picture: Image, box: FloatArray) -> Mask:
    """Where the object in a box `(4, 2)` pixels is: by the colour it has there, or the box itself where that fails."""
    height, width = picture.shape[:2]
    inside = np.zeros((height, width), np.uint8)
    middle = box.mean(axis=0)
    cv2.fillPoly(inside, [np.round(middle + 0.6 * (box - middle)).astype(np.int32)], 1)
    red, green, blue = (int(value) for value in np.median(picture[inside > 0], axis=0))
    found = None
    if max(red, green, blue) - min(red, green, blue) > 0.25 * max(red, green, blue):
        found = find_bag(picture, (red, green, blue))
    if found is not None and np.linalg.norm(found.center - middle) < 0.1 * np.ptp(box, axis=0).max():
        # A pixel wider: its rim has mixed colours, by which a network would know it again.
        wider = cv2.dilate(found.mask.astype(np.uint8), _PIXEL).astype(np.float32)
        return np.asarray(cv2.GaussianBlur(wider, (3, 3), 0.6), np.float32)
    whole = np.zeros((height, width), np.uint8)
    cv2.fillPoly(whole, [np.round(box).astype(np.int32)], 1)
    return whole.astype(np.float32)


def random_look(rng: np.random.Generator, picture: Image, table: Image, mask: Mask) -> Image:
    """The same scene `(H, W, 3)` with another cloth, half of the time another table, and clutter beside the object.

    `table` is the scene `without_object`.
    """
    there = table.astype(np.float32)
    if rng.random() < 0.5:
        there = _other_table(rng, there)
    there = _cluttered(rng, there)
    # The mask is a pixel wider than the object; its light rim would tell an object on a table made dark.
    share = cv2.erode(mask, _PIXEL)[..., None]
    return np.asarray(np.clip(share * _cloth(rng, picture, mask) + (1 - share) * there, 0, 255), np.uint8)


def without_object(picture: Image, mask: Mask) -> Image:
    """The scene `(H, W, 3)` with the table, as its surroundings suggest it, where the object was."""
    hidden = cv2.dilate((mask > 0.02).astype(np.uint8), np.ones((5, 5), np.uint8))
    return np.asarray(cv2.inpaint(picture, hidden, 4, cv2.INPAINT_TELEA), np.uint8)


def _cloth(rng: np.random.Generator, picture: Image, mask: Mask) -> NDArray[np.float32]:
    """Another colour, with the shading of the one there, and sometimes a pattern."""
    gray = picture.astype(np.float32) @ np.array([0.3, 0.59, 0.11], np.float32)
    # Along the edge some of the table is mixed in; an object's edge is darker than its middle.
    gray = np.asarray(cv2.erode(gray, _PIXEL), np.float32)
    mean = float((gray * mask).sum()) / max(float(mask.sum()), 1.0)
    shading = np.minimum(gray / max(mean, 1.0), np.float32(_BRIGHTEST))
    return np.asarray(shading[..., None] * _dyed(rng, mask.shape))


def _dyed(rng: np.random.Generator, shape: tuple[int, ...]) -> NDArray[np.float32]:
    """One colour, or half of the time a pattern of two: `(H, W, 3)` or `(3,)`."""
    color = _color(rng)
    if rng.random() < 0.5:
        return color
    share = _pattern(rng, shape)[..., None]
    other = _color(rng) if rng.random() < 0.5 else color * np.float32(rng.uniform(0.5, 0.9))
    return np.asarray(share * color + (1 - share) * other)


def _color(rng: np.random.Generator) -> NDArray[np.float32]:
    """Any colour but nearly black, bright and dull ones alike: `(3,)`."""
    hue, saturation, value = rng.uniform(0, 180), rng.uniform(20, 255), rng.uniform(50, 245)
    hsv = np.array([[[hue, saturation, value]]], np.uint8)
    return np.asarray(cv2.cvtColor(hsv, cv2.COLOR_HSV2RGB)[0, 0], np.float32)


def _pattern(rng: np.random.Generator, shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Stripes or checks across the whole picture, `(H, W)`, 0 to 1."""
    v, u = np.mgrid[: shape[0], : shape[1]].astype(np.float32)
    angle, period = rng.uniform(0, np.pi), rng.uniform(3, 10)
    across = np.cos(angle) * u + np.sin(angle) * v
    along = np.cos(angle) * v - np.sin(angle) * u
    wave = np.sin(2 * np.pi * across / period)
    if rng.random() < 0.5:
        wave = wave * np.sin(2 * np.pi * along / period)
    return np.asarray(np.clip(0.5 + wave, 0, 1), np.float32)


def _other_table(rng: np.random.Generator, seen: NDArray[np.float32]) -> NDArray[np.float32]:
    """Of another colour, under other lamps, with more or less of its grain."""
    smooth = cv2.GaussianBlur(seen, (0, 0), 4.0)
    grain = seen - smooth
    return np.asarray((smooth + rng.uniform(0.5, 3.0) * grain) * _tint(rng, seen.shape[:2]), np.float32)


def _tint(rng: np.random.Generator, shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Gains of another table under other lamps: a colour, and a slope of brightness across, `(H, W, 3)`."""
    color = np.exp(rng.uniform(-1.0, 0.4) + rng.normal(0, 0.15, 3)).astype(np.float32)
    v, u = np.mgrid[-1 : 1 : shape[0] * 1j, -1 : 1 : shape[1] * 1j].astype(np.float32)
    slope = np.exp(rng.normal(0, 0.12) * u + rng.normal(0, 0.12) * v)
    return np.asarray(slope[..., None] * color, np.float32)


def _cluttered(rng: np.random.Generator, table: NDArray[np.float32]) -> NDArray[np.float32]:
    """Up to four polygons and ellipses, with a hint of a shadow, some with something else drawn on them."""
    height, width = table.shape[:2]
    table = table.copy()
    for _ in range(int(rng.integers(0, _CLUTTER + 1))):
        middle = rng.uniform([0, 0], [width, height])
        radius = rng.uniform(0.03, 0.14) * width
        corners = int(rng.choice([3, 4, 4, 5, 24]))
        angles = rng.uniform(0, 2 * np.pi) + np.linspace(0, 2 * np.pi, corners, endpoint=False)
        stretch = radius * rng.uniform(0.4, 1.0, 2)
        outline = middle + stretch * np.column_stack([np.cos(angles), np.sin(angles)])
        _paint(rng, table, outline + rng.uniform(-0.15, 0.15, 2) * radius, shadow=True)
        _paint(rng, table, outline)
        if rng.random() < _PRINTED:
            _paint(rng, table, middle + rng.uniform(0.4, 0.8) * (outline - middle))
    return table


def _paint(
    rng: np.random.Generator, table: NDArray[np.float32], outline: FloatArray, *, shadow: bool = False
) -> None:
    """Fill an outline `(N, 2)` pixels in the picture itself: with a colour or a pattern, or what is there darkened."""
    low = np.maximum(np.floor(outline.min(axis=0)).astype(int) - 1, 0)
    left, top = (int(value) for value in low)
    right, bottom = (int(value) for value in np.ceil(outline.max(axis=0)) + 2)
    there = table[top:bottom, left:right]  # a view: painting all of the picture takes ten times as long
    if there.size == 0:
        return
    shape = np.zeros(there.shape[:2], np.uint8)
    cv2.fillPoly(shape, [np.round(16 * (outline - low)).astype(np.int32)], 255, cv2.LINE_AA, 4)
    share = (shape / np.float32(255))[..., None]
    new = 0.75 * there if shadow else _dyed(rng, there.shape[:2])
    there[:] = share * new + (1 - share) * there
