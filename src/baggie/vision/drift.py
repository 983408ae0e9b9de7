"""Notices from pictures alone that the camera or the table was bumped: the still background is no longer in its place.

Landmarks are small tiles of a reference picture with something to see in them: wood grain, edges, cables, print. Bags
and the arm move between pictures, too, but cover the lesser part of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from baggie.errors import BaggieError
from baggie.geometry import FloatArray, apply_homography
from baggie.types import Image
from baggie.vision.align import Alignment, Template, relief

MIN_LANDMARKS = 150
"""Fewer may be a bag and little else."""
_WIDTHS_PX = (427, 160, 80)
"""Pictures are laid over one another this wide; the coarse ones only where the finest finds no way by itself."""
_SAME = 0.5
"""Correlation above which a tile was found again; noise and other things stay below."""
_MOST = 0.5


@dataclass(frozen=True)
class Shift:
    """How a picture's background lies against the reference's."""

    px: float
    """How far it moved, the median over all landmarks, pixels of the picture; infinite where not `trusted`."""
    corners_px: FloatArray
    """`(4, 2)`: how far the picture's own corners moved, (u, v), from the top left one clockwise."""
    inliers: int
    """Landmarks found again where the motion has them."""
    total: int
    trusted: bool
    """False where less than half of the landmarks were found: most are covered, in the dark, or out of the picture."""


class Landmarks:
    """The still background of a reference picture."""

    def __init__(self, templates: list[Template], size: tuple[int, int]) -> None:
        self._templates = templates
        self.size = size
        """`(width, height)` of the reference picture, pixels."""

    @classmethod
    def find(cls, reference: Image) -> Landmarks:
        """All distinct tiles of a picture `(H, W, 3)`. Raises `BaggieError` where there are too few."""
        templates = [Template(relief(reference, width)) for width in _WIDTHS_PX]
        landmarks = cls(templates, (reference.shape[1], reference.shape[0]))
        if len(landmarks.points) < MIN_LANDMARKS:
            raise BaggieError(
                f"expected {MIN_LANDMARKS} places with something to see in the background, to notice when it moves, "
                f"got {len(landmarks.points)}; light it better, or give the table some pattern"
            )
        return landmarks

    @property
    def points(self) -> FloatArray:
        """`(N, 2)`: their middles, pixels (u, v) of the reference picture."""
        return (self._templates[0].centers + 0.5) * self._grow - 0.5

    @property
    def _grow(self) -> float:
        return float(self.size[0] / self._templates[0].size[0])

    def shift(self, picture: Image) -> Shift:
        """How the background of a picture of the same size lies. Raises `BaggieError` for another size."""
        size = (picture.shape[1], picture.shape[0])
        if size != self.size:
            raise BaggieError(
                f"expected a picture of {self.size[0]} x {self.size[1]} pixels, as the reference, got {size[0]} x "
                f"{size[1]}; set the camera back to this resolution, or take a new reference"
            )
        found = self._align(picture)
        inliers, total = int((found.correlation > _SAME).sum()), len(found.correlation)
        if inliers < _MOST * total:
            return Shift(float("inf"), np.full((4, 2), np.inf), inliers, total, False)
        fine = self._templates[0]
        width, height = fine.size
        corners = np.array([[0, 0], [width, 0], [width, height], [0, height]]) - 0.5
        return Shift(
            float(np.median(fine.moved_px(found.motion))) * self._grow,
            (apply_homography(found.motion, corners) - corners) * self._grow,
            inliers,
            total,
            True,
        )

    def _align(self, picture: Image) -> Alignment:
        """The alignment at the finest size: from where the camera stood, or else from coarse to fine."""
        fine = self._templates[0]
        seen = relief(picture, _WIDTHS_PX[0])
        found = fine.align(seen)
        if (found.correlation > _SAME).mean() >= _MOST:
            return found
        motion = np.eye(3)
        for template, width in zip(self._templates[:0:-1], _WIDTHS_PX[:0:-1], strict=True):
            start = _resized(motion, template.size[0] / fine.size[0])
            coarse = template.align(relief(picture, width), start)
            motion = _resized(coarse.motion, fine.size[0] / template.size[0])
        return max(found, fine.align(seen, motion), key=lambda one: float((one.correlation > _SAME).mean()))


def _resized(motion: FloatArray, grow: float) -> FloatArray:
    """The same motion `(3, 3)` in pictures `grow` times as large (pixel centres at integers)."""
    resize = np.array([[grow, 0.0, (grow - 1) / 2], [0.0, grow, (grow - 1) / 2], [0.0, 0.0, 1.0]])
    return resize @ motion @ np.linalg.inv(resize)
