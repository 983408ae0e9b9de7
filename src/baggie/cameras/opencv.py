"""Any camera OpenCV opens: USB, V4L2, or a network stream (RTSP, MJPEG over HTTP).

A video file as a camera: every look is its next frame.
"""

from __future__ import annotations

import os
import re
import time
from dataclasses import dataclass, replace

import cv2
import numpy as np

from baggie.cameras.camera import CameraSettings
from baggie.errors import CameraError
from baggie.types import Intrinsics, Observation

_SETTLE_S = 1.0
"""So long automatic exposure and white balance have before they are locked."""


@dataclass(frozen=True)
class _Control:
    """Something V4L2 sets by itself or lets us set."""

    name: str
    automatic: int
    manual: float
    """What `automatic` is set to for it to stop."""
    value: int
    per_unit: float
    """The driver's units in one of ours."""


_EXPOSURE = _Control("exposure_ms", cv2.CAP_PROP_AUTO_EXPOSURE, 1, cv2.CAP_PROP_EXPOSURE, 10)
_WHITE = _Control("white_balance_k", cv2.CAP_PROP_AUTO_WB, 0, cv2.CAP_PROP_WB_TEMPERATURE, 1)


def is_live(source: str) -> bool:
    """Whether it is a camera that goes on by itself, and not a file."""
    return source.isdigit() or source.startswith(("/dev/", "rtsp://", "http://", "https://"))


def without_password(source: str) -> str:
    """An address fit to be shown and kept."""
    return re.sub("//[^/@]*@", "//", source)


def open_capture(source: str, settings: CameraSettings) -> cv2.VideoCapture:
    """OpenCV's capture, with size and rate as asked for. Raises `CameraError` where it does not open or not so."""
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # we say it in one line ourselves
    os.environ.setdefault(
        "OPENCV_FFMPEG_LOGLEVEL", "-8"
    )  # and so does FFmpeg, which OpenCV opens streams with
    if "://" in source:
        opening, reading = round(1000 * settings.timeout_s), round(1000 * settings.frame_timeout_s)
        limits = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, opening, cv2.CAP_PROP_READ_TIMEOUT_MSEC, reading]
        # With more threads the decoder hands out a frame only when it has that many newer ones.
        capture = cv2.VideoCapture(source, cv2.CAP_FFMPEG, [*limits, cv2.CAP_PROP_N_THREADS, 1])
    else:
        capture = cv2.VideoCapture(int(source) if source.isdigit() else source)
    capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)  # a lens is calibrated in the sensor's own rows and columns
    if not capture.isOpened():
        raise CameraError(
            f"no camera or video opens as {without_password(source)!r}; give the number of a camera that is plugged "
            "in, such as 0, a device, the address of a stream, or a video file"
        )
    try:
        _request(capture, settings, without_password(source))
    except CameraError:
        capture.release()
        raise
    return capture


def _request(capture: cv2.VideoCapture, settings: CameraSettings, source: str) -> None:
    wanted: dict[int, float] = {}
    if settings.size is not None:
        wanted[cv2.CAP_PROP_FRAME_WIDTH], wanted[cv2.CAP_PROP_FRAME_HEIGHT] = settings.size
    if settings.fps is not None:
        wanted[cv2.CAP_PROP_FPS] = settings.fps

    def honoured() -> bool:
        return all(abs(capture.get(name) - value) < 0.5 for name, value in wanted.items())

    for compressed in (False, True):
        if honoured():
            return
        if compressed:  # large raw pictures do not fit through USB 2 at full rate
            capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*"MJPG"))
        for name, value in wanted.items():
            capture.set(name, value)
    if honoured():
        return
    size = [round(capture.get(name)) for name in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)]
    asked = [f"{settings.size[0]} x {settings.size[1]} pixels"] if settings.size else []
    asked += [f"{settings.fps:g} pictures per second"] if settings.fps else []
    raise CameraError(
        f"expected camera {source} to give {' at '.join(asked)}, got {size[0]} x {size[1]} at "
        f"{capture.get(cv2.CAP_PROP_FPS):g}; ask for what it offers, or leave size and fps to it"
    )


def decode(capture: cv2.VideoCapture, name: str) -> Observation:
    """The frame grabbed last. Raises `CameraError` when it is damaged."""
    got, picture = capture.retrieve()
    if not got:
        raise CameraError(f"{name} delivers frames that cannot be decoded")
    return Observation(np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB), np.uint8))


class OpenCVStream:
    """The `Stream` of one opening of a camera. Nobody has calibrated it."""

    intrinsics: Intrinsics | None = None

    def __init__(self, settings: CameraSettings) -> None:
        """Raises `CameraError` when it does not open, or cannot be set as asked for."""
        source = settings.source or "0"
        self.name = f"camera {without_password(source)}"
        self._capture = open_capture(source, settings)
        try:
            self.settings = self._lock(settings)
        except CameraError:
            self.close()
            raise

    def grab(self) -> None:
        """Wait for the next frame. Raises `CameraError` when none comes."""
        if not self._capture.grab():
            raise CameraError(f"{self.name} delivers no frames any more")

    def retrieve(self) -> Observation:
        """The frame grabbed last. Raises `CameraError` when it is damaged."""
        return decode(self._capture, self.name)

    def close(self) -> None:
        """Let go of the camera."""
        self._capture.release()

    def _lock(self, settings: CameraSettings) -> CameraSettings:
        """Lock what is to be locked; the settings, with what was found in place of None."""
        values = {control: getattr(settings, control.name) for control in (_EXPOSURE, _WHITE)}
        if self._capture.getBackendName() != "V4L2":
            for control, value in values.items():
                self._check(value is None, control, value)
            return settings
        if settings.lock and None in values.values():
            end = time.monotonic() + _SETTLE_S
            while time.monotonic() < end:
                self.grab()
        found = {}
        for control, value in values.items():
            if value is not None or settings.lock:
                found[control.name] = self._set(control, value)
        return settings.model_copy(update=found)

    def _set(self, control: _Control, wanted: float | None) -> float | None:
        """Stop an automatic control, at `wanted` or where it is; the value, None where it cannot be told."""
        capture = self._capture
        now = capture.get(control.value) / control.per_unit
        capture.set(control.automatic, control.manual)
        value = now if wanted is None else wanted
        done = value > 0 and capture.set(control.value, round(value * control.per_unit))
        done = done and abs(capture.get(control.value) / control.per_unit - value) <= 0.05 * value
        self._check(done or wanted is None, control, wanted)
        return value if done else None

    def _check(self, done: bool, control: _Control, wanted: float | None) -> None:
        if not done:
            raise CameraError(
                f"expected {self.name} to keep {control.name} at {wanted:g}, but its driver does not take that; "
                f"take {control.name} out of the camera's settings, or give a value it offers"
            )


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
