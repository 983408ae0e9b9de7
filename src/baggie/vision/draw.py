"""Draws goals into pictures."""

from __future__ import annotations

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
