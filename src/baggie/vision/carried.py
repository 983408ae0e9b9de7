"""What one step of a demonstration carried, told from the height maps before and after it.

Where a map is lower afterwards, something stood; where it is higher, that came to lie. This tells a thing from what it
touched, and its middle from the point at which somebody happened to pick it. What stands on a table is told apart by
its height map.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from baggie.geometry import FloatArray, Grid, PlanarPose, rotation
from baggie.types import Image

_LOWEST_M = 0.004
"""Above the table, where a thing begins: height maps are noisy by a millimetre."""
_SMALLEST_THING_PX = 12
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
class ObjectMap:
    """What stands on a table, numbered from 1; 0 is the table."""

    footprints: NDArray[np.int32]
    """`(H, W)`: the thing that is here."""
    surroundings: NDArray[np.int32]
    """`(H, W)`: the thing that is here or near, its shadow with it."""
    count: int

    @classmethod
    def on(cls, height: NDArray[np.float32]) -> ObjectMap:
        """Number the objects by what is higher than most of a height map `(H, W)` metres, and hangs together."""
        high = height > np.median(height[::4, ::4]) + _LOWEST_M
        _, parts, stats, _ = cv2.connectedComponentsWithStats(high.astype(np.uint8))
        keep = stats[:, cv2.CC_STAT_AREA] >= _SMALLEST_THING_PX
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


def place_belongs_to(things: ObjectMap, color: Image, lies: NDArray[np.bool_]) -> int | None:
    """What a place moves with at which a thing comes to lie, on `lies` `(H, W)`: a thing, or the table, which is 0.

    What it comes to lie on or beside, what encloses it; the table where something is marked on it there, in the colours
    `(H, W, 3)`. None where nothing tells.
    """
    touched = np.bincount(things.enclosed[_grown(lies, _TOUCHES_PX)], minlength=things.count + 1)[1:]
    if touched.size and touched.max() >= _SMALLEST_THING_PX / 2:
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


Mask = NDArray[np.bool_]
CHANGED_M = 0.004
"""Height maps are noisy by a millimetre."""
_SMALLEST_PX = 12
"""What covers fewer pixels is noise."""
_NEAR_PX = 2.0
"""A pick so near to a thing is on it."""
ON_IT_PX = 0.75
"""So near to the middle of a pixel is in it, or at its rim: some demonstrators pick corners of pixels."""
_STRAY_PX = 16.0
"""A thing that is held at its rim tilts, and slides into a bowl; what came to lie further away is another."""
_EXACT_PX = 2.5
"""Where a thing lies as it was put, its middle is told so exactly."""
_ALIKE = 0.5
"""The smaller of both footprints, as a share of the other: from above, a thing is about as large here as there."""
_CUP_PX = 3
"""Pixels from the middle of a suction cup to its rim, at the usual 3 mm a pixel."""
_LEVEL_M = 0.003
"""Over so much a cup seals."""
_SAFE = 0.7
"""Of the largest distance from its rim that a thing has, where it is level: so far inside a cup is well placed."""
_HOLE = 0.03
"""Of a thing's area: a larger hole is one, and no noise."""


