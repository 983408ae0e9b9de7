"""Drift of the camera or the table, noticed from pictures alone: the still background is no longer in its place.

Landmarks are small tiles of a reference picture with something to see in them: wood grain, edges, cables, print. Bags
and the arm move between pictures, too, but cover the lesser part of them.

One picture is laid over another by the homography between all pixels of many small tiles together: inverse
compositional alignment (Baker & Matthews, "Lucas-Kanade 20 Years On", 2004) with the tiles weighted by Tukey's biweight
of their misfit: where something else has come into the picture, a whole tile stops to count. Fitted together, tiles of
wood grain that say how far they moved across the grain and nothing along it make up for one another.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from baggie.errors import BaggieError
from baggie.geometry import FloatArray, apply_homography
from baggie.types import Image

TILE_PX = 8
_MARGIN_PX = 6
_AROUND_PX = 21
_CLIP = 0.25
_DISTINCT, _DISTINCT_STDS = 0.005, 0.8
"""A tile whose brightness changes by less, relative, from pixel to pixel (RMS, in the direction in which it changes
most) shows nothing, nor does one that changes by less than 0.8 of the noise: noise alone makes half of its own."""
_STEPS, _ENOUGH_PX = 15, 0.02
_TUKEY = 3.0

Contrast = NDArray[np.float32]
"""`(h, w)`: brightness relative to the surroundings', less 1."""


