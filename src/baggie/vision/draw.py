"""Draws goals, and patterns of stacked bags, into pictures."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from baggie.errors import BaggieError
from baggie.geometry import FloatArray
from baggie.types import Goal, Image

Mask = NDArray[np.uint8]

_SHIFT = 4
"""Fractional bits of OpenCV's fixed-point coordinates."""

_FINER = 8
"""Shapes are drawn this many times enlarged."""

_BESIDE_CARD_PX = 3
"""A card's rim, its shadow, and by how much its corners are raised."""
_INPAINT_PX = 3.0

_PICTURE_TO_LINE = 160
"""An outline is 1/160 of the picture's width thick: 4 pixels at 640, 8 at 1280."""
_PICTURE_TO_NUMBER, _NUMBER_PX = 1280, 16
"""The width of a picture in which a number is so many pixels high."""


def check_goal(goal: Goal, size: tuple[int, int]) -> None:
    """Raise `BaggieError` unless the whole goal lies in a picture of `(width, height)` pixels."""
    width, height = size
    corners = goal.corners
    inside = (corners >= -0.5) & (corners <= [width - 0.5, height - 0.5])
    if not inside.all():
        (u0, v0), (u1, v1) = corners.min(axis=0), corners.max(axis=0)
        raise BaggieError(
            f"the goal must lie in the picture ({width} x {height} pixels), but reaches from "
            f"({u0:.0f}, {v0:.0f}) to ({u1:.0f}, {v1:.0f}): choose one inside"
        )


def paint_goal(image: Image, goal: Goal) -> Image:
    """A copy of the picture `(H, W, 3)` with the goal drawn in it, anti-aliased, as an outline or a solid
    patch; a card lies there already.

    Raises `BaggieError` when the goal is not wholly inside the picture.
    """
    height, width = image.shape[:2]
    check_goal(goal, (width, height))
    if goal.style == "card":
        return image.copy()
    if goal.style == "solid":
        mask = region_mask(goal.corners, (width, height))
    else:
        thickness = max(1.0, width / _PICTURE_TO_LINE)
        mask = _coverage(goal.corners, (width, height), thickness)
    painted = image.copy()
    touched = mask > 0
    share = mask[touched][:, None] / np.float32(255)
    blended = painted[touched] * (1 - share) + np.array(goal.color, np.float32) * share
    painted[touched] = blended.round().astype(np.uint8)
    return painted


def without_card(image: Image, corners: FloatArray) -> Image:
    """A copy of the picture `(H, W, 3)` with the table carried on where a card with these corners `(N, 2)` (u, v) lies.

    The surroundings are continued inwards (Telea, 2004), from three pixels outside of the corners.
    """
    height, width = image.shape[:2]
    there = (region_mask(corners, (width, height)) > 0).astype(np.uint8)
    reach = 2 * _BESIDE_CARD_PX + 1
    mask = cv2.dilate(there, np.ones((reach, reach), np.uint8))
    return np.asarray(cv2.inpaint(image, mask, _INPAINT_PX, cv2.INPAINT_TELEA), np.uint8)


def region_mask(corners: FloatArray, size: tuple[int, int]) -> Mask:
    """How much of each pixel a polygon `(N, 2)` (u, v) covers: `(height, width)` uint8, 255 for all of it.

    Parts outside the picture are cut off.
    """
    return _coverage(corners, size, None)


def _coverage(corners: FloatArray, size: tuple[int, int], line: float | None) -> Mask:
    """A polygon, or its outline of `line` pixels, drawn enlarged and averaged.

    OpenCV's own anti-aliasing rounds filled shapes to whole rows, up to half a pixel off.
    """
    margin = 2 + (line or 0.0)
    low = np.clip(np.floor(corners.min(axis=0) - margin), 0, size).astype(int)
    high = np.clip(np.ceil(corners.max(axis=0) + margin) + 1, 0, size).astype(int)
    mask = np.zeros((size[1], size[0]), np.uint8)
    width, height = (int(side) for side in high - low)
    if width == 0 or height == 0:
        return mask
    canvas = np.zeros((height * _FINER, width * _FINER), np.uint8)
    enlarged = (np.asarray(corners, float) - low + 0.5) * _FINER - 0.5
    fixed = np.round(enlarged * (1 << _SHIFT)).astype(np.int32)
    if line is None:
        cv2.fillPoly(canvas, [fixed], 255, cv2.LINE_8, _SHIFT)
    else:
        cv2.polylines(canvas, [fixed], True, 255, round(line * _FINER), cv2.LINE_8, _SHIFT)
    averaged = cv2.resize(canvas, (width, height), interpolation=cv2.INTER_AREA)
    mask[low[1] : high[1], low[0] : high[0]] = averaged
    return mask


_LOWEST_LAYER, _HIGHEST_LAYER = np.array([110, 20, 150]), np.array([255, 220, 60])
"""RGB, between which the layers of a pattern are shaded: purple below, yellow on top."""
_LAYER_COVERS = 0.35
"""How much of the picture a layer hides."""


def paint_layers(image: Image, outlines: FloatArray, layers: Sequence[int]) -> Image:
    """A copy of the picture `(H, W, 3)` with outlines `(N, 4, 2)` (u, v) drawn in it, numbered in their order from 1.

    `layers`: of each, from 0 on, by which they are shaded. Parts outside the picture are cut off.
    """
    height, width = image.shape[:2]
    painted, thickness = image.astype(np.float32), max(1.0, width / _PICTURE_TO_LINE)
    shades = [
        (_LOWEST_LAYER + (_HIGHEST_LAYER - _LOWEST_LAYER) * layer / max(*layers, 1)).astype(np.float32)
        for layer in layers
    ]
    for corners, shade in zip(outlines, shades, strict=True):
        filled = _LAYER_COVERS * region_mask(corners, (width, height))
        cover = np.maximum(filled, _coverage(corners, (width, height), thickness))[..., None] / 255
        painted = painted * (1 - cover) + shade * cover
    numbered = painted.round().astype(np.uint8)
    scale, middles = width / _PICTURE_TO_NUMBER, np.mean(outlines, axis=1)
    for number, middle in enumerate(middles, start=1):
        # Of what stands straight on others the number is above theirs.
        below = np.linalg.norm(middles[: number - 1] - middle, axis=1) < _NUMBER_PX * scale
        u, v = middle + np.array([-0.5, 0.5 - 1.5 * below.sum()]) * _NUMBER_PX * scale
        for color, weight in (((0, 0, 0), 4), ((255, 255, 255), 2)):
            cv2.putText(
                numbered,
                str(number),
                (round(u), round(v)),
                cv2.FONT_HERSHEY_SIMPLEX,
                0.8 * scale,
                color,
                max(1, round(weight * scale)),
                cv2.LINE_AA,
            )
    return numbered
