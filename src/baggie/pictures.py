"""Pictures and outlines as people have them, made into what everything here works with."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baggie.errors import BaggieError
from baggie.geometry import FloatArray

LONGEST_RECORDED = 640
"""Pixels of the longer side of recorded pictures, at most."""
_BRIGHTEST = 255
_SENSOR_BITS = (10, 12, 14, 16)
"""Of sensors whose pictures come in uint16."""
_LEAST_PX = 1.0
"""A goal has at least this area, square pixels: corners in shares of the picture make one of less."""
_ROUNDED = 0.5 / 255
"""So far a number may be outside of 0 to 1 and still mean the darkest or the brightest there is."""


def recorded_size(camera_size: tuple[int, int]) -> tuple[int, int]:
    """The size `(width, height)` that pictures of a camera are recorded at: its own shape, at most 640 pixels long."""
    longest = max(camera_size)
    if longest <= LONGEST_RECORDED:
        return camera_size
    width, height = (round(side * LONGEST_RECORDED / longest) for side in camera_size)
    return width, height


def same_shape(size: tuple[int, int], other: tuple[int, int]) -> bool:
    """Whether pictures of one size `(width, height)` are those of the other resized, to whole pixels."""
    (width, height), (other_width, other_height) = size, other
    return abs(width * other_height - height * other_width) <= max(*size, *other) / 2


def as_picture(picture: Any) -> NDArray[np.uint8]:
    """A picture as `(H, W, 3)` uint8 RGB; one that is so already is returned as it is.

    Taken are arrays, tensors, lists and Pillow's pictures: grey, RGB or RGBA, whose transparency is left out; whole
    numbers of 8 bits or, in uint16 with any above 255, of as many of 10, 12, 14 or 16 as the brightest needs, as
    industrial cameras fill 16 bits; fractions from 0 to 1; `(3, H, W)`, as PyTorch orders them. Raises `BaggieError`
    for anything else.
    """
    array = _opaque(_array(picture))
    if array.ndim != 3 or array.shape[2] != 3 or 0 in array.shape:
        raise BaggieError(
            "expected a picture of shape (H, W, 3), RGB, or one in grey or with transparency, got "
            f"{_described(picture)}; give a single picture, its rows first"
        )
    return np.ascontiguousarray(array if array.dtype == np.uint8 else _in_8_bits(array))


def as_metres(values: Any, name: str) -> NDArray[np.float32]:
    """Depths or heights as float32, metres; `name` says which.

    Raises `BaggieError` for whole numbers: those are a camera's own units, millimetres most often.
    """
    array = _array(values)
    if array.dtype.kind != "f":
        raise BaggieError(
            f"expected the {name} in metres, as fractions, got {array.dtype}; divide millimetres by 1000"
        )
    return array.astype(np.float32, copy=False)


def as_outline(corners: Any) -> FloatArray:
    """A goal's corners as `(N, 2)` pixels (u, v), in order around it.

    Taken are arrays and lists, OpenCV's `(N, 1, 2)` too, with the first corner repeated at the end or not. Corners out
    of order, in a zigzag perhaps, are put in order where there is only one. Raises `BaggieError` for what encloses
    nothing, crosses itself, or is no number.
    """
    try:
        points = np.array(corners, float)
    except (TypeError, ValueError):
        points = np.empty(0)
    if points.ndim == 3 and 1 in points.shape[:2]:
        points = points.reshape(-1, points.shape[2])
    if points.ndim != 2 or points.shape[1] != 2:
        raise BaggieError(
            f"expected a goal's corners as pixels (u, v), an array of shape (N, 2), got {_described(corners)}"
        )
    if not np.isfinite(points).all():
        raise BaggieError(f"expected a goal's corners to be finite pixels (u, v), got {points.tolist()}")
    points = points[(points != np.roll(points, 1, axis=0)).any(axis=1)]
    if len(points) >= 3 and _crosses_itself(points):
        points = _around(points)
    if len(points) < 3 or abs(_area(points)) < _LEAST_PX:
        raise BaggieError(
            "expected a goal with at least three corners (u, v) and an area of a pixel or more, got "
            f"{np.asarray(corners).tolist()}; give its corners in pixels of the picture"
        )
    return points


def _array(picture: Any) -> NDArray[Any]:
    pillow = sys.modules.get("PIL.Image")  # nobody has one of its pictures without it
    try:
        if pillow is None or not isinstance(picture, pillow.Image) or picture.mode == "F":
            return np.asarray(picture)
        if picture.mode.startswith("I"):  # 16 bits of grey, which `convert` would clip
            return np.asarray(picture).astype(np.uint16)
        return np.asarray(picture.convert("RGB"))
    except (TypeError, ValueError, RuntimeError) as error:  # RuntimeError: a tensor that wants a gradient
        reason = " ".join(str(error).split())
        raise BaggieError(
            f"expected a picture as an array of shape (H, W, 3), got {_described(picture)}: {reason}"
        ) from None


def _opaque(array: NDArray[Any]) -> NDArray[Any]:
    """Grey, transparent and channels-first pictures as `(H, W, 3)`; anything else as it is."""
    if array.ndim == 3 and array.shape[2] not in {1, 3, 4} and array.shape[0] in {1, 3, 4}:
        array = array.transpose(1, 2, 0)
    if array.ndim == 2:
        array = array[:, :, None]
    if array.ndim == 3 and array.shape[2] == 1:
        return np.repeat(array, 3, axis=2)
    return array[:, :, :3] if array.ndim == 3 and array.shape[2] == 4 else array


def _in_8_bits(array: NDArray[Any]) -> NDArray[np.uint8]:
    """The same picture in uint8."""
    kind = array.dtype.kind
    if (
        kind == "u" and array.dtype.itemsize == 2 and array.max() > _BRIGHTEST
    ):  # or there is nothing to see in it
        bits = next(bits for bits in _SENSOR_BITS if array.max() < 1 << bits)
        return (array >> (bits - 8)).astype(np.uint8)
    if kind not in "buif":
        raise BaggieError(f"expected a picture of numbers, got an array of {array.dtype}")
    brightest, spare = (1, _ROUNDED) if kind in "bf" else (_BRIGHTEST, 0.0)
    low, high = array.min(), array.max()
    if not (-spare <= low and high <= brightest + spare):  # NaN is neither
        raise BaggieError(
            f"expected a picture of uint8, or of fractions from 0 to 1, got {array.dtype} from {low:g} to {high:g}; "
            "say what is black and what is white: scale it to one of the two"
        )
    return np.asarray(np.round(array * (255 / brightest)).clip(0, 255), np.uint8)


def _crosses_itself(points: FloatArray) -> bool:
    """Whether two edges of a polygon `(N, 2)` cross."""
    along = np.roll(points, -1, axis=0) - points
    between = points[None] - points[:, None]
    side = np.sign(along[:, None, 0] * between[..., 1] - along[:, None, 1] * between[..., 0])
    # Whether the line along edge i has the ends of edge j on both sides.
    parted = side * np.roll(side, -1, axis=1) < 0
    return bool((parted & parted.T).any())


def _around(points: FloatArray) -> FloatArray:
    """The corners `(N, 2)` of a convex polygon in order around it, from the first on."""
    u, v = (points - points.mean(axis=0)).T
    order = np.argsort(np.arctan2(v, u))
    points = points[np.roll(order, -int(np.argmax(order == 0)))]
    (ax, ay), (bx, by) = (
        (np.roll(points, -step - 1, axis=0) - np.roll(points, -step, axis=0)).T for step in (0, 1)
    )
    if not (ax * by - ay * bx > 0).all():
        raise BaggieError(
            f"expected a goal whose outline does not cross itself, got {points.tolist()}; give its corners in order"
        )
    return points


def _area(points: FloatArray) -> float:
    """Of a polygon `(N, 2)`, by the shoelace formula; its sign says which way it turns."""
    u, v = (points - points[0]).T
    return float(u @ np.roll(v, -1) - v @ np.roll(u, -1)) / 2


def _described(value: Any) -> str:
    """A value's kind, in a few words."""
    shape = getattr(value, "shape", None)
    kind = type(value).__name__
    return f"{kind} of shape {tuple(shape)}" if isinstance(shape, tuple) else f"{kind} {str(value)[:60]}"
