"""What all cameras that stream have in common: the newest picture, a limit to waiting, opening again what was lost.

Lenses that their makers describe in another way than OpenCV does.
"""

from __future__ import annotations

import atexit
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from statistics import median
from typing import Protocol

import numpy as np

from baggie.cameras.camera import CameraSettings
from baggie.errors import CameraError
from baggie.geometry import FloatArray
from baggie.types import Intrinsics, Observation

_GRID = 21
"""Rays looked along for each side of the picture."""


def fit_distortion(
    size: tuple[int, int], matrix: FloatArray, pixel: Callable[[FloatArray], FloatArray]
) -> Intrinsics:
    """OpenCV's k1, k2, p1, p2, k3 of a lens that is known by the pixels that see rays.

    `pixel` maps a ray (x/z, y/z) to (u, v). With the camera matrix given, the model is linear in its coefficients:

        x_d - x = x (k1 r² + k2 r⁴ + k3 r⁶) + p1 2xy + p2 (r² + 2x²)

    and likewise for y, so this is one least-squares problem over the whole picture.
    """
    width, height = size
    u, v = np.meshgrid(np.linspace(0, width - 1, _GRID), np.linspace(0, height - 1, _GRID))
    middle, focal = matrix[:2, 2], np.diag(matrix)[:2]
    rays = (np.c_[u.ravel(), v.ravel()] - middle) / focal
    seen = (np.array([pixel(ray) for ray in rays]) - middle) / focal
    x, y = rays.T
    r2 = x**2 + y**2
    terms_x = np.c_[x * r2, x * r2**2, 2 * x * y, r2 + 2 * x**2, x * r2**3]
    terms_y = np.c_[y * r2, y * r2**2, r2 + 2 * y**2, 2 * x * y, y * r2**3]
    terms, moved = np.r_[terms_x, terms_y], np.r_[seen[:, 0] - x, seen[:, 1] - y]
    coefficients = np.linalg.lstsq(terms, moved, rcond=None)[0]
    return Intrinsics(width, height, np.asarray(matrix, float), np.asarray(coefficients, float))


RETRY_S = 0.5
"""Between two tries to open a camera that was lost; a device takes about a second to come back after its plug does."""
_GRACE_S = 1.0
"""One more picture may come so late, to tell a camera that has frozen from one that is dead."""
_INTERVALS = 15
"""So many intervals between frames say what is usual."""


class Stream(Protocol):
    """An open device that delivers frame after frame. After a `CameraError` it is closed and another one is opened."""

    name: str
    """Of the camera, one line: kept in calibrations, shown in errors."""
    intrinsics: Intrinsics | None
    """The manufacturer's; None where it does not tell."""
    settings: CameraSettings
    """Those it was opened with, with the camera, exposure and white balance that it found in place of None."""

    def grab(self) -> None:
        """Wait for the next frame and keep it. Raises `CameraError` when none comes."""
        ...

    def retrieve(self) -> Observation:
        """The frame kept last, decoded. Raises `CameraError` when it cannot be used."""
        ...

    def close(self) -> None:
        """Let go of the device."""
        ...


