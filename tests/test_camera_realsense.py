"""RealSense, as far as it goes without one: the SDK plays what its software device recorded."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from baggie.cameras import open_camera
from baggie.cameras.camera import CameraSettings, OpenCamera, check_camera
from baggie.errors import CameraError
from baggie.types import Intrinsics
from helpers.realsense_recording import (
    BASELINE_M,
    DISTORTION,
    FOCAL_PX,
    SERIAL,
    SIZE,
    WALL_M,
    lens,
    record,
    rs,
)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("realsense") / "wall.db3"
    record(path, frames=60)
    return path


@pytest.fixture
def camera(recording: Path) -> Iterator[OpenCamera]:
    camera = open_camera(CameraSettings(kind="realsense", source=str(recording), timeout_s=12.0))
    yield camera
    camera.close()


def test_it_keeps_the_contract_and_is_known_by_its_serial_number(camera: OpenCamera) -> None:
    assert (camera.name, camera.size) == (f"RealSense {SERIAL}", SIZE)
    check_camera(camera)


def test_depth_is_metres_where_the_colour_camera_sees_it(camera: OpenCamera) -> None:
    depth = camera.look().depth
    assert depth is not None
    np.testing.assert_allclose(depth[depth > 0], WALL_M, atol=1e-3)
    # The depth camera stands to the left: at its right edge the colour camera sees what nobody knows the depth of.
    columns = np.flatnonzero(depth[SIZE[1] // 2] > 0)
    unseen = BASELINE_M * FOCAL_PX / WALL_M
    assert columns.min() <= 2
    assert SIZE[0] - 1 - columns.max() == pytest.approx(unseen, abs=2)


def test_intrinsics_are_the_makers_in_opencvs_order(camera: OpenCamera) -> None:
    seen = camera.look().intrinsics
    assert isinstance(seen, Intrinsics)
    np.testing.assert_allclose(seen.matrix, [[FOCAL_PX, 0, 158], [0, FOCAL_PX, 121], [0, 0, 1]])
    np.testing.assert_allclose(seen.distortion, DISTORTION, rtol=1e-6)


@pytest.mark.slow
def test_a_recording_that_is_over_begins_again(camera: OpenCamera) -> None:
    reds = [int(camera.look().color[0, 0, 0]) for _ in range(45)]
    assert (np.diff(reds) < 0).any()


@pytest.mark.parametrize(
    "model", [rs.distortion.inverse_brown_conrady, rs.distortion.modified_brown_conrady], ids=str
)
def test_a_lens_model_that_opencv_has_not_sees_the_same_rays(model: Any) -> None:
    from baggie.cameras.realsense import to_intrinsics

    theirs = lens((-0.055, 0.065, 0.0004, -0.0006, -0.02), model)
    ours = to_intrinsics(theirs)
    pixels = np.stack(np.meshgrid(np.linspace(0, 319, 9), np.linspace(0, 239, 9)), -1).reshape(-1, 2)
    rays = np.c_[(pixels - ours.matrix[:2, 2]) / np.diag(ours.matrix)[:2], np.ones(len(pixels))]
    seen = [rs.rs2_project_point_to_pixel(theirs, list(ray)) for ray in rays]
    assert np.linalg.norm(seen - pixels, axis=1).max() > 1, "the lens is worth being known"
    np.testing.assert_allclose(ours.project(rays), seen, atol=0.05)


def sensor_with(*options: tuple[Any, float, float, float]) -> Any:
    sensor = rs.software_device().add_sensor("RGB Camera")
    for option, low, high, now in options:
        limits = rs.option_range()
        limits.min, limits.max, limits.step, limits.default = low, high, 1.0, now
        sensor.add_option(option, limits, True)
        sensor.set_option(option, now)
    return sensor


def test_exposure_and_white_balance_are_locked() -> None:
    from baggie.cameras.realsense import lock

    sensor = sensor_with(
        (rs.option.enable_auto_exposure, 0, 1, 1),
        (rs.option.exposure, 1, 10000, 156),
        (rs.option.enable_auto_white_balance, 0, 1, 1),
        (rs.option.white_balance, 2800, 6500, 4600),
    )
    found = lock(sensor, CameraSettings(kind="realsense", white_balance_k=5000), "it")
    assert (found.exposure_ms, found.white_balance_k) == (pytest.approx(15.6), 5000)
    assert sensor.get_option(rs.option.enable_auto_exposure) == 0
    assert sensor.get_option(rs.option.enable_auto_white_balance) == 0
    assert sensor.get_option(rs.option.exposure) == 156
    assert sensor.get_option(rs.option.white_balance) == 5000
    with pytest.raises(CameraError, match=r"exposure_ms of it from 0\.1 to 1000, got 2000"):
        lock(sensor, CameraSettings(kind="realsense", exposure_ms=2000), "it")


def test_what_is_not_there_or_not_offered_is_one_line(
    recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rs, "context", lambda: Mock(query_devices=list))  # whatever is plugged in here
    for settings, message in (
        (CameraSettings(kind="realsense"), "found none; plug it in, into a USB 3 socket"),
        (CameraSettings(kind="realsense", source="0815"), "the RealSense camera 0815, found none"),
        (CameraSettings(kind="realsense", source="nowhere.bag"), "no recording nowhere.bag"),
        (CameraSettings(kind="realsense", source=str(recording), size=(640, 480)), "colour of 640 x 480"),
    ):
        with pytest.raises(CameraError, match=message) as caught:
            open_camera(settings)
        assert "\n" not in str(caught.value)
