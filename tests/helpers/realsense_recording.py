"""A RealSense recording for tests, made without a camera: the SDK's software device, recorded by the SDK itself."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

rs = pytest.importorskip(
    "pyrealsense2",
    reason='needs pyrealsense2 and its libusb: pip install ".[realsense]", sudo apt-get install libusb-1.0-0',
    exc_type=ImportError,
)

SERIAL = "0042"
SIZE = (320, 240)
FOCAL_PX = 300.0
DISTORTION = (0.1, 0.01, 0.002, -0.001, 0.0)
BASELINE_M = 0.05
"""The depth camera stands so far to the left of the colour camera."""
WALL_M = 1.5
"""What both cameras see: a wall, straight ahead."""


def lens(distortion: tuple[float, ...], model: Any = rs.distortion.brown_conrady) -> Any:
    """A `pyrealsense2.intrinsics`."""
    made = rs.intrinsics()
    made.width, made.height = SIZE
    made.fx = made.fy = FOCAL_PX
    made.ppx, made.ppy = 158.0, 121.0
    made.model, made.coeffs = model, list(distortion)
    return made


def _stream(kind: Any, form: Any, bytes_per_pixel: int, number: int, intrinsics: Any) -> Any:
    stream = rs.video_stream()
    stream.type, stream.fmt, stream.bpp, stream.uid, stream.index = kind, form, bytes_per_pixel, number, 0
    stream.width, stream.height = SIZE
    stream.fps, stream.intrinsics = 30, intrinsics
    return stream


def _frame(profile: Any, number: int, pixels: np.ndarray) -> Any:
    frame = rs.software_video_frame()
    frame.stride, frame.bpp = pixels.strides[0], pixels.strides[1]
    frame.timestamp, frame.frame_number = number * 1000 / 30, number
    frame.domain, frame.profile = rs.timestamp_domain.system_time, profile.as_video_stream_profile()
    frame.pixels = pixels
    return frame


def record(path: Path, frames: int) -> None:
    """Frame n is red n; the wall does not move."""
    device = rs.software_device()
    device.register_info(rs.camera_info.serial_number, SERIAL)
    device.register_info(rs.camera_info.name, "software")
    device.register_info(rs.camera_info.product_line, "D400")
    device.register_info(rs.camera_info.physical_port, "none")
    eye, depth_eye = device.add_sensor("RGB Camera"), device.add_sensor("Stereo Module")
    color = eye.add_video_stream(_stream(rs.stream.color, rs.format.rgb8, 3, 1, lens(DISTORTION)))
    depth = depth_eye.add_video_stream(_stream(rs.stream.depth, rs.format.z16, 2, 0, lens((0.0,) * 5)))
    depth_eye.add_read_only_option(rs.option.depth_units, 0.001)
    for one, other, shift in ((depth, color, -BASELINE_M), (color, depth, BASELINE_M)):
        extrinsics = rs.extrinsics()
        extrinsics.rotation, extrinsics.translation = [1, 0, 0, 0, 1, 0, 0, 0, 1], [shift, 0, 0]
        one.register_extrinsics_to(other, extrinsics)
    device.create_matcher(rs.matchers.default)
    recorder = rs.recorder(str(path), device)
    queue = rs.frame_queue(2)
    sensors = recorder.query_sensors()
    for sensor in sensors:
        sensor.open(sensor.get_stream_profiles()[0])
        sensor.start(queue)
    width, height = SIZE
    rng = np.random.default_rng(0)
    for number in range(1, frames + 1):
        red = rng.integers(0, 255, (height, width, 3)).astype(np.uint8)
        red[..., 0] = number
        eye.on_video_frame(_frame(color, number, red))
        wall = np.full((height, width), round(1000 * WALL_M), np.uint16)
        depth_eye.on_video_frame(_frame(depth, number, wall))
        time.sleep(0.005)
    time.sleep(0.3)
    for sensor in sensors:
        sensor.stop()
        sensor.close()
