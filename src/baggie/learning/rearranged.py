"""Rearrange height maps: each object that stands alone moves by itself, and the labels move along exactly.

From few demonstrations a network learns by heart which thing lay beside which. What holds in every scene is how what is
picked belongs on what it is placed on; rearranged at random, nothing else is left to learn.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from baggie.geometry import FloatArray, apply_homography
from baggie.types import Image
from baggie.vision.carried import ObjectMap, extent

_WHOLE = 0.95
"""So much of a thing has to stay on the map."""
_MARGIN_PX = 2.0
"""And what is picked, or where something is placed, at least so far inside."""
_CROWDED = 0.3
"""Of what is put down, the share that comes close to something."""
_CLOSE = 0.7, 1.6
"""From the other's rim to its own middle, by how far it reaches; corners are further out than sides."""
_TRIES = 40
_ROLLS = 8


class MarkedMap(NamedTuple):
    """A map with places marked in it."""

    color: Image
    """`(H, W, 3)`."""
    height: NDArray[np.float32]
    """`(H, W)` metres."""
    places: FloatArray
    """`(N, 2)`: (u, v) pixels."""
    at: NDArray[np.int32]
    """`(N,)`: the thing at each place, as `ObjectMap.at` says; 0 is the table."""


class Rearranged(NamedTuple):
    """A map, and how it came to be."""

    color: Image
    """`(H, W, 3)`."""
    height: NDArray[np.float32]
    """`(H, W)` metres."""
    moves: FloatArray
    """`(N, 3, 3)`: the rigid motion of what was at each place, pixels -> pixels."""


def rearranged(
    rng: np.random.Generator,
    scene: MarkedMap,
    things: ObjectMap,
    table_move: FloatArray,
    size: tuple[int, int] | None = None,
) -> Rearranged | None:
    """Turn every object at random and put it where there is room for it; None where no room is found for one.

    `things`: those of the scene. The table itself, and places on it, move by `table_move` `(3, 3)`; nothing is put down
    where a place on the table is. `size` (width, height) pixels: of the new map; as the old one unless given.
    """
    layers = np.dstack([scene.color, scene.height]).astype(np.float32)
    rows, columns = scene.height.shape
    table = _Table(_warped(_bare(rng, layers, things), table_move, size or (columns, rows)))
    reach = max((extent(things.mask(int(thing)))[1] for thing in scene.at[scene.at > 0]), default=0.0)
    for place in apply_homography(table_move, scene.places[scene.at == 0]):
        table.keep_free(place, reach)
    moves = {0: table_move}
    for number in rng.permutation(things.count) + 1:
        move = table.put(rng, layers, things.mask(int(number)), scene.places[scene.at == number])
        if move is None:
            return None
        moves[int(number)] = move
    color, height = np.asarray(table.layers[..., :3].round(), np.uint8), table.layers[..., 3]
    return Rearranged(color, height, np.stack([moves[int(thing)] for thing in scene.at]))


class _Table:
    """Things are put on it one by one, none on another."""

    def __init__(self, layers: NDArray[np.float32]) -> None:
        self.layers = layers
        self._taken: NDArray[np.bool_] = np.zeros(layers.shape[:2], np.bool_)
        self._put: list[FloatArray] = []
        """Of each thing that was put down, its rim, `(N, 2)` (u, v) pixels."""

    def keep_free(self, place: FloatArray, reach_px: float) -> None:
        """Around a place `(2,)` (u, v) pixels."""
        rows, columns = self._taken.shape
        v, u = np.mgrid[:rows, :columns]
        self._taken |= np.hypot(u - place[0], v - place[1]) <= reach_px

    def put(
        self,
        rng: np.random.Generator,
        layers: NDArray[np.float32],
        mask: NDArray[np.uint8],
        places: FloatArray,
    ) -> FloatArray | None:
        """Put down what is under the mask in the layers; how it came there, or None where no try fits.

        `places` `(N, 2)` (u, v) pixels on it stay on the map.
        """
        rows, columns = self._taken.shape
        last = np.array([columns - 1, rows - 1]) - _MARGIN_PX
        middle, reach = extent(mask)
        for _ in range(_TRIES):
            to = self._somewhere(rng, reach)
            move = turn_about(middle, rng.uniform(-math.pi, math.pi), to)
            there = apply_homography(move, places) if len(places) else places
            if not ((there >= _MARGIN_PX) & (there <= last)).all():
                continue
            moved = cv2.warpPerspective(mask, move, (columns, rows), flags=cv2.INTER_NEAREST)
            whole = np.count_nonzero(moved == 2) >= _WHOLE * np.count_nonzero(mask == 2)
            if whole and not (self._taken & (moved == 2)).any():
                self._paste(layers, (mask > 0).astype(np.float32), move, cv2.boundingRect(moved))
                self._taken |= cv2.dilate((moved == 2).astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
                self._put.append(_rim(moved == 2))
                return move
        return None

    def _somewhere(self, rng: np.random.Generator, reach_px: float) -> FloatArray:
        """A place on the map; now and then close to something, because that is where networks err."""
        rows, columns = self._taken.shape
        if self._put and rng.random() < _CROWDED:
            rim = self._put[rng.integers(len(self._put))]
            beside, angle = rim[rng.integers(len(rim))], rng.uniform(-math.pi, math.pi)
            way = np.array([math.cos(angle), math.sin(angle)])
            return np.asarray(beside + reach_px * rng.uniform(*_CLOSE) * way)
        return rng.uniform(0, (columns, rows))

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
        # Its shadow falls on the table, and not on what stands there.
        share = np.where(self._taken[v : v + height, u : u + width], 0, share)
        part = self.layers[v : v + height, u : u + width]
        part += share[..., None] * (moved - part)


def _bare(rng: np.random.Generator, layers: NDArray[np.float32], things: ObjectMap) -> NDArray[np.float32]:
    """The table without the things: where one was is a piece of it from elsewhere."""
    bare, missing = layers.copy(), things.surroundings > 0
    bare[missing] = np.median(layers[::4, ::4], axis=(0, 1))  # should nothing else be found
    free = ~missing
    v, u = np.nonzero(missing)
    for _ in range(_ROLLS):
        down, right = (int(rng.integers(side)) for side in free.shape)
        there = v - down, u - right  # before the rim it goes on from the other side
        take = free[there]
        bare[v[take], u[take]] = layers[there[0][take], there[1][take]]
        v, u = v[~take], u[~take]
    return bare


def _rim(mask: NDArray[np.bool_]) -> FloatArray:
    """The outermost pixels of what is in a mask `(H, W)`: `(N, 2)` (u, v)."""
    inner = cv2.erode(mask.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    return np.argwhere(mask & ~inner)[:, ::-1].astype(float)


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
