"""Intel RealSense (D400 and its relatives), through `pyrealsense2`: colour, and depth aligned to it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pyrealsense2 as rs

from baggie.calibration.intrinsics.camera_calibration import opencv_intrinsics
from baggie.cameras.camera import CameraSettings
from baggie.cameras.live import fit_distortion
from baggie.errors import CameraError
from baggie.geometry import FloatArray
from baggie.types import Intrinsics, Observation

_RECORDINGS = (".bag", ".db3")
_SETTLE_FRAMES = 30
"""So many frames automatic exposure and white balance have before they are locked."""


def open_stream(settings: CameraSettings) -> RealSenseStream:
    """Open the camera with the serial number `settings.source`, or the only one, or play a recording.

    Raises `CameraError` when there is none or it cannot be set so.
    """
    return RealSenseStream(settings)


class RealSenseStream:
    """The `Stream` of one opening of a camera or of a recording, which plays at the pace it was taken."""

    def __init__(self, settings: CameraSettings) -> None:
        self._timeout_ms = round(1000 * settings.frame_timeout_s)
        self._pipeline = rs.pipeline()
        self._frames: Any = None
        config, recorded = rs.config(), (settings.source or "").endswith(_RECORDINGS)
        if recorded:
            _play(config, str(settings.source))
        else:
            settings = settings.model_copy(update={"source": _find(settings.source or "")})
            config.enable_device(settings.source)
        profile = _start(self._pipeline, config, settings)
        self.name = f"RealSense {profile.get_device().get_info(rs.camera_info.serial_number)}"
        color = profile.get_stream(rs.stream.color).as_video_stream_profile()
        self.intrinsics: Intrinsics | None = to_intrinsics(color.get_intrinsics())
        self._align = rs.align(rs.stream.color)
        self.settings = settings
        if recorded:
            return  # nothing about it can be set any more
        try:
            for _ in range(_SETTLE_FRAMES if settings.lock else 0):
                self.grab()
            self.settings = lock(_color_sensor(profile.get_device()), settings, self.name)
        except CameraError:
            self.close()
            raise

    def grab(self) -> None:
        """Wait for the next pair of frames. Raises `CameraError` when none comes."""
        try:
            came, self._frames = self._pipeline.try_wait_for_frames(self._timeout_ms)
        except RuntimeError as error:
            raise CameraError(f"{self.name} broke off: {error}") from None
        if not came:
            raise CameraError(f"{self.name} delivers no frames any more")

    def retrieve(self) -> Observation:
        """Colour and depth of the same moment, the depth where the colour camera sees it.

        Raises `CameraError` when one of the two is missing.
        """
        aligned = self._align.process(self._frames)
        color, depth = aligned.get_color_frame(), aligned.get_depth_frame()
        if not color or not depth:
            raise CameraError(f"{self.name} delivers colour without depth")
        metres = np.asarray(depth.get_data(), np.float32) * np.float32(depth.get_units())
        return Observation(np.array(color.get_data(), np.uint8), metres)

    def close(self) -> None:
        """Let go of the camera."""
        self._pipeline.stop()


def lock(sensor: Any, settings: CameraSettings, name: str) -> CameraSettings:
    """Stop a colour sensor's automatic controls where they are, or at the values asked for.

    The settings with what was found in place of None. Raises `CameraError` for a value that the sensor does not take.
    """
    # Microseconds where colour comes from the depth sensor itself (D405), else UVC's 100 microseconds.
    per_ms = 1000.0 if sensor.is_depth_sensor() else 10.0
    found = {}
    for field, automatic, value, per_unit in (
        ("exposure_ms", rs.option.enable_auto_exposure, rs.option.exposure, per_ms),
        ("white_balance_k", rs.option.enable_auto_white_balance, rs.option.white_balance, 1.0),
    ):
        wanted = getattr(settings, field)
        if wanted is None and not (settings.lock and sensor.supports(automatic) and sensor.supports(value)):
            continue
        if not sensor.supports(value):
            raise CameraError(f"{name} has no {field} to set; take it out of the camera's settings")
        target = sensor.get_option(value) if wanted is None else wanted * per_unit
        limits = sensor.get_option_range(value)
        if not limits.min <= target <= limits.max:
            raise CameraError(
                f"expected {field} of {name} from {limits.min / per_unit:g} to {limits.max / per_unit:g}, got "
                f"{wanted:g}; change it in the camera's settings"
            )
        if sensor.supports(automatic):
            sensor.set_option(automatic, 0)
        sensor.set_option(value, target)
        found[field] = target / per_unit
    return settings.model_copy(update=found)


def to_intrinsics(lens: Any) -> Intrinsics:
    """A `pyrealsense2.intrinsics` in OpenCV's terms; a lens model that OpenCV has not is fitted with its five terms."""
    matrix = np.array([[lens.fx, 0, lens.ppx], [0, lens.fy, lens.ppy], [0, 0, 1]])
    size = lens.width, lens.height
    if lens.model in (rs.distortion.none, rs.distortion.brown_conrady) or not any(lens.coeffs):
        return opencv_intrinsics(size, matrix, lens.coeffs, "brown_conrady")

    # The other way round, from pixels to rays, a modified Brown-Conrady is left out without a word.
    def pixel(ray: FloatArray) -> FloatArray:
        return np.array(rs.rs2_project_point_to_pixel(lens, [*ray, 1.0]))

    return fit_distortion(size, matrix, pixel)


def _play(config: Any, path: str) -> None:
    if not Path(path).is_file():
        raise CameraError(f"no recording {path}; name a file that the RealSense Viewer recorded")
    config.enable_device_from_file(path, repeat_playback=False)


def _start(pipeline: Any, config: Any, settings: CameraSettings) -> Any:
    width, height = settings.size or (0, 0)
    rate = round(settings.fps or 0)
    config.enable_stream(rs.stream.color, width, height, rs.format.rgb8, rate)
    config.enable_stream(rs.stream.depth, 0, 0, rs.format.z16, rate)
    try:
        return pipeline.start(config)
    except RuntimeError as error:
        size = f"{width} x {height} pixels" if width else "any size"
        at = f" at {rate} per second" if rate else ""
        raise CameraError(
            f"expected RealSense {settings.source} to give depth, and colour of {size}{at}, got: {error}; ask for a "
            "size and rate it offers over this cable (the RealSense Viewer lists them), or leave them to it"
        ) from None


def _find(serial: str) -> str:
    try:
        serials = [device.get_info(rs.camera_info.serial_number) for device in rs.context().query_devices()]
    except RuntimeError as error:
        raise CameraError(f"the RealSense cameras cannot be listed: {error}; plug them in again") from None
    if serial and serial in serials:
        return serial
    if len(serials) == 1 and not serial:
        return str(serials[0])
    what = f"the RealSense camera {serial}" if serial else "one RealSense camera"
    if not serials:
        raise CameraError(f"expected {what}, found none; plug it in, into a USB 3 socket")
    raise CameraError(
        f"expected {what}, found {', '.join(serials)}; give one of these as the camera's source"
    )


def _color_sensor(device: Any) -> Any:
    for sensor in device.query_sensors():
        if any(profile.stream_type() == rs.stream.color for profile in sensor.get_stream_profiles()):
            return sensor
    raise CameraError("this RealSense camera has no colour sensor; take one that has")
