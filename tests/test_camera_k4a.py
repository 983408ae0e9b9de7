"""Azure Kinect, as far as it goes without one: a stand-in held to the signatures of `pyk4a`."""

from __future__ import annotations

from collections.abc import Iterator
from unittest.mock import Mock

import numpy as np
import pytest

pyk4a = pytest.importorskip(
    "pyk4a",
    reason='needs the Azure Kinect Sensor SDK, which only Microsoft has; beside that: pip install ".[k4a]"',
    exc_type=ImportError,
)

from baggie.cameras import open_camera  # noqa: E402
from baggie.cameras.camera import (  # noqa: E402
    CameraSettings,
    OpenCamera,
    check_camera,
)
from baggie.errors import CameraError  # noqa: E402 -- what comes next needs the package
from helpers.k4a_camera import DISTORTION, a_capture, plug_in  # noqa: E402

SETTINGS = CameraSettings(kind="k4a", timeout_s=4.0)


@pytest.fixture
def device(monkeypatch: pytest.MonkeyPatch) -> Mock:
    return plug_in(monkeypatch)


@pytest.fixture
def camera(device: Mock) -> Iterator[OpenCamera]:
    camera = open_camera(SETTINGS)
    yield camera
    camera.close()


def test_with_none_plugged_in_it_says_so_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pyk4a, "connected_device_count", lambda: 0)
    with pytest.raises(CameraError, match="one Azure Kinect, found none that is free; plug it in") as caught:
        open_camera(SETTINGS)
    assert "\n" not in str(caught.value)


def test_it_keeps_the_contract(camera: OpenCamera) -> None:
    assert (camera.name, camera.size) == ("Azure Kinect 0001", (1280, 720))
    check_camera(camera)


def test_colour_depth_and_lens_are_ours(camera: OpenCamera, device: Mock) -> None:
    frame = a_capture()
    device.get_capture.side_effect = None
    device.get_capture.return_value = frame
    seen = camera.look()
    while seen.color[0, 0, 0] != frame.color[0, 0, 2]:
        seen = camera.look()
    np.testing.assert_array_equal(seen.color, frame.color[..., [2, 1, 0]])
    assert seen.depth is not None
    np.testing.assert_allclose(seen.depth, 1.5)
    assert seen.intrinsics is not None
    np.testing.assert_array_equal(seen.intrinsics.distortion, DISTORTION)


def test_it_is_locked_at_what_its_frames_were_taken_with(camera: OpenCamera, device: Mock) -> None:
    command, manual = pyk4a.ColorControlCommand, pyk4a.ColorControlMode.MANUAL
    set_ = [call.args for call in device._set_color_control.call_args_list]
    assert set_ == [
        (command.EXPOSURE_TIME_ABSOLUTE, 16670, manual),
        (command.WHITEBALANCE, 4500, manual),
    ]


def test_a_size_it_has_not_and_a_serial_it_has_not_are_refused(device: Mock) -> None:
    for change, message in (
        ({"size": (640, 480)}, "1280 x 720, .*got 640 x 480 at 30"),
        ({"source": "0002"}, "the Azure Kinect 0002, found 0001; give one of these"),
    ):
        with pytest.raises(CameraError, match=message):
            open_camera(SETTINGS.model_copy(update=change))
