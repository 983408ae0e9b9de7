"""What stands on a table, told apart on its height map."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from baggie.geometry import FloatArray

_LOWEST_M = 0.004
"""Above the table, where a thing begins: height maps are noisy by a millimetre."""
_SMALLEST_PX = 12
"""What covers fewer pixels is noise."""
_AROUND_PX = 6.0
"""So much of the table goes with a thing, because its shadow lies there."""
_BELONGS_PX = 2.0
"""A label this near to a thing is the thing's."""


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

    def mask(self, number: int) -> NDArray[np.uint8]:
        """`(H, W)`: 2 where a thing is, 1 around it, else 0."""
        around = (self.surroundings == number).astype(np.uint8)
        return np.asarray(around + (self.footprints == number), np.uint8)


def extent(mask: NDArray[np.uint8]) -> tuple[FloatArray, float]:
    """The middle `(2,)` (u, v) of what is 2 in a mask `(H, W)`, and how far its rim is from that; pixels."""
    pixels = np.argwhere(mask == 2)[:, ::-1]
    middle: FloatArray = pixels.mean(axis=0)
    return middle, float(np.linalg.norm(pixels - middle, axis=1).max())
