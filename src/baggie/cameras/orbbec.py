"""Orbbec Femto (Bolt, Mega), through `pyorbbecsdk`: colour, and depth aligned to it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pyorbbecsdk as ob

from baggie.calibration.intrinsics.camera_calibration import opencv_intrinsics
from baggie.cameras.camera import CameraSettings
from baggie.errors import CameraError
from baggie.types import Intrinsics, Observation

_ERRORS = (ob.OBError, RuntimeError)
_SETTLE_FRAMES = 30
"""So many frames automatic exposure and white balance have before they are locked."""
_CONTROLS = (
    (
        "exposure_ms",
        ob.OBPropertyID.OB_PROP_COLOR_AUTO_EXPOSURE_BOOL,
        ob.OBPropertyID.OB_PROP_COLOR_EXPOSURE_INT,
        10,  # the Femto counts in 100 microseconds
    ),
    (
        "white_balance_k",
        ob.OBPropertyID.OB_PROP_COLOR_AUTO_WHITE_BALANCE_BOOL,
        ob.OBPropertyID.OB_PROP_COLOR_WHITE_BALANCE_INT,
        1,
    ),
)


def open_stream(settings: CameraSettings) -> OrbbecStream:
    """Open the camera with the serial number `settings.source`, or the only one.

    Raises `CameraError` when there is none or it cannot be set so.
    """
    ob.Context.set_logger_level(ob.OBLogLevel.NONE)  # we say it in one line ourselves
    try:
        return OrbbecStream(_find(settings.source or ""), settings)
    except _ERRORS as error:
        raise CameraError(
            f"the Orbbec camera does not open: {error}; ask for a size and rate it offers (OrbbecViewer lists "
            "them), and close whatever else uses it"
        ) from None


class OrbbecStream:
    """The `Stream` of one opening of a camera."""

    def __init__(self, device: Any, settings: CameraSettings) -> None:
        serial = device.get_device_info().get_serial_number()
        self.name = f"Orbbec {serial}"
        self._timeout_ms = round(1000 * settings.frame_timeout_s)
        self._pipeline = ob.Pipeline(device)
        width, height = settings.size or (0, 0)
        rate = round(settings.fps or 0)
        colors = self._pipeline.get_stream_profile_list(ob.OBSensorType.COLOR_SENSOR)
        color = colors.get_video_stream_profile(width, height, ob.OBFormat.RGB, rate)
        depths = self._pipeline.get_stream_profile_list(ob.OBSensorType.DEPTH_SENSOR)
        config = ob.Config()
        config.enable_stream(color)
        config.enable_stream(depths.get_default_video_stream_profile())
        config.set_frame_aggregate_output_mode(ob.OBFrameAggregateOutputMode.FULL_FRAME_REQUIRE)
        self._pipeline.enable_frame_sync()
        self._pipeline.start(config)
        self._align = ob.AlignFilter(align_to_stream=ob.OBStreamType.COLOR_STREAM)
        self._frames: Any = None
        self.intrinsics: Intrinsics | None = to_intrinsics(color.get_intrinsic(), color.get_distortion())
        self.settings = settings.model_copy(update={"source": serial})
        try:
            for _ in range(_SETTLE_FRAMES if settings.lock else 0):
                self.grab()
            lock(device, settings, self.name)
        except (CameraError, *_ERRORS):
            self.close()
            raise

    def grab(self) -> None:
        """Wait for the next pair of frames. Raises `CameraError` when none comes."""
        try:
            self._frames = self._pipeline.wait_for_frames(self._timeout_ms)
        except _ERRORS as error:
            raise CameraError(f"{self.name} broke off: {error}") from None
        if not self._frames:
            raise CameraError(f"{self.name} delivers no frames any more")

    def retrieve(self) -> Observation:
        """Colour and depth of the same moment, the depth where the colour camera sees it.

        Raises `CameraError` when one of the two is missing.
        """
        try:
            aligned = self._align.process(self._frames)
        except _ERRORS as error:
            raise CameraError(f"depth of {self.name} cannot be aligned to colour: {error}") from None
        frames = aligned.as_frame_set() if aligned else None
        color, depth = (frames.get_color_frame(), frames.get_depth_frame()) if frames else (None, None)
        if not color or not depth:
            raise CameraError(f"{self.name} delivers colour without depth")
        return to_observation(color, depth)

    def close(self) -> None:
        """Let go of the camera."""
        self._pipeline.stop()


def to_observation(color: Any, depth: Any) -> Observation:
    """A colour frame in RGB and a depth frame of the same size."""
    picture = np.array(color.get_data(), np.uint8).reshape(color.get_height(), color.get_width(), 3)
    units = np.frombuffer(depth.get_data(), np.uint16).reshape(depth.get_height(), depth.get_width())
    return Observation(picture, units.astype(np.float32) * np.float32(depth.get_depth_scale() / 1000))


def to_intrinsics(lens: Any, distortion: Any) -> Intrinsics:
    """An `OBCameraIntrinsic` and an `OBCameraDistortion` in OpenCV's order.

    Raises `CalibrationError` where its lens model is not OpenCV's.
    """
    d = distortion
    matrix = np.array([[lens.fx, 0, lens.cx], [0, lens.fy, lens.cy], [0, 0, 1]])
    coefficients = [d.k1, d.k2, d.p1, d.p2, d.k3, d.k4, d.k5, d.k6]
    model = (
        d.model.name if hasattr(d, "model") else "brown_conrady_k6"
    )  # 2.0 does not say; the Femto's is this one
    return opencv_intrinsics((lens.width, lens.height), matrix, coefficients, model)


def lock(device: Any, settings: CameraSettings, name: str) -> None:
    """Stop the automatic controls where they are, or at the values asked for; what they had found it does not tell.

    Raises `CameraError` for a value that the camera does not take.
    """
    may_write = ob.OBPermissionType.PERMISSION_WRITE
    for field, automatic, value, per_unit in _CONTROLS:
        wanted = getattr(settings, field)
        if wanted is None and not settings.lock:
            continue
        if device.is_property_supported(automatic, may_write):
            device.set_bool_property(automatic, False)
        if wanted is None:
            continue
        limits = device.get_int_property_range(value)
        if not limits.min <= wanted * per_unit <= limits.max:
            raise CameraError(
                f"expected {field} of {name} from {limits.min / per_unit:g} to {limits.max / per_unit:g}, got "
                f"{wanted:g}; change it in the camera's settings"
            )
        device.set_int_property(value, round(wanted * per_unit))


def _find(serial: str) -> Any:
    devices = ob.Context().query_devices()
    serials = [devices.get_device_serial_number_by_index(i) for i in range(devices.get_count())]
    if serial and serial in serials:
        return devices.get_device_by_serial_number(serial)
    if len(serials) == 1 and not serial:
        return devices.get_device_by_index(0)
    what = f"the Orbbec camera {serial}" if serial else "one Orbbec camera"
    if not serials:
        raise CameraError(f"expected {what}, found none; plug it in, with its own power supply")
    raise CameraError(
        f"expected {what}, found {', '.join(serials)}; give one of these as the camera's source"
    )
