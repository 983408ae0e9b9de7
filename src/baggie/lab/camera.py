"""The lab's camera on the network: frames of the scene as it is now, one at a time, drawn only when somebody looks."""

from __future__ import annotations

import time
from collections.abc import Iterator

import cv2

from baggie.lab.lab import Lab

PERIOD_S = 0.2
LONGEST_PERIOD_S = 1.0
SHARE = 1 / 3
"""Of the time, which drawing may take on a slow computer: physics needs a processor, too."""
BUSY = 1.6
"""So many times longer are periods while the arm moves and nobody looks. Less than twice, or a client that knows this
rhythm takes the first frames of a faster one for old ones."""
_NAP_S = 0.02
_QUALITY = [
    cv2.IMWRITE_JPEG_QUALITY,
    97,
    cv2.IMWRITE_JPEG_SAMPLING_FACTOR,
    cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444,
]
"""Nearly all of the picture, and all of its colour."""


class LabCamera:
    """A stream of JPEGs, for as many clients as there are."""

    def __init__(self, lab: Lab) -> None:
        self._lab = lab
        self._last = b""
        self.heal()

    def freeze(self, seconds: float) -> None:
        """Repeat the last frame for so long."""
        self._frozen_until = time.monotonic() + seconds

    def unplug(self, seconds: float) -> None:
        """Be gone for so long."""
        self._gone_until = time.monotonic() + seconds

    def heal(self) -> None:
        """Work again."""
        self._frozen_until = self._gone_until = 0.0

    @property
    def is_there(self) -> bool:
        """Whether it is plugged in."""
        return time.monotonic() >= self._gone_until

    def frames(self) -> Iterator[bytes]:
        """JPEG files, each of the scene when it is asked for; until the lab closes or the camera is unplugged."""
        while not self._lab.closing and self.is_there:
            began = time.monotonic()
            frame = self._frame()
            period = min(max((time.monotonic() - began) / SHARE, PERIOD_S), LONGEST_PERIOD_S)
            yield frame
            while time.monotonic() - began < (BUSY * period if self._lab.busy else period):
                time.sleep(_NAP_S)

    def _frame(self) -> bytes:
        if not self._last or time.monotonic() >= self._frozen_until:
            picture = self._lab.darkroom.develop(self._lab.call(self._lab.moment))
            self._last = cv2.imencode(".jpg", cv2.cvtColor(picture, cv2.COLOR_RGB2BGR), _QUALITY)[1].tobytes()
        return self._last
