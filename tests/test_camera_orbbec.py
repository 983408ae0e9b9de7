"""Orbbec, as far as it goes without a camera: frames and lenses of the SDK's own making."""

from __future__ import annotations

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
from helpers.orbbec_camera import a_lens, frame  # noqa: E402

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
