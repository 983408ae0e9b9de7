"""Notices that the camera or the table was bumped, before anything wrong is recorded or done.

Two eyes: the still background, against the picture that was taken when the workcell was calibrated; and, where there
is too little to see of it, how far from where they were let go objects are seen to lie, which drifts when the map
from the picture to the robot is no longer true.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from baggie.errors import BaggieError, BumpedError
from baggie.geometry import PlanarPose
from baggie.types import Image
from baggie.vision.drift import Landmarks

LIMIT_SHARE = 0.4 / 1280
"""Of the picture's width, by which its background may seem to move: 0.4 pixels of 1280 are half a millimetre on a table
seen from 0.8 m. Ordinary pictures stay below 0.2; of bumps along the grain of plain wood only half is seen."""
LANDINGS = 8
"""A drift of landings is judged over this many, by their median: soft things land 3 to 5 mm off, each another way."""
LANDING_LIMIT_M = 0.015
DENTED_LIMIT_M = 0.03
"""The same where the background is seen to stand still: a bag that was gripped aslant keeps its dents, and lands 2 cm
off every time. Camera and table would have to move together, away from the robot.
"""


class Watch:
    """Compares pictures taken with the arm out of the way with the one from when the workcell was calibrated."""

    def __init__(self, reference: Image) -> None:
        """`reference`: `(H, W, 3)`, the arm parked, of the same camera at the same size."""
        try:
            self._landmarks: Landmarks | None = Landmarks.find(reference)
        except BaggieError:  # a bare table: landings must do
            self._landmarks = None
        self._limit_px = LIMIT_SHARE * reference.shape[1]
        self._landings: deque[tuple[float, float]] = deque(maxlen=LANDINGS)

    def moved_px(self, picture: Image) -> float:
        """By how much the background has moved, pixels, median over the picture.

        Infinite where it is another one, 0 where there is too little to see of it to tell. Raises `BaggieError` for a
        picture of another size.
        """
        return self._landmarks.shift(picture).px if self._landmarks else 0.0

    def moved(self, picture: Image) -> bool:
        """Whether that is more than it may be."""
        return bool(self.moved_px(picture) > self._limit_px)

    def check(self, picture: Image) -> None:
        """Raise `BumpedError` when camera or table have moved."""
        px = self.moved_px(picture)
        if not px > self._limit_px:
            return
        what = (
            f"the background is {px:.1f} pixels from where it was when this workcell was calibrated (at most "
            f"{self._limit_px:.1f} are allowed)"
            if math.isfinite(px)
            else "the background is not the one this workcell was calibrated with (or the light is off)"
        )
        raise BumpedError(
            f"the camera or the table was bumped: {what}; put it back, or calibrate again and begin a new recording"
        )

    def landed(self, released: PlanarPose, seen: PlanarPose) -> None:
        """Take note of where an object was let go and where it is seen; raise `BumpedError` when these drift apart."""
        self._landings.append((seen.x - released.x, seen.y - released.y))
        off = float(np.linalg.norm(np.median(self._landings, axis=0)))
        limit_m = DENTED_LIMIT_M if self._landmarks else LANDING_LIMIT_M
        if len(self._landings) == LANDINGS and off > limit_m:
            raise BumpedError(
                f"the last {LANDINGS} objects are seen {1000 * off:.0f} mm from where they were let go, all the same "
                "way: the camera or the table was bumped; calibrate again and begin a new recording"
            )