def local_contrast(image: Image, width: int) -> Contrast:
    """A picture `(H, W, 3)` or `(H, W)` made about `width` wide, with exposure, colour cast and shading taken out."""
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) if image.ndim == 3 else image
    shrink = max(round(grey.shape[1] / width), 1)
    size = (grey.shape[1] // shrink, grey.shape[0] // shrink)
    small = cv2.resize(grey, size, interpolation=cv2.INTER_AREA).astype(np.float32)
    relative = small / (cv2.blur(small, (_AROUND_PX, _AROUND_PX)) + 1) - 1
    return np.asarray(np.clip(relative, -_CLIP, _CLIP), np.float32)


@dataclass(frozen=True)
class Alignment:
    """How a picture lies over the template."""

    motion: FloatArray
    """`(3, 3)`: pixels of the template to those of the picture."""
    correlation: FloatArray
    """`(N,)`, of each tile with what lies over it: 1 for the same, 0 for something else or the picture's end."""


class Template:
    """The distinct tiles of a picture, ready to be laid over others."""

    def __init__(self, picture: Contrast) -> None:
        """`picture` `(h, w)`, as `local_contrast` makes it."""
        height, width = picture.shape
        self.size = (width, height)
        self._columns, self._rows = (max((side - 2 * _MARGIN_PX) // TILE_PX, 0) for side in self.size)
        self._left = (width - self._columns * TILE_PX) // 2
        self._top = (height - self._rows * TILE_PX) // 2
        self._distinct: NDArray[np.bool_] | slice = slice(None)
        along_u, along_v = (cv2.Sobel(picture, cv2.CV_32F, *order, ksize=3) / 8 for order in ((1, 0), (0, 1)))
        slopes = self._tiles(np.dstack([along_u, along_v]))  # (N, TILE_PX², 2)
        steepest = np.linalg.eigvalsh(np.swapaxes(slopes, 1, 2) @ slopes / TILE_PX**2)[:, -1]
        self._distinct = np.sqrt(steepest) > max(_DISTINCT, _DISTINCT_STDS * _noise(picture))
        v, u = np.mgrid[:height, :width].astype(np.float32)
        self.centers: FloatArray = self._tiles(np.dstack([u, v])).mean(axis=1, dtype=float)
        """`(N, 2)` pixels (u, v)."""
        # About the middle and by the half width, so that the eight parameters are of one size.
        half = width / 2
        self._scaled = np.array(
            [[half, 0.0, (width - 1) / 2], [0.0, half, (height - 1) / 2], [0.0, 0.0, 1.0]]
        )
        x, y = (u - self._scaled[0, 2]) / half, (v - self._scaled[1, 2]) / half
        gx, gy = along_u * half, along_v * half
        outward = gx * x + gy * y
        by_parameter = np.dstack([gx * x, gx * y, gx, gy * x, gy * y, gy, -outward * x, -outward * y])
        self._descent = np.swapaxes(self._tiles(by_parameter), 1, 2)  # (N, 8, TILE_PX²)
        self._hessians = (self._descent @ np.swapaxes(self._descent, 1, 2)).astype(float)
        self._template = self._tiles(picture[..., None])[..., 0]

    def align(self, picture: Contrast, start: FloatArray | None = None) -> Alignment:
        """The motion `(3, 3)` that lays the template over a picture of the same size, sought from `start`."""
        to_scaled = np.linalg.inv(self._scaled)
        motion = np.eye(3) if start is None else to_scaled @ start @ self._scaled
        for _ in range(_STEPS):
            misfit = self._over(picture, self._scaled @ motion @ to_scaled) - self._template
            size = np.sqrt((misfit**2).mean(axis=1))
            inside = np.isfinite(size)
            if not inside.any():
                break
            limit = max(_TUKEY * float(np.median(size[inside])), 1e-6)
            weight = np.where(inside, np.clip(1 - (size / limit) ** 2, 0, None) ** 2, 0).astype(float)
            gradient = (self._descent @ np.nan_to_num(misfit)[..., None])[..., 0]
            hessian = np.tensordot(weight, self._hessians, 1)
            step = np.linalg.lstsq(hessian, weight @ gradient, rcond=1e-9)[0]
            motion = motion @ np.linalg.inv(np.append(step, 0.0).reshape(3, 3) + np.eye(3))
            motion /= motion[2, 2]
            if np.abs(step).max() * self._scaled[0, 0] < _ENOUGH_PX:
                break
        motion = self._scaled @ motion @ to_scaled
        return Alignment(motion, self._correlation(self._over(picture, motion)))

    def moved_px(self, motion: FloatArray) -> FloatArray:
        """`(N,)`: how far a motion takes the tiles' centres."""
        return np.asarray(np.linalg.norm(apply_homography(motion, self.centers) - self.centers, axis=1))

    def _over(self, picture: Contrast, motion: FloatArray) -> NDArray[np.float32]:
        """`(N, TILE_PX²)`: what of a picture lies over each tile; not a number where it ends."""
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        laid = cv2.warpPerspective(picture, motion, self.size, flags=flags, borderValue=float("nan"))
        return self._tiles(np.asarray(laid, np.float32)[..., None])[..., 0]

    def _correlation(self, over: NDArray[np.float32]) -> FloatArray:
        ours, theirs = (tiles - tiles.mean(axis=1, keepdims=True) for tiles in (self._template, over))
        norms = np.linalg.norm(ours, axis=1) * np.linalg.norm(theirs, axis=1)
        return np.asarray(np.nan_to_num((ours * theirs).sum(axis=1) / np.maximum(norms, 1e-9)), float)

    def _tiles(self, picture: NDArray[np.float32]) -> NDArray[np.float32]:
        """`(h, w, C)` -> `(N, TILE_PX², C)`: the distinct ones, row by row."""
        rows, columns, channels = self._rows, self._columns, picture.shape[2]
        part = picture[self._top : self._top + rows * TILE_PX, self._left : self._left + columns * TILE_PX]
        parts = part.reshape(rows, TILE_PX, columns, TILE_PX, channels).swapaxes(1, 2)
        return np.ascontiguousarray(parts.reshape(rows * columns, TILE_PX**2, channels)[self._distinct])


def _noise(picture: Contrast) -> float:
    """Standard deviation of what changes from pixel to pixel without any pattern (Immerkær, "Fast Noise Variance
    Estimation", 1996; by the median, which a textured part of the picture does not spoil).
    """
    blind_to_slopes = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
    return float(np.median(np.abs(cv2.filter2D(picture, cv2.CV_32F, blind_to_slopes)))) / 0.6745 / 6


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
        """Find all distinct tiles of a picture `(H, W, 3)`. Raises `BaggieError` where there are too few."""
        templates = [Template(local_contrast(reference, width)) for width in _WIDTHS_PX]
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
        seen = local_contrast(picture, _WIDTHS_PX[0])
        found = fine.align(seen)
        if (found.correlation > _SAME).mean() >= _MOST:
            return found
        motion = np.eye(3)
        for template, width in zip(self._templates[:0:-1], _WIDTHS_PX[:0:-1], strict=True):
            start = _resized(motion, template.size[0] / fine.size[0])
            coarse = template.align(local_contrast(picture, width), start)
            motion = _resized(coarse.motion, fine.size[0] / template.size[0])
        return max(found, fine.align(seen, motion), key=lambda one: float((one.correlation > _SAME).mean()))


def _resized(motion: FloatArray, grow: float) -> FloatArray:
    """Convert a motion `(3, 3)` to pictures `grow` times as large (pixel centres at integers)."""
    resize = np.array([[grow, 0.0, (grow - 1) / 2], [0.0, grow, (grow - 1) / 2], [0.0, 0.0, 1.0]])
    return resize @ motion @ np.linalg.inv(resize)
