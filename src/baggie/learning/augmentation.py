"""Random changes to pictures that leave the label known: of the view, the light, the looks and the object's shape.

Looks are cloth, table and clutter; the object keeps its shading, so a policy has to learn what a bag is, and not that
bags are red. Of another shape, or turned, an object keeps its middle in place.

Objects that were always put down square to the table would teach a network to look at the table's grain, and objects of
one shape that everything else is none.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from baggie.geometry import FloatArray, apply_homography
from baggie.types import Image
from baggie.vision.color_mask import chroma_of, find_bag


@dataclass(frozen=True)
class WarpRange:
    """How far random warps go."""

    rotation: float = math.radians(30)
    """Radians, either way."""
    scale: float = 1.2
    """Times larger or smaller."""
    shear: float = 0.1
    perspective: float = 0.1
    """Change of scale across the picture's longer side."""
    shift: float = 0.2
    """Of the picture's longer side, either way."""
    margin: float = 0.07
    """Points that must stay in the picture keep this distance from its edge, of its longer side."""


def random_warp(
    rng: np.random.Generator,
    size: tuple[int, int],
    keep: FloatArray,
    limits: WarpRange = WarpRange(),
    tries: int = 8,
) -> FloatArray:
    """A random homography of the picture `(3, 3)`, pixels -> pixels of the warped picture.

    Points `keep` `(N, 2)` pixels (u, v) end inside the `(width, height)` picture; when `tries` draws do not
    fit, the picture is left as it is.
    """
    width, height = size
    longer = max(size)
    center = (np.array([width, height]) - 1) / 2
    low, high = np.full(2, limits.margin * longer), np.array([width, height]) - 1 - limits.margin * longer
    for _ in range(tries):
        warp = _about(_linear(rng, limits), center)
        warp = _about(_tilt(rng, limits.perspective / longer), center) @ warp
        moved = apply_homography(warp, keep)
        shift_low = np.maximum(low - moved.min(axis=0), -limits.shift * longer)
        shift_high = np.minimum(high - moved.max(axis=0), limits.shift * longer)
        if (shift_low <= shift_high).all():
            shift = np.eye(3)
            shift[:2, 2] = rng.uniform(shift_low, shift_high)
            return shift @ warp
    return np.eye(3)


def random_light(rng: np.random.Generator, strength: float = 1.0) -> Image:
    """A random exposure, white balance, black level and contrast: a table `(256, 3)` uint8 to look colours up
    in.
    """
    level = np.linspace(0, 1, 256)[:, None]
    gamma = math.exp(strength * rng.normal(0, 0.1))
    gain = np.exp(strength * (rng.normal(0, 0.12) + rng.normal(0, 0.05, 3)))
    black = strength * rng.normal(0, 0.02)
    return np.asarray(np.clip(255 * (gain * level**gamma + black), 0, 255).round(), np.uint8)


def _linear(rng: np.random.Generator, limits: WarpRange) -> FloatArray:
    angle = rng.uniform(-limits.rotation, limits.rotation)
    scale = limits.scale ** rng.uniform(-1, 1)
    c, s = scale * math.cos(angle), scale * math.sin(angle)
    sheared = np.array([[c, -s], [s, c]]) @ [[1.0, rng.uniform(-limits.shear, limits.shear)], [0.0, 1.0]]
    return np.block([[sheared, np.zeros((2, 1))], [np.zeros((1, 2)), np.ones((1, 1))]])


def _tilt(rng: np.random.Generator, slope: float) -> FloatArray:
    tilt = np.eye(3)
    tilt[2, :2] = rng.uniform(-slope, slope, 2)
    return tilt


def _about(matrix: FloatArray, center: FloatArray) -> FloatArray:
    """Conjugate a map so that its origin is at `center`."""
    to_center = np.eye(3)
    to_center[:2, 2] = center
    from_center = np.eye(3)
    from_center[:2, 2] = -center
    return np.asarray(to_center @ matrix @ from_center)


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
_RIM_PX, _AROUND_PX = 2, 6
"""Around a mask: where colours mix, and where an object of another shape or turned may reach to."""
_OTHER_CHROMA = 0.25
"""What is so far in hue and saturation from most that surrounds an object is another object, no grain of the table."""
_OTHER_SHARE = 0.04
"""Of what surrounds an object: half a corner of another."""


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


def stands_alone(picture: Image, mask: Mask) -> bool:
    """Whether all that surrounds an object has about one colour, in any light: the table's, and no other object's."""
    there = (mask > 0.02).astype(np.uint8)
    rim, reach = (
        cv2.dilate(there, np.ones((2 * px + 1, 2 * px + 1), np.uint8)) for px in (_RIM_PX, _AROUND_PX)
    )
    around = chroma_of(picture)[(reach > 0) & (rim == 0)]
    if not len(around):
        return False
    off = np.linalg.norm(around - np.median(around, axis=0), axis=1)
    return bool((off > _OTHER_CHROMA).mean() < _OTHER_SHARE)


def random_look(rng: np.random.Generator, picture: Image, table: Image, mask: Mask) -> Image:
    """Redraw the scene `(H, W, 3)` with another cloth, half of the time another table, and clutter beside the object.

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
    """Redraw the table in another colour, under other lamps, with more or less of its grain."""
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


def unchanged(yaw: float, symmetry: int = SQUARE) -> Shape:
    """Make the shape of an object that nothing was done to."""
    return Shape(yaw, symmetry, np.eye(2))


def randomly_turned(rng: np.random.Generator, shape: Shape, jacobian: FloatArray) -> Shape:
    """Turn an object, half of the time, by up to a quarter turn; `jacobian` `(2, 2)` is d table / d picture."""
    if rng.random() >= _TURNED:
        return shape
    angle = rng.uniform(-math.pi / 2, math.pi / 2)
    c, s = math.cos(angle), math.sin(angle)
    turn = np.array([[c, -s], [s, c]])
    x, y = jacobian @ turn @ _direction(shape.yaw, jacobian)
    return replace(shape, yaw=math.atan2(y, x), linear=turn @ shape.linear)


def reshaped(rng: np.random.Generator, shape: Shape, jacobian: FloatArray, long_from: float) -> Shape:
    """Resize an object and, if it was square, stretch it or make it round.

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
