"""Orbbec, as far as it goes without a camera: frames and lenses of the SDK's own making."""

from __future__ import annotations

import time
from typing import Any
from unittest.mock import Mock, create_autospec

import numpy as np
import pytest

ob = pytest.importorskip(
    "pyorbbecsdk", reason='needs pyorbbecsdk: pip install ".[orbbec]"', exc_type=ImportError
)

from baggie.cameras import open_camera  # noqa: E402
from baggie.cameras.camera import CameraSettings  # noqa: E402
from baggie.cameras.orbbec import lock, to_intrinsics, to_observation  # noqa: E402
from baggie.errors import CalibrationError, CameraError  # noqa: E402 -- what comes next needs the package

SETTINGS = CameraSettings(kind="orbbec")
PROPERTY = ob.OBPropertyID


def test_with_none_plugged_in_it_says_so_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    context: Mock = create_autospec(ob.Context)
    context.return_value.query_devices.return_value.get_count.return_value = 0
    monkeypatch.setattr(ob, "Context", context)
    for settings in (SETTINGS, SETTINGS.model_copy(update={"source": "CL8"})):
        with pytest.raises(CameraError, match="found none; plug it in") as caught:
            open_camera(settings)
        assert "\n" not in str(caught.value)


def frame(kind: Any, units: np.ndarray) -> Mock:
    """Of 8 x 6 pixels, as the SDK gives them: bytes in a row."""
    made: Mock = create_autospec(kind, instance=True)
    made.get_width.return_value, made.get_height.return_value = 8, 6
    made.get_data.return_value = units.ravel().view(np.uint8)
    return made


def test_frames_become_colour_and_metres() -> None:
    rng = np.random.default_rng(0)
    picture = rng.integers(0, 255, (6, 8, 3), dtype=np.uint8)
    millimetres = rng.integers(0, 5000, (6, 8), dtype=np.uint16)
    depth = frame(ob.DepthFrame, millimetres)
    depth.get_depth_scale.return_value = 1.0
    seen = to_observation(frame(ob.ColorFrame, picture), depth)
    np.testing.assert_array_equal(seen.color, picture)
    assert seen.depth is not None
    assert seen.depth.dtype == np.float32
    np.testing.assert_allclose(seen.depth, millimetres / 1000, rtol=1e-6)


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


def test_lenses_are_told_in_opencvs_order() -> None:
    found = to_intrinsics(*a_lens())
    np.testing.assert_array_equal(found.matrix, [[745, 0, 641], [0, 744, 362], [0, 0, 1]])
    np.testing.assert_array_equal(found.distortion, np.arange(1, 9) / 8)


def test_a_lens_that_opencv_has_not_is_refused() -> None:
    distortion = Mock(**dict.fromkeys(("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"), 0.1))
    distortion.model.name = "KANNALA_BRANDT4"  # which pyorbbecsdk2 tells from 2.1 on
    with pytest.raises(CalibrationError, match="not supported"):
        to_intrinsics(ob.OBCameraIntrinsic(), distortion)


def test_exposure_and_white_balance_are_locked() -> None:
    device: Mock = create_autospec(ob.Device, instance=True)
    device.get_int_property_range.return_value = Mock(min=1, max=300)
    lock(device, SETTINGS.model_copy(update={"exposure_ms": 8}), "it")
    stopped = {call.args for call in device.set_bool_property.call_args_list}
    assert stopped == {
        (PROPERTY.OB_PROP_COLOR_AUTO_EXPOSURE_BOOL, False),
        (PROPERTY.OB_PROP_COLOR_AUTO_WHITE_BALANCE_BOOL, False),
    }
    device.set_int_property.assert_called_once_with(PROPERTY.OB_PROP_COLOR_EXPOSURE_INT, 80)
    with pytest.raises(CameraError, match=r"exposure_ms of it from 0\.1 to 30, got 31"):
        lock(device, SETTINGS.model_copy(update={"exposure_ms": 31}), "it")
