"""Corners of printed boards refined to a few hundredths of a pixel, how a board that sags is bent, and ArUco markers.

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
from baggie.types import Image

_MIN_RADIUS_PX, _MAX_RADIUS_PX = 2, 8
"""Within which a corner is looked for again."""
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


def aruco_dictionary(name: str) -> cv2.aruco.Dictionary:
    """OpenCV's dictionary of markers with this name of its own, such as `DICT_4X4_50`."""
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


def marker_detector(dictionary: str) -> cv2.aruco.ArucoDetector:
    """What finds the markers of a dictionary, their corners to a fraction of a pixel."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    return cv2.aruco.ArucoDetector(aruco_dictionary(dictionary), parameters)


def radius_px(corners: FloatArray, squares: float) -> int:
    """How far around a board's corners `(N, 2)` to look, pixels: so many squares' sides."""
    apart = np.linalg.norm(corners[:, None] - corners, axis=2)
    np.fill_diagonal(apart, np.inf)
    side = float(np.quantile(apart.min(axis=1), 0.1))  # those far away or seen from the side are the smallest
    return int(np.clip(squares * side, _MIN_RADIUS_PX, _MAX_RADIUS_PX))


def grey_of(image: Image) -> Image:
    """A picture `(H, W, 3)` without its colours, `(H, W)`; one that has none as it is."""
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) if image.ndim == 3 else image, np.uint8)


_COMMON = ("DICT_4X4_1000", "DICT_5X5_1000", "DICT_6X6_1000", "DICT_7X7_1000", "DICT_ARUCO_ORIGINAL")


def why_no_markers(image: Image, dictionary: str, wanted: int) -> str:
    """Why fewer than so many markers of a dictionary are found in a picture, and what helps; in words."""
    grey = grey_of(image)

    def count(picture: Image, name: str) -> int:
        _, ids, _ = marker_detector(name).detectMarkers(picture)
        return 0 if ids is None else len(ids)

    here, mirrored = count(grey, dictionary), count(np.ascontiguousarray(grey[:, ::-1]), dictionary)
    if mirrored > 2 * here:  # now and then a mirrored marker is another one
        return "the picture is mirrored; switch the mirroring of the camera or its driver off"
    if here >= wanted > 1:
        return (
            f"all {wanted} markers are seen, but not where this board has them; are its squares counted right, and is "
            "it one board?"
        )
    if here:
        return f"only {here} of {wanted} markers are seen; show more of it, nearer and less slanted"
    others = {name: count(grey, name) for name in _COMMON if not dictionary.startswith(name[:8])}
    best = max(others, key=lambda name: others[name])
    if others[best]:
        family = best.rsplit("_", 1)[0]
        return f"no marker of {dictionary} is seen, but {others[best]} of {family}; is that what was printed?"
    return "no marker is seen; it may be too small, cut off, edge-on, blurred or in glare"
