"""How often a turn things look the same, told from the maps in which they are seen."""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from baggie.errors import BaggieWarning
from baggie.geometry import rotation, wrap_angle
from baggie.types import Image
from baggie.vision.carried import Carried, Mask, middle_of

Origin = Literal["given", "recorded", "found", "unknown"]
"""Who said it: a person, the recording, the maps, or nobody, so that nothing is taken to look the same."""
_FOLDS = (6, 5, 4, 3, 2)
_ROUND = (8, 7, 5)
"""What looks the same after an eighth, a seventh and a fifth of a turn looks so at any angle."""
_COVERS, _COVERS_NOT = 0.85, 0.8
"""Of a thing's footprint and its turned one, what both share: more where it looks the same, 0.88 and more of things of
thirteen pixels; less where it does not, 0.76 and less."""
_COLOR = 20.0
"""Of 255: by how much the colours of both may differ on the average."""
_SIZE = 0.2
"""Things whose areas differ by less are taken to be of one kind, and are looked at together."""
_STEP, _SAME_TURN = math.radians(2.0), math.radians(15.0)


def found_symmetries(colors: NDArray[np.uint8], carried: Sequence[Carried | None]) -> NDArray[np.int64]:
    """`(N,)`: how often a turn each thing looks the same, 0 for at any angle; 1 where the maps do not tell.

    `colors` `(N, H, W, 3)`: of the maps in which they stood.
    """
    found = np.ones(len(carried), np.int64)
    known = [number for number, each in enumerate(carried) if each is not None]
    looks = _Looks(colors, carried)
    for number in known:
        alike = looks.of_a_kind(number)
        if all(looks.same(alike, fold) for fold in _ROUND):
            found[number] = 0
        else:
            found[number] = next((fold for fold in _FOLDS if looks.same(alike, fold)), 1)
    return found


def check_symmetries(
    symmetry: NDArray[np.int64], colors: NDArray[np.uint8], carried: Sequence[Carried | None], origin: Origin
) -> None:
    """Warn where things are said to look the same more often than the maps show.

    `symmetry` `(N,)`: as it was `origin`, given or recorded.
    """
    looks = _Looks(colors, carried)
    for number, said in enumerate(symmetry):
        fold = 8 if said == 0 else int(said)
        if fold == 1 or carried[number] is None:
            continue
        covers = looks.covers(looks.of_a_kind(number), fold)
        if covers < _COVERS_NOT:
            warnings.warn(
                f"expected things that look the same {'at any angle' if said == 0 else f'{said} times a turn'}, as the "
                f"symmetry {origin} says, got one in demonstration {number} that covers {covers:.0%} of itself when it "
                "is turned so; leave --symmetry out, and it is found, or give another",
                BaggieWarning,
                stacklevel=2,
            )
            return


def turn_onto(mask: Mask, other: Mask, symmetry: int) -> float | None:
    """Radians by which a footprint `(H, W)` has to be turned about its middle to lie as an `other` one does.

    Modulo `symmetry`, how often a turn the other thing looks the same. None where it does not cover the other at any
    angle, or does at several, so that the outline does not tell.
    """
    period = 2 * math.pi / max(symmetry, 1)
    angles = np.arange(0.0, _STEP if symmetry == 0 else period, _STEP)
    half = math.ceil(max(_radius(mask), _radius(other))) + 1
    there = _centred(other, 0.0, half)
    covers = np.array([_share(_centred(mask, angle, half), there) for angle in angles])
    best = float(angles[covers.argmax()])
    covering = angles[covers >= _COVERS]
    if not len(covering) or (np.abs(wrap_angle(covering - best, period)) > _SAME_TURN).any():
        return None
    return best


def _centred(mask: Mask, angle: float, half: int) -> NDArray[np.float32]:
    """A footprint `(H, W)` turned about its middle, which is in the middle of the `half` * 2 + 1 square pixels."""
    turn = rotation(angle)
    move = np.c_[turn, half - turn @ middle_of(mask)]
    size = 2 * half + 1
    return np.asarray(
        cv2.warpAffine(mask.astype(np.float32), move, (size, size), flags=cv2.INTER_LINEAR), np.float32
    )


def _radius(mask: Mask) -> float:
    return float(np.linalg.norm(np.argwhere(mask)[:, ::-1] - middle_of(mask), axis=1).max())


def _share(mask: NDArray[Any], other: NDArray[Any]) -> float:
    """Share of what either of two footprints covers that both do (intersection over union)."""
    return float(np.minimum(mask, other).sum() / np.maximum(mask, other).sum())


class _Looks:
    """How things look when they are turned about their middles."""

    def __init__(self, colors: NDArray[np.uint8], carried: Sequence[Carried | None]) -> None:
        self._colors, self._carried = colors, carried
        self._areas = np.array([0 if each is None else np.count_nonzero(each.stood) for each in carried])
        self._seen: dict[tuple[int, int], tuple[float, float]] = {}

    def of_a_kind(self, number: int) -> list[int]:
        """The demonstrations whose things are about as large."""
        area = self._areas[number]
        return np.flatnonzero(np.abs(self._areas - area) <= _SIZE * area).tolist()

    def covers(self, numbers: Sequence[int], fold: int) -> float:
        """What footprints share with themselves turned by the `fold`-th part of a turn, on the average."""
        return float(np.mean([self._turned(number, fold)[0] for number in numbers]))

    def same(self, numbers: Sequence[int], fold: int) -> bool:
        """Whether they look the same then."""
        color = float(np.mean([self._turned(number, fold)[1] for number in numbers]))
        return self.covers(numbers, fold) >= _COVERS and color <= _COLOR

    def _turned(self, number: int, fold: int) -> tuple[float, float]:
        if (number, fold) not in self._seen:
            carried = self._carried[number]
            assert carried is not None
            self._seen[number, fold] = _turned(carried, self._colors[number], 2 * math.pi / fold)
        return self._seen[number, fold]


def _turned(carried: Carried, color: Image, angle: float) -> tuple[float, float]:
    """The share of its footprint that a thing covers, turned about its middle, and how far its colours differ then."""
    rows, columns = carried.stood.shape
    move = np.c_[rotation(angle), carried.middle - rotation(angle) @ carried.middle]
    mask = carried.stood.astype(np.float32)
    there = cv2.warpAffine(mask, move, (columns, rows), flags=cv2.INTER_LINEAR)
    covers = _share(mask, there)
    inner = (cv2.erode(mask, np.ones((5, 5))) > 0) & (there > 0.99)
    if not inner.any():
        return covers, 0.0
    turned = cv2.warpAffine(color.astype(np.float32), move, (columns, rows), flags=cv2.INTER_LINEAR)
    return covers, float(np.abs(color - turned).max(axis=2)[inner].mean())