class LiveCamera:
    """A `Camera` over a stream. A thread takes every frame, so that nothing old waits anywhere; it decodes only what
    somebody looks at.

    A picture counts as taken after the call when waiting for it began after the call, and when there *was* a wait: one
    that was there at once had been lying in a buffer since before. A picture that is the one before it over again, bit
    by bit, is none either: every sensor has noise, so the camera has frozen. A look therefore takes two.

    When the stream breaks off, the next look opens it again, and again, until its time is over.
    """

    def __init__(self, open_stream: Callable[[CameraSettings], Stream], settings: CameraSettings) -> None:
        """Raises `CameraError` when the stream does not open or delivers nothing."""
        self._open, self._timeout_s = open_stream, settings.timeout_s
        self._look = threading.Lock()
        self._changed = threading.Condition()
        self._asked: float | None = None  # when the look began that waits for a picture
        self._answer: Observation | None = None
        self._trouble: CameraError | None = None
        self._closed = False
        self._came = time.monotonic()
        stream = open_stream(settings)
        self.name, self.intrinsics = stream.name, stream.intrinsics
        self._settings = stream.settings  # the same camera, locked likewise, when it is opened again
        self._thread = threading.Thread(target=self._run, args=(stream,), name=self.name, daemon=True)
        self._thread.start()
        atexit.register(self.close)  # a thread inside a driver must not outlive the interpreter
        try:
            self.size = self._newest(time.monotonic() + self._timeout_s).size
        except CameraError:
            self.close()
            raise

    def look(self) -> Observation:
        """The newest picture, taken after the call; its time is when it came, seconds of the wall clock.

        Raises `CameraError` when none comes in time, or always the same, or one of another size.
        """
        with self._look:
            deadline = time.monotonic() + self._timeout_s
            before, observation = self._newest(deadline), self._newest(deadline)
            while np.array_equal(observation.color, before.color):
                if time.monotonic() > deadline:
                    raise CameraError(
                        f"{self.name} has frozen: it repeated one picture for {self._timeout_s:g} s; unplug it and "
                        "plug it in again, or restart what sends its stream"
                    )
                observation = self._newest(deadline + _GRACE_S)
            if observation.size != self.size:
                raise CameraError(
                    f"{self.name} used to give pictures of {self.size[0]} x {self.size[1]} pixels, now of "
                    f"{observation.size[0]} x {observation.size[1]}; set it back, or open it again"
                )
            return replace(observation, intrinsics=self.intrinsics)

    @property
    def frame_timeout_s(self) -> float:
        """A stream that is silent for longer is opened again."""
        return self._settings.frame_timeout_s

    def silent_s(self) -> float:
        """Seconds since the last frame came, whether somebody looked at it or not."""
        return time.monotonic() - self._came

    def close(self) -> None:
        """Let go of the camera; no look works any more."""
        atexit.unregister(self.close)
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        self._thread.join(self._timeout_s)  # a driver may have to finish waiting for its frame

    def _newest(self, deadline: float) -> Observation:
        with self._changed:
            self._asked, self._answer = time.monotonic(), None
            self._changed.notify_all()
            left = max(0.0, deadline - time.monotonic())
            self._changed.wait_for(lambda: self._answer is not None or self._closed, left)
            self._asked = None
            if self._answer is not None:
                return self._answer
            if self._closed:
                raise CameraError(f"{self.name} is closed; open it again")
            why = f" ({str(self._trouble).split(';')[0]})" if self._trouble else ""  # without its remedy
            raise CameraError(
                f"{self.name} gave no picture within {self._timeout_s:g} s{why}; check its cable and power, or raise "
                "timeout_s of the camera"
            )

    def _run(self, stream: Stream | None) -> None:
        """The thread: take frames, open again what broke off, until closed."""
        while not self._closed:
            try:
                stream = stream or self._open(self._settings)
                self._take_frames(stream)
            except CameraError as error:
                self._trouble = error
            if stream is not None:
                stream.close()
                stream = None
            with self._changed:
                self._changed.wait_for(lambda: self._closed, RETRY_S)
                self._changed.wait_for(lambda: self._closed or self._asked is not None)

    def _take_frames(self, stream: Stream) -> None:
        intervals: deque[float] = deque(maxlen=_INTERVALS)
        came = time.monotonic()
        while not self._closed:
            began, before = time.monotonic(), came
            stream.grab()
            self._came = came = time.monotonic()
            intervals.append(came - before)
            asked = self._asked
            if asked is None or began < asked or came - began < median(intervals) / 2:
                continue
            arrived = time.time()
            observation = replace(stream.retrieve(), time=arrived)
            with self._changed:
                if self._asked == asked:
                    self._asked, self._answer, self._trouble = None, observation, None
                    self._changed.notify_all()
