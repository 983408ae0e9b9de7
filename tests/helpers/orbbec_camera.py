"""A stand-in for an Orbbec camera: frames and lenses of the SDK's own making, with nothing behind them."""

from __future__ import annotations

import time
from typing import Any
from unittest.mock import Mock, create_autospec

import numpy as np
import pyorbbecsdk as ob
import pytest


def frame(kind: Any, units: np.ndarray) -> Mock:
    """Of 8 x 6 pixels, as the SDK gives them: bytes in a row."""
    made: Mock = create_autospec(kind, instance=True)
    made.get_width.return_value, made.get_height.return_value = 8, 6
    made.get_data.return_value = units.ravel().view(np.uint8)
    return made


def a_lens() -> tuple[Any, Any]:
    """And its distortion."""
    lens, distortion = ob.OBCameraIntrinsic(), ob.OBCameraDistortion()
    lens.width, lens.height, lens.fx, lens.fy, lens.cx, lens.cy = 1280, 720, 745.0, 744.0, 641.0, 362.0
    for value, name in enumerate(("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"), start=1):
        setattr(distortion, name, value / 8)  # exact in single precision
    if hasattr(distortion, "model"):
        distortion.model = ob.OBCameraDistortionModel.BROWN_CONRADY_K6
    return lens, distortion


def plug_in(monkeypatch: pytest.MonkeyPatch) -> None:
    """One camera, whose pictures of 8 x 6 pixels are noise."""
    rng = np.random.default_rng(0)
    lens, distortion = a_lens()
    lens.width, lens.height, lens.cx, lens.cy = 8, 6, 4.0, 3.0
    device: Mock = create_autospec(ob.Device, instance=True)
    device.get_device_info.return_value.get_serial_number.return_value = "CL8"
    devices = Mock(**{"get_count.return_value": 1, "get_device_serial_number_by_index.return_value": "CL8"})
    devices.get_device_by_index.return_value = device
    profile = Mock(**{"get_intrinsic.return_value": lens, "get_distortion.return_value": distortion})
    pipeline: Mock = create_autospec(ob.Pipeline, instance=True)
    pipeline.get_stream_profile_list.return_value.get_video_stream_profile.return_value = profile

    def next_frames(_timeout_ms: int) -> Mock:
        time.sleep(0.02)
        depth = frame(ob.DepthFrame, np.full((6, 8), 1500, np.uint16))
        depth.get_depth_scale.return_value = 1.0
        color = frame(ob.ColorFrame, rng.integers(0, 255, (6, 8, 3), dtype=np.uint8))
        return Mock(**{"get_color_frame.return_value": color, "get_depth_frame.return_value": depth})

    pipeline.wait_for_frames.side_effect = next_frames
    aligned = Mock(process=lambda frames: Mock(as_frame_set=lambda: frames))
    monkeypatch.setattr(ob, "Context", Mock(**{"return_value.query_devices.return_value": devices}))
    monkeypatch.setattr(ob, "Pipeline", lambda _device: pipeline)
    monkeypatch.setattr(ob, "Config", Mock())
    monkeypatch.setattr(ob, "AlignFilter", lambda align_to_stream: aligned)
