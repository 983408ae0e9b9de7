"""A video file as a camera: every look is its next frame."""

from __future__ import annotations

import time
from dataclasses import replace

import cv2

from baggie.errors import CameraError
from baggie.types import Intrinsics, Observation
from baggie.workcell.cameras.opencv import decode, open_capture
from baggie.workcell.cameras.settings import CameraSettings


class VideoFile:
    """A `Camera` whose table is a film. Nobody has calibrated it."""

    def __init__(self, path: str, settings: CameraSettings) -> None:
        """Raises `CameraError` when nothing opens, or the film is of another size than asked for."""
        self.name = f"camera {path}"
        self.intrinsics: Intrinsics | None = None
        self._capture = open_capture(path, settings)
        width, height = (self._capture.get(p) for p in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
        self.size = (round(width), round(height))

    def look(self) -> Observation:
        """The next frame. Raises `CameraError` when the video is over."""
        if not self._capture.grab():
            raise CameraError(f"{self.name} gives no picture (any more): the video is over; open it again")
        return replace(decode(self._capture, self.name), intrinsics=self.intrinsics, time=time.time())

    def close(self) -> None:
        """Let go of the file."""
        self._capture.release()
