"""What stands on a table, told apart on its height map."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from baggie.geometry import FloatArray
from baggie.types import Image

_LOWEST_M = 0.004
"""Above the table, where a thing begins: height maps are noisy by a millimetre."""
_SMALLEST_PX = 12
"""What covers fewer pixels is noise."""
_AROUND_PX = 6.0
"""So much of the table goes with a thing, because its shadow lies there."""
_BELONGS_PX = 2.0
"""A label this near to a thing is the thing's."""
_TOUCHES_PX = 3.0
"""Beside what is this near, a thing was put with care."""
_MARK, _MARKED = 40.0, 0.05
"""Of 255: what differs so much from most of the table is a mark, where so large a share does."""


@dataclass(frozen=True)
class Things:
    """What stands on a table, numbered from 1; 0 is the table."""

    footprints: NDArray[np.int32]
    """`(H, W)`: the thing that is here."""
    surroundings: NDArray[np.int32]
    """`(H, W)`: the thing that is here or near, its shadow with it."""
    count: int

    @classmethod
    def on(cls, height: NDArray[np.float32]) -> Things:
        """By what is higher than most of a height map `(H, W)` metres, and hangs together."""
        high = height > np.median(height[::4, ::4]) + _LOWEST_M
        _, parts, stats, _ = cv2.connectedComponentsWithStats(high.astype(np.uint8))
        keep = stats[:, cv2.CC_STAT_AREA] >= _SMALLEST_PX
        keep[0] = False
        footprints = (np.cumsum(keep) * keep).astype(np.int32)[parts]
        if not keep.any():
            return cls(footprints, footprints, 0)
        distance, nearest = cv2.distanceTransformWithLabels(
            (footprints == 0).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_CCOMP
        )
        things = np.zeros(nearest.max() + 1, np.int32)  # OpenCV numbers them in its own way
        things[nearest[footprints > 0]] = footprints[footprints > 0]
        surroundings = np.where(distance <= _AROUND_PX, things[nearest], 0).astype(np.int32)
        return cls(footprints, surroundings, int(keep.sum()))

    def at(self, places: FloatArray) -> NDArray[np.int32]:
        """Which thing is at places `(N, 2)` (u, v) pixels, or so near that it must be meant: `(N,)`."""
        v, u = np.nonzero(self.footprints)
        if len(v) == 0 or len(places) == 0:
            return np.zeros(len(places), np.int32)
        off = np.linalg.norm(places[:, None] - np.column_stack([u, v]), axis=2)
        near = off.min(axis=1) <= _BELONGS_PX
        return np.where(near, self.footprints[v, u][off.argmin(axis=1)], 0)

    @cached_property
    def enclosed(self) -> NDArray[np.int32]:
        """`(H, W)`: the thing that is here, or all around."""
        filled = self.footprints.copy()
        for number in range(1, self.count + 1):
            mask = (self.footprints == number).astype(np.uint8)
            outlines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
            inside = cv2.drawContours(np.zeros_like(mask), outlines, -1, 1, cv2.FILLED) > 0
            filled[inside & (self.footprints == 0)] = number
        return filled

    def under(self, mask: NDArray[np.bool_]) -> int:
        """The thing that covers most of a mask `(H, W)`; 0 where none covers any of it."""
        covered = np.bincount(self.footprints[mask], minlength=self.count + 1)
        return int(covered[1:].argmax()) + 1 if covered[1:].any() else 0

    def mask(self, number: int) -> NDArray[np.uint8]:
        """`(H, W)`: 2 where a thing is, 1 around it, else 0."""
        around = (self.surroundings == number).astype(np.uint8)
        return np.asarray(around + (self.footprints == number), np.uint8)


def place_belongs_to(things: Things, color: Image, lies: NDArray[np.bool_]) -> int | None:
    """What a place moves with at which a thing comes to lie, on `lies` `(H, W)`: a thing, or the table, which is 0.

    What it comes to lie on or beside, what encloses it; the table where something is marked on it there, in the colours
    `(H, W, 3)`. None where nothing tells.
    """
    touched = np.bincount(things.enclosed[_grown(lies, _TOUCHES_PX)], minlength=things.count + 1)[1:]
    if touched.size and touched.max() >= _SMALLEST_PX / 2:
        return int(touched.argmax()) + 1
    bare = things.surroundings == 0
    off = np.abs(color.astype(float) - np.median(color[bare], axis=0)).max(axis=2)
    here = _grown(lies, _AROUND_PX) & bare
    return 0 if here.any() and (off[here] > _MARK).mean() > _MARKED else None


def _grown(mask: NDArray[np.bool_], by_px: float) -> NDArray[np.bool_]:
    side = 2 * round(by_px) + 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
    return cv2.dilate(mask.astype(np.uint8), disc) > 0


def extent(mask: NDArray[np.uint8]) -> tuple[FloatArray, float]:
    """The middle `(2,)` (u, v) of what is 2 in a mask `(H, W)`, and how far its rim is from that; pixels."""
    pixels = np.argwhere(mask == 2)[:, ::-1]
    middle: FloatArray = pixels.mean(axis=0)
    return middle, float(np.linalg.norm(pixels - middle, axis=1).max())
