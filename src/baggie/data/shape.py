"""Random changes to the shape of what is to be picked: turned, larger, longer or round, with its middle kept in place.

Objects that were always put down square to the table would teach a network to look at the table's grain, and objects of
one shape that everything else is none.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np

from baggie.data.appearance import Mask
from baggie.geometry import FloatArray
from baggie.types import Image

SQUARE, LONG, ROUND = 4, 2, 0
"""How often a turn they look the same; a round one at any angle."""
_TURNED = 0.5
"""The share of objects that are turned."""
_LARGER, _LONGER = 1.25, 1.8
"""Times, at most."""


@dataclass(frozen=True)
class Shape:
    """What has become of an object in a picture."""

    yaw: float
    """On the table, radians: of its long sides, where it has any."""
    symmetry: int
    """How often a turn it looks the same: 4 a square, 2 where it is clearly longer than wide, 0 at any angle."""
    linear: FloatArray
    """`(2, 2)`: offsets from its middle in pixels, as they were -> as they are."""
    round_from: float | None = None
    """Where it was a square and is round now: where a side of the square pointed in the picture, from u towards v."""

    @property
    def phases(self) -> tuple[float, float]:
        """How long its phases are, as a square and as a long thing: 1, or 0 where it has no such sides."""
        return (float(self.symmetry != ROUND), float(self.symmetry == LONG))


def as_it_is(yaw: float, symmetry: int = SQUARE) -> Shape:
    """An object that nothing was done to."""
    return Shape(yaw, symmetry, np.eye(2))


def turned(rng: np.random.Generator, shape: Shape, jacobian: FloatArray) -> Shape:
    """Half of the time turned by up to a quarter turn either way; `jacobian` `(2, 2)` is d table / d picture."""
    if rng.random() >= _TURNED:
        return shape
    angle = rng.uniform(-math.pi / 2, math.pi / 2)
    c, s = math.cos(angle), math.sin(angle)
    turn = np.array([[c, -s], [s, c]])
    x, y = jacobian @ turn @ _direction(shape.yaw, jacobian)
    return replace(shape, yaw=math.atan2(y, x), linear=turn @ shape.linear)


def reshaped(rng: np.random.Generator, shape: Shape, jacobian: FloatArray, long_from: float) -> Shape:
    """Of another size and, if it was square, stretched or round.

    What is more than `long_from` times longer than wide is long.
    """
    size = _LARGER ** rng.uniform(-1, 1)
    if shape.symmetry != SQUARE:
        return replace(shape, linear=size * shape.linear)
    yaw = shape.yaw + rng.integers(2) * math.pi / 2  # either side may become the long one
    direction = _direction(yaw, jacobian)
    if rng.random() < 0.5:
        return Shape(yaw, ROUND, size * np.eye(2), math.atan2(direction[1], direction[0]))
    longer = rng.uniform(1.0, _LONGER)
    stretch = (np.eye(2) + (longer - 1) * np.outer(direction, direction)) / longer**0.5
    return Shape(yaw, LONG if longer > long_from else SQUARE, size * stretch)


def with_shape(
    picture: Image, table: Image, mask: Mask, about: FloatArray, shape: Shape
) -> tuple[Image, Mask]:
    """The scene `(H, W, 3)` and the object's mask `(H, W)` after its shape has changed.

    `table` is the scene `without_object`; `about` `(2,)` pixels (u, v) is the object's middle. A square that becomes
    round touches its old sides, and the shading along them goes round with the outline.
    """
    v, u = np.mgrid[: picture.shape[0], : picture.shape[1]].astype(np.float32)
    offset = np.stack([u - about[0], v - about[1]], axis=-1) @ np.linalg.inv(shape.linear).T
    if shape.round_from is not None:
        c, s = math.cos(shape.round_from), math.sin(shape.round_from)
        to_sides = np.abs(offset @ np.array([[c, -s], [s, c]])).max(axis=-1)
        offset *= (np.linalg.norm(offset, axis=-1) / np.maximum(to_sides, 1e-6))[..., None]
    from_u, from_v = np.ascontiguousarray((offset + about).transpose(2, 0, 1), np.float32)
    there = np.asarray(cv2.remap(mask, from_u, from_v, cv2.INTER_LINEAR), np.float32)
    moved = cv2.remap(picture, from_u, from_v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    share = there[..., None]
    return np.asarray(share * moved + (1 - share) * table, np.uint8), there


def _direction(yaw: float, jacobian: FloatArray) -> FloatArray:
    """`(2,)`, of length 1: where something at a yaw on the table points in the picture."""
    direction = np.linalg.solve(jacobian, [math.cos(yaw), math.sin(yaw)])
    return np.asarray(direction / np.linalg.norm(direction))
