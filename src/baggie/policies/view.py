"""Which part of the camera's picture a network sees, and at what size."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Self

import cv2
import numpy as np

from baggie.geometry import FloatArray, apply_homography
from baggie.types import Goal, Image

_STRIDE = 8
"""The input's sides are multiples of this, so that a U-Net can halve them three times."""


@dataclass(frozen=True)
class View:
    """A rectangle of the picture, resized: an overhead camera sees far more than the workspace.

    Coordinates: *pixels* of the picture, *input pixels* of the network, and the *normalised* picture, whose
    centre is (0, 0) and whose left and right edges are at u = -1 and 1.
    """

    picture: tuple[int, int]
    """`(width, height)` of the camera's picture, pixels."""
    left: int
    top: int
    right: int
    bottom: int
    """The rectangle, pixels; right and bottom are the first column and row outside."""
    size: tuple[int, int]
    """`(width, height)` of the network's input."""

    @classmethod
    def around(
        cls, points: FloatArray, picture: tuple[int, int], side: int = 160, margin: float = 0.1
    ) -> View:
        """The rectangle that holds `points` `(N, 2)` pixels, wider by `margin` of its size on every side.

        The input's longer side gets `side` pixels.
        """
        low, high = points.min(axis=0), points.max(axis=0)
        spare = margin * (high - low)
        left, top = np.clip(np.floor(low - spare), 0, None).astype(int)
        right, bottom = np.clip(np.ceil(high + spare) + 1, 1, picture).astype(int)
        extent = np.array([right - left, bottom - top])
        width, height = np.maximum(np.round(side * extent / extent.max() / _STRIDE).astype(int), 1) * _STRIDE
        return cls(picture, int(left), int(top), int(right), int(bottom), (int(width), int(height)))

    def cut(self, picture: Image) -> Image:
        """`(H, W, 3)` picture -> `(h, w, 3)` network input."""
        part = picture[self.top : self.bottom, self.left : self.right]
        return np.asarray(cv2.resize(part, self.size, interpolation=cv2.INTER_AREA), np.uint8)

    def from_input(self) -> FloatArray:
        """`(3, 3)`: input pixels -> pixels, both with centres at integers."""
        su = (self.right - self.left) / self.size[0]
        sv = (self.bottom - self.top) / self.size[1]
        return np.array(
            [[su, 0, self.left + su / 2 - 0.5], [0, sv, self.top + sv / 2 - 0.5], [0.0, 0.0, 1.0]]
        )

    def normalize(self) -> FloatArray:
        """`(3, 3)`: pixels -> the normalised picture."""
        half = self.picture[0] / 2
        return np.array(
            [
                [1 / half, 0, (0.5 - self.picture[0] / 2) / half],
                [0, 1 / half, (0.5 - self.picture[1] / 2) / half],
                [0.0, 0.0, 1.0],
            ]
        )

    def to_input(self, points: FloatArray) -> FloatArray:
        """`(N, 2)` pixels -> `(N, 2)` input pixels."""
        return apply_homography(np.linalg.inv(self.from_input()), points)

    def goal_to_input(self, goal: Goal) -> Goal:
        """A goal in pixels -> in input pixels."""
        return replace(goal, corners=self.to_input(goal.corners))

    def config(self) -> dict[str, Any]:
        """In plain YAML types; the picture's size is kept elsewhere."""
        edges = {"left": self.left, "top": self.top, "right": self.right, "bottom": self.bottom}
        return {**edges, "size": list(self.size)}

    @classmethod
    def of(cls, config: Mapping[str, Any], picture: tuple[int, int]) -> Self:
        """The inverse of `config`, for a picture of `(width, height)` pixels."""
        width, height = (int(value) for value in config["size"])
        edges = {key: int(config[key]) for key in ("left", "top", "right", "bottom")}
        return cls(picture, **edges, size=(width, height))

    def contains(self, points: FloatArray) -> bool:
        """Whether all points `(N, 2)` pixels lie in the rectangle."""
        low, high = np.array([self.left, self.top]) - 0.5, np.array([self.right, self.bottom]) - 0.5
        return bool(((points >= low) & (points <= high)).all())
