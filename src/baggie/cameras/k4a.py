"""Azure Kinect, through `pyk4a`: colour, and depth aligned to it."""

from __future__ import annotations

import contextlib

import numpy as np
import pyk4a
from pyk4a import CalibrationType, ColorControlCommand, ColorControlMode, ColorResolution

from baggie.cameras.camera import CameraSettings
from baggie.errors import CameraError
from baggie.types import Intrinsics, Observation

_SIZES = {
    (1280, 720): ColorResolution.RES_720P,
    (1920, 1080): ColorResolution.RES_1080P,
    (2560, 1440): ColorResolution.RES_1440P,
    (2048, 1536): ColorResolution.RES_1536P,
    (3840, 2160): ColorResolution.RES_2160P,
}
_RATES = {5: pyk4a.FPS.FPS_5, 15: pyk4a.FPS.FPS_15, 30: pyk4a.FPS.FPS_30}
_SETTLE_FRAMES = 30
"""So many frames automatic exposure and white balance have before they are locked."""


def open_stream(settings: CameraSettings) -> K4AStream:
    """Open the camera with the serial number `settings.source`, or the only one.

    Raises `CameraError` when there is none or it cannot be set so.
    """
    size, rate = settings.size or (1280, 720), settings.fps or 30
    if size not in _SIZES or rate not in _RATES:
        sizes = ", ".join(f"{width} x {height}" for width, height in _SIZES)
        raise CameraError(
            f"expected a size and rate of the Azure Kinect ({sizes}; 5, 15 or 30 per second), got "
            f"{size[0]} x {size[1]} at {rate:g}; change them in the camera's settings"
        )
    config = pyk4a.Config(color_resolution=_SIZES[size], camera_fps=_RATES[int(rate)])
    return K4AStream(_find(settings.source or "", config), settings)


class K4AStream:
    """The `Stream` of one opening of a camera."""

    def __init__(self, device: pyk4a.PyK4A, settings: CameraSettings) -> None:
        """`device`: open, not started."""
        self._device = device
        self.name = f"Azure Kinect {device.serial}"
        self._timeout_ms = round(1000 * settings.frame_timeout_s)
        self._capture: pyk4a.PyK4ACapture | None = None
        try:
            device.start()
            self.intrinsics: Intrinsics | None = to_intrinsics(device.calibration, settings)
            for _ in range(_SETTLE_FRAMES if settings.lock else 1):
                self.grab()
            self.settings = self._lock(settings)
        except (CameraError, pyk4a.K4AException) as error:
            self.close()
            raise CameraError(
                f"{self.name} does not start or is not set as asked ({error or type(error).__name__}); plug in "
                "its power supply and a USB 3 cable of its own, and check exposure_ms and white_balance_k"
            ) from None

    def grab(self) -> None:
        """Wait for the next pair of frames. Raises `CameraError` when none comes."""
        try:
            self._capture = self._device.get_capture(timeout=self._timeout_ms)
        except pyk4a.K4AException as error:
            raise CameraError(f"{self.name} delivers no frames any more ({type(error).__name__})") from None

    def retrieve(self) -> Observation:
        """Colour and depth of the same moment, the depth where the colour camera sees it.

        Raises `CameraError` when one of the two is missing.
        """
        assert self._capture is not None
        color, depth = self._capture.color, self._capture.transformed_depth
        if color is None or depth is None:
            raise CameraError(f"{self.name} delivers colour without depth")
        return to_observation(color, depth)

    def close(self) -> None:
        """Let go of the camera."""
        with contextlib.suppress(pyk4a.K4AException):  # unplugged, it has nothing left to stop
            self._device.stop() if self._device.is_running else self._device.close()

    def _lock(self, settings: CameraSettings) -> CameraSettings:
        """Stop the automatic controls where they are, or at the values asked for; the settings with these in them."""
        assert self._capture is not None
        exposure, white = settings.exposure_ms, settings.white_balance_k
        if settings.lock:  # each frame says what it was taken with
            exposure = exposure or self._capture.color_exposure_usec / 1000
            white = white or self._capture.color_white_balance
        for command, value in (
            (ColorControlCommand.EXPOSURE_TIME_ABSOLUTE, exposure and round(1000 * exposure)),
            (ColorControlCommand.WHITEBALANCE, white and round(white, -1)),  # in steps of ten
        ):
            if value is not None:
                self._device._set_color_control(command, value, ColorControlMode.MANUAL)
        return settings.model_copy(
            update={"source": self._device.serial, "exposure_ms": exposure, "white_balance_k": white}
        )


def to_observation(bgra: np.ndarray, depth_mm: np.ndarray) -> Observation:
    """`bgra`: `(H, W, 4)` uint8; `depth_mm`: `(H, W)` uint16, aligned to it, 0 where unknown."""
    return Observation(np.ascontiguousarray(bgra[..., 2::-1]), depth_mm.astype(np.float32) / np.float32(1000))


def to_intrinsics(calibration: pyk4a.Calibration, settings: CameraSettings) -> Intrinsics:
    """Of the colour camera; `pyk4a` gives OpenCV's eight rational coefficients."""
    width, height = settings.size or (1280, 720)
    matrix = calibration.get_camera_matrix(CalibrationType.COLOR)
    distortion = calibration.get_distortion_coefficients(CalibrationType.COLOR)
    return Intrinsics(width, height, np.asarray(matrix, float), np.asarray(distortion, float))


def _find(serial: str, config: pyk4a.Config) -> pyk4a.PyK4A:
    """The camera, open."""
    found = []
    for number in range(pyk4a.connected_device_count()):
        device = pyk4a.PyK4A(config, device_id=number)
        try:
            device.open()
        except pyk4a.K4AException:
            continue  # somebody else uses it
        found.append(device)
    chosen = [device for device in found if serial in {"", device.serial}]
    serials = ", ".join(device.serial for device in found)
    for device in found:
        if chosen != [device]:
            device.close()
    if len(chosen) == 1:
        return chosen[0]
    what = f"the Azure Kinect {serial}" if serial else "one Azure Kinect"
    if not found:
        raise CameraError(
            f"expected {what}, found none that is free; plug it in, with its power supply, and close what else uses it"
        )
    raise CameraError(f"expected {what}, found {serials}; give one of these as the camera's source")
