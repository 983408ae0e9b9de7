"""Scenes rearranged: everything that stands alone on the table moved by itself, with the labels carried along exactly.

From few demonstrations a network learns by heart which thing lay beside which. What holds in every scene is how what is
picked belongs on what it is placed on; rearranged at random, nothing else is left to learn.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from baggie.geometry import FloatArray, apply_homography
from baggie.types import Image

_LOWEST_M = 0.004
"""Above the table, where a thing begins: height maps are noisy by a millimetre."""
_SMALLEST_PX = 12
"""What covers fewer pixels is noise."""
_AROUND_PX = 6.0
"""So much of the table goes with a thing, because its shadow lies there."""
_BELONGS_PX = 2.0
"""A label this near to a thing is the thing's."""
_WHOLE = 0.95
"""So much of a thing has to stay on the map."""
_TRIES = 40
_ROLLS = 8


class Scene(NamedTuple):
    """A map with places marked in it."""

    color: Image
    """`(H, W, 3)`."""
    height: NDArray[np.float32]
    """`(H, W)` metres."""
    places: FloatArray
    """`(N, 2)`: (u, v) pixels."""


class Rearranged(NamedTuple):
    """A map, and how it came to be."""

    color: Image
    """`(H, W, 3)`."""
    height: NDArray[np.float32]
    """`(H, W)` metres."""
    moves: FloatArray
    """`(N, 3, 3)`: the rigid motion of what was at each place, pixels -> pixels."""


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


def rearranged(
    rng: np.random.Generator, scene: Scene, things: Things, table_move: FloatArray
) -> Rearranged | None:
    """Every thing turned at random and put where there is room for it; None where no room is found for one.

    `things`: those of the scene. The table itself, and places on it, move by `table_move` `(3, 3)`; nothing is put down
    where a place on the table is.
    """
    labels = things.at(scene.places)
    layers = np.dstack([scene.color, scene.height]).astype(np.float32)
    rows, columns = scene.height.shape
    table = _Table(_warped(_bare(rng, layers, things), table_move, (columns, rows)))
    reach = max((_reach_px(things.mask(int(label))) for label in labels[labels > 0]), default=0)
    for place in apply_homography(table_move, scene.places[labels == 0]):
        table.keep_free(place, reach)
    moves = {0: table_move}
    for number in rng.permutation(things.count) + 1:
        move = table.put(rng, layers, things.mask(int(number)))
        if move is None:
            return None
        moves[int(number)] = move
    color, height = np.asarray(table.layers[..., :3].round(), np.uint8), table.layers[..., 3]
    return Rearranged(color, height, np.stack([moves[int(label)] for label in labels]))


class _Table:
    """Things are put on it one by one, none on another or in its shadow."""

    def __init__(self, layers: NDArray[np.float32]) -> None:
        self.layers = layers
        self._taken = np.zeros(layers.shape[:2], np.uint8)
        """As `Things.mask`."""

    def keep_free(self, place: FloatArray, reach_px: int) -> None:
        cv2.circle(self._taken, place.round().astype(int).tolist(), reach_px, 2, cv2.FILLED)

    def put(
        self, rng: np.random.Generator, layers: NDArray[np.float32], mask: NDArray[np.uint8]
    ) -> FloatArray | None:
        """Put down what is under the mask in the layers; how it came there, or None where no try fits."""
        rows, columns = mask.shape
        middle = np.argwhere(mask == 2).mean(axis=0)[::-1]
        for _ in range(_TRIES):
            move = turn_about(middle, rng.uniform(-math.pi, math.pi), rng.uniform(0, (columns, rows)))
            there = cv2.warpPerspective(mask, move, (columns, rows), flags=cv2.INTER_NEAREST)
            whole = np.count_nonzero(there == 2) >= _WHOLE * np.count_nonzero(mask == 2)
            if (
                whole and not (self._taken + there > 2).any()
            ):  # 2 on 1: one of them stands in the other's shadow
                self._paste(layers, (mask > 0).astype(np.float32), move, cv2.boundingRect(there))
                self._taken = np.maximum(self._taken, there)
                return move
        return None

    def _paste(
        self,
        layers: NDArray[np.float32],
        share: NDArray[np.float32],
        move: FloatArray,
        box: Sequence[int],
    ) -> None:
        """A share of what is in the layers, moved; only `box`, (u, v, width, height), is touched."""
        u, v, width, height = box
        to_box = np.array([[1.0, 0.0, -u], [0.0, 1.0, -v], [0.0, 0.0, 1.0]]) @ move
        moved = _warped(layers, to_box, (width, height))
        share = _warped(share, to_box, (width, height), cv2.BORDER_CONSTANT)
        part = self.layers[v : v + height, u : u + width]
        part += share[..., None] * (moved - part)


def _bare(rng: np.random.Generator, layers: NDArray[np.float32], things: Things) -> NDArray[np.float32]:
    """The table without the things: where one was is a piece of it from elsewhere."""
    bare, missing = layers.copy(), things.surroundings > 0
    bare[missing] = np.median(layers[::4, ::4], axis=(0, 1))  # should nothing else be found
    free = ~missing
    for _ in range(_ROLLS):
        by = [int(rng.integers(side)) for side in free.shape]
        take = missing & np.roll(free, by, (0, 1))
        bare[take] = np.roll(layers, by, (0, 1))[take]
        missing &= ~take
    return bare


def _reach_px(mask: NDArray[np.uint8]) -> int:
    """How far a thing's rim is from its middle."""
    pixels = np.argwhere(mask == 2)
    return math.ceil(float(np.linalg.norm(pixels - pixels.mean(axis=0), axis=1).max()))


def turn_about(middle: FloatArray, turn: float, to: FloatArray) -> FloatArray:
    """The turn about `middle` that takes it to `to`: `(3, 3)`, pixels -> pixels."""
    c, s = math.cos(turn), math.sin(turn)
    move = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    move[:2, 2] = to - move[:2, :2] @ middle
    return move


def _warped(
    layers: NDArray[np.float32], move: FloatArray, size: tuple[int, int], border: int = cv2.BORDER_REFLECT
) -> NDArray[np.float32]:
    """`(width, height)` of layers `(H, W)` or `(H, W, C)` after a motion; beyond their rim they are as before it."""
    moved = cv2.warpPerspective(layers, move, size, flags=cv2.INTER_LINEAR, borderMode=border)
    return np.asarray(moved, np.float32)
