"""Any camera OpenCV opens: USB, V4L2, a network stream, or a video file."""

from __future__ import annotations

import time

import cv2
import numpy as np

from baggie.errors import CameraError
from baggie.types import Intrinsics, Observation

_STALE_FRAMES = 4
"""Frames a driver may have kept from before; they are passed over."""


class OpenCVCamera:
    """A colour camera without depth; nobody has calibrated it."""

    def __init__(self, source: str) -> None:
        """Open a camera by number, device, address or file. Raises `CameraError` when nothing opens."""
        self.name = f"camera {source}"
        self.intrinsics: Intrinsics | None = None
        number = int(source) if source.isdigit() else None
        self._live = number is not None or source.startswith(("/dev/", "rtsp://", "http://", "https://"))
        cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # we say it in one line ourselves
        self._capture = cv2.VideoCapture(source if number is None else number)
        if not self._capture.isOpened():
            raise CameraError(
                f"no camera or video opens as {source!r}; give the number of a camera that is plugged in, such as 0, "
                "a device, the address of a stream, or a video file"
            )
        width, height = (self._capture.get(p) for p in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
        self.size = (round(width), round(height))

    def look(self) -> Observation:
        """The next frame. Raises `CameraError` when none comes: unplugged, or the video is over."""
        for _ in range(_STALE_FRAMES if self._live else 0):
            self._capture.grab()
        got, picture = self._capture.read()
        if not got:
            raise CameraError(
                f"{self.name} gives no picture (any more); check its cable, or the video is over"
            )
        color = np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB), np.uint8)
        return Observation(color, None, self.intrinsics, time.time())

    def close(self) -> None:
        """Let go of the camera."""
        self._capture.release()