@dataclass(frozen=True)
class Carried:
    """A thing that was picked up and came to lie about where it was to go."""

    stood: Mask
    """`(H, W)`: what it covered before."""
    lies: Mask
    """`(H, W)`: what it covers after."""

    @classmethod
    def between(
        cls,
        before: NDArray[np.float32],
        after: NDArray[np.float32],
        places: FloatArray,
        turn: float,
    ) -> Carried | None:
        """What the maps `(H, W)` metres say of a pick and a place `(2, 2)` (u, v) pixels, turned by `turn` radians.

        None where nothing was carried as it was said: it was missed or dropped, hardly moved, or is too flat to see.
        """
        lower = before - after
        seen = cls._of(lower > CHANGED_M, lower < -CHANGED_M, places, turn)
        rows, columns = before.shape
        u, v = np.clip(places[0].round().astype(int), 0, [columns - 1, rows - 1])
        on_table = before[v, u] <= np.median(before[::4, ::4]) + CHANGED_M
        if on_table or (seen is not None and seen.stray_px(places, turn) <= _EXACT_PX):
            return seen
        # Where it was before and after alike nothing has changed: with that, it may be found where it was to go.
        same = (np.abs(lower) <= CHANGED_M) & (np.abs(before - before[v, u]) <= CHANGED_M)
        whole = cls._of((lower > CHANGED_M) | same, (lower < -CHANGED_M) | same, places, turn)
        exact = whole is not None and whole.stray_px(places, turn) <= _EXACT_PX
        return whole if exact else seen

    @classmethod
    def _of(cls, gone: Mask, come: Mask, places: FloatArray, turn: float) -> Carried | None:
        """What is gone `(H, W)` at the pick and has come near the place; None where the two are not one thing."""
        stood = _part_at(gone, places[0], _NEAR_PX)
        if stood is None:
            return None
        lies = _part_at(come, place_of(middle_of(stood), places, turn), _STRAY_PX)
        if lies is None:
            return None
        less, more = sorted((np.count_nonzero(stood), np.count_nonzero(lies)))
        return cls(stood, lies) if less >= _ALIKE * more else None

    @cached_property
    def middle(self) -> FloatArray:
        """`(2,)` (u, v) pixels: of what it covered before."""
        return middle_of(self.stood)

    def stood_at(self, pick: PlanarPose, grid: Grid) -> PlanarPose | None:
        """Where its middle was before, at yaw 0, in the robot's base frame; None where a pick is not on it."""
        off = np.argwhere(self.stood)[:, ::-1] - grid.to_pixels(pick.xy)
        if np.linalg.norm(off, axis=1).min() > ON_IT_PX:
            return None
        x, y = grid.to_robot(self.middle)[0]
        return PlanarPose(float(x), float(y), 0.0)

    def stray_px(self, places: FloatArray, turn: float) -> float:
        """How far its middle came to lie from where a pick and a place `(2, 2)`, turned by `turn`, take it: pixels."""
        return float(np.linalg.norm(middle_of(self.lies) - place_of(self.middle, places, turn)))

    def moved(self, places: FloatArray, turn: float) -> Mask:
        """`(H, W)`: what it covers once it is picked and placed at `places` `(2, 2)` and turned by `turn` radians."""
        rows, columns = self.stood.shape
        move = np.c_[rotation(turn), places[1] - rotation(turn) @ places[0]]
        there = cv2.warpAffine(self.stood.astype(np.uint8), move, (columns, rows), flags=cv2.INTER_NEAREST)
        return there > 0

    def cup_point(self, height: NDArray[np.float32]) -> FloatArray | None:
        """`(2,)` (u, v) pixels: where a suction cup holds it best, by the map before `(H, W)` metres.

        Of where it is level and far from its rim, what is nearest to its middle; the middle itself of most things. None
        for what has a hole, or is level nowhere.
        """
        if _has_hole(self.stood):
            return None
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * _CUP_PX + 1,) * 2)
        step = cv2.dilate(height, disc) - cv2.erode(height, disc)
        level = (step < _LEVEL_M) & (cv2.erode(self.stood.astype(np.uint8), disc) > 0)
        if not level.any():
            return None
        inside = cv2.distanceTransform(self.stood.astype(np.uint8), cv2.DIST_L2, 5)
        safe = level & (inside >= _SAFE * inside[level].max())
        u, v = self.middle.round().astype(int)
        if safe[v, u]:
            return self.middle
        best = np.argwhere(safe)[:, ::-1]
        off = np.linalg.norm(best - self.middle, axis=1)
        return np.asarray(best[off.argmin()], float)


def place_of(point: FloatArray, places: FloatArray, turn: float) -> FloatArray:
    """Where a `point` `(2,)` of what is picked and placed at `places` `(2, 2)`, turned by `turn`, comes to lie."""
    return np.asarray(places[1] + rotation(turn) @ (point - places[0]))


def with_turn(places: FloatArray, turn: float, other: float, middle: FloatArray) -> FloatArray:
    """The place `(2,)` of another turn, radians, after which the `middle` `(2,)` of what is carried lies as it did.

    Picked at `places[0]` all the same: a thing that looks the same after the turn between both then looks as if nothing
    had changed, wherever it is held.
    """
    return np.asarray(places[1] + (rotation(turn) - rotation(other)) @ (middle - places[0]))


def middle_of(mask: Mask) -> FloatArray:
    """`(2,)` (u, v) pixels: the mean of what is in a mask `(H, W)`."""
    return np.asarray(np.argwhere(mask)[:, ::-1].mean(axis=0), float)


def changed_parts(mask: Mask) -> Mask:
    """What in a mask `(H, W)` is too large to be noise."""
    return _large(mask) > 0


def _large(mask: Mask) -> NDArray[np.int32]:
    """What hangs together in a mask `(H, W)` and is too large to be noise, numbered; 0 elsewhere."""
    _, parts, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
    keep = stats[:, cv2.CC_STAT_AREA] >= _SMALLEST_PX
    keep[0] = False
    return np.asarray(np.where(keep[parts], parts, 0), np.int32)


def _part_at(mask: Mask, at: FloatArray, within_px: float) -> Mask | None:
    """What hangs together in a mask `(H, W)` and is nearest to `at` `(2,)`; None where nothing is so near."""
    parts = _large(mask)
    v, u = np.nonzero(parts)
    if not len(v):
        return None
    off = np.hypot(u - at[0], v - at[1])
    nearest = int(off.argmin())
    return np.asarray(parts == parts[v[nearest], u[nearest]]) if off[nearest] <= within_px else None


def _has_hole(mask: Mask) -> bool:
    outlines, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    filled = cv2.drawContours(np.zeros(mask.shape, np.uint8), outlines, -1, 1, cv2.FILLED)
    area = np.count_nonzero(mask)
    return bool(np.count_nonzero(filled) - area > _HOLE * area)
