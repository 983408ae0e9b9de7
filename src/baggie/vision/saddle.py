"""Where the corners of a chessboard really are, to a few hundredths of a pixel.

Around a corner where two black and two white squares meet, the slightly blurred picture is a saddle, and its saddle
point is the corner (Lucchese & Mitra, "Using saddle points for subpixel feature detection in camera calibration
targets", 2002). On ChArUco boards this errs a third as much as `cv2.cornerSubPix`, whose window takes in the markers
beside the corner.
"""

from __future__ import annotations

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
