"""Corners of printed boards refined to a few hundredths of a pixel, and how a board that sags is bent.

Around a corner where two black and two white squares meet, the slightly blurred picture is a saddle, and its saddle
point is the corner (Lucchese & Mitra, "Using saddle points for subpixel feature detection in camera calibration
targets", 2002). On ChArUco boards this errs a third as much as `cv2.cornerSubPix`, whose window takes in the markers
beside the corner.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from baggie.geometry import FloatArray

_BLUR_PX = 1.0
_ROUNDS = 3
_REMAP_STEPS = 32
"""Of `cv2.remap`, a pixel (`INTER_TAB_SIZE`)."""
MAX_MOVE_PX = 1.5
"""A corner that would move further is left where it was: something else is there."""


def refine_saddles(grey: NDArray[np.uint8], corners: FloatArray, radius: int) -> FloatArray:
    """Corners `(N, 2)` (u, v) of a picture `(H, W)` moved to the saddle points within `radius` pixels: `(N, 2)`."""
    if len(corners) == 0:
        return corners
    smooth = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), _BLUR_PX)
    v, u = (axis.ravel().astype(float) for axis in np.mgrid[-radius : radius + 1, -radius : radius + 1])
    weight = np.exp(-(u**2 + v**2) / (2 * (radius / 1.5) ** 2))
    # I(u, v) ~ a u² + b u v + c v² + d u + e v + f by weighted least squares, the same for every patch.
    basis = np.stack([u * u, u * v, v * v, u, v, np.ones_like(u)], axis=1)
    fit = np.linalg.pinv(basis * weight[:, None]) * weight
    found, settled = corners.astype(float), np.ones(len(corners), bool)
    for _ in range(_ROUNDS):
        # `cv2.remap` rounds to 1/32 pixel whatever it is given: look where it looks, and step from there.
        found = np.round(found * _REMAP_STEPS) / _REMAP_STEPS
        in_u, in_v = ((found[:, k, None] + offsets).astype(np.float32) for k, offsets in enumerate((u, v)))
        patches = cv2.remap(smooth, in_u, in_v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        a, b, c, d, e, _ = fit @ np.asarray(patches, float).T
        determinant = 4 * a * c - b * b
        settled &= determinant < 0  # a saddle, not a hill
        steps = (
            np.stack([b * e - 2 * c * d, b * d - 2 * a * e], axis=1)
            / np.where(settled, determinant, -1.0)[:, None]
        )
        found = found + np.where(settled[:, None], np.clip(steps, -1.0, 1.0), 0.0)
    settled &= np.linalg.norm(found - corners, axis=1) < MAX_MOVE_PX
    return np.where(settled[:, None], found, corners)


@dataclass(frozen=True)
class Sag:
    """How far a board's middle is from the plane through its four outermost corners, metres.

    z = along (1 - x²) + across (1 - y²) in the board's frame, x and y from -1 to 1 between its outermost corners: a
    parabola each way, which is mrcal's `calobject_warp` (mrcal 2.2, `mrcal.ref_calibration_object`). Positive is into
    the paper: the print is hollow.
    """

    along_m: float = 0.0
    """Bowed along its rows, in which x runs."""
    across_m: float = 0.0
    """Bowed along its columns, in which y runs."""

    def __str__(self) -> str:
        return f"{1000 * abs(self.along_m):.1f} mm along, {1000 * abs(self.across_m):.1f} mm across"

    @classmethod
    def from_yaml(cls, content: Mapping[str, Any] | None) -> Sag | None:
        """What `dataclasses.asdict` wrote; None where nothing stands. Raises `KeyError`, `TypeError`, `ValueError`."""
        return None if content is None else cls(float(content["along_m"]), float(content["across_m"]))

    def bend(self, points: FloatArray, board: FloatArray) -> FloatArray:
        """`(N, 3)`: points of the flat board where they are on the bent one, whose corners are `board` `(M, 3)`."""
        depth = bows(points, board) @ np.array([self.along_m, self.across_m])
        return np.column_stack([points[:, :2], depth])


FLAT = Sag()


def bows(points: FloatArray, board: FloatArray) -> FloatArray:
    """`(N, 2)`: how much of the sag along and of that across points `(N, 3)` of a board `(M, 3)` get."""
    low, high = board[:, :2].min(axis=0), board[:, :2].max(axis=0)
    half = np.maximum((high - low) / 2, np.finfo(float).tiny)
    return np.asarray(1 - ((points[:, :2] - (low + high) / 2) / half) ** 2, float)
