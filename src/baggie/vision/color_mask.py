"""Find one evenly coloured object in a picture by its colour: the eye of the published system.

One pass with the colour as given finds the object (`hue.py` says how); a second, with the colour it has in
*this* light, draws its outline half way to its surroundings.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from baggie.geometry import FloatArray, wrap_angle
from baggie.types import Image
from baggie.vision import hue
from baggie.vision.hue import Mask

_MIN_AREA = 4e-4
_MAX_AREA = 0.25
"""Of the picture: a marker 4 cm across, 1 m from a camera that sees 1.8 m of table; a bag right under it."""
_MIN_FILL = 0.6
_MAX_ASPECT = 2.5


@dataclass(frozen=True)
class Detection:
    """An object found in a picture; pixels are (u, v) with centres at integers."""

    center: FloatArray
    """`(2,)`, centroid of the mask, sub-pixel."""
    yaw: float
    """Angle of an edge from the u axis towards v, radians, modulo a quarter turn: in [-pi/4, pi/4)."""
    corners: FloatArray
    """`(4, 2)`, of the rectangle of least area around the mask."""
    area_px: float
    confidence: float
    """In [0, 1]: how well the blob fills its rectangle and keeps to one colour; halved at the picture's
    edge."""
    mask: Mask
    """`(H, W)`, True on the object."""


def find_bag(image: Image, color: tuple[int, int, int]) -> Detection | None:
    """The largest plausible blob of a colour, or None.

    `color` is the object's RGB colour in ordinary light. Raises `BaggieError` when it is grey, so that no hue
    tells the object from the table.
    """
    reference = hue.reference_of(color, "object")
    small, factor = hue.shrunk(image)
    chroma = hue.chroma_of(small)
    alike = hue.likeness(chroma, reference) > hue.FIRST_THRESHOLD
    first = _largest_blob(alike, small.shape[0] * small.shape[1])
    if first is None:
        return None
    seen = np.median(chroma[hue.inside(first)], axis=0)
    window = hue.window(first, factor, image.shape)
    likeness = hue.likeness(hue.chroma_of(image[window]), seen)
    blob = _largest_blob(likeness > hue.half_way(chroma, first, seen), image.shape[0] * image.shape[1])
    if blob is None:
        return None
    match = float(np.clip(likeness[blob].mean(), 0.0, 1.0))
    mask = np.zeros(image.shape[:2], bool)
    mask[window] = blob
    return _describe(mask, match)


def _largest_blob(mask: Mask, picture_px: int) -> Mask | None:
    """The largest connected part that could be a bag, by its shape and size in a picture of `picture_px`."""
    for blob, area in hue.blobs(mask, _MIN_AREA * picture_px):
        _, (a, b), _ = cv2.minAreaRect(hue.outline(blob))
        square_enough = max(a, b) <= _MAX_ASPECT * max(min(a, b), 1.0)
        if area <= _MAX_AREA * picture_px and square_enough and area >= _MIN_FILL * a * b:
            return blob
    return None


def _describe(blob: Mask, match: float) -> Detection:
    moments = cv2.moments(blob.astype(np.uint8), binaryImage=True)
    area = moments["m00"]
    center = np.array([moments["m10"] / area, moments["m01"] / area])
    rectangle = cv2.minAreaRect(hue.outline(blob))
    _, (a, b), degrees = rectangle
    fill = min(1.0, area / max((a + 1) * (b + 1), 1.0))
    cut = blob[0].any() or blob[-1].any() or blob[:, 0].any() or blob[:, -1].any()
    return Detection(
        center=center,
        yaw=wrap_angle(np.deg2rad(degrees), np.pi / 2),
        corners=np.asarray(cv2.boxPoints(rectangle), float),
        area_px=float(area),
        confidence=fill * match * (0.5 if cut else 1.0),
        mask=blob,
    )
