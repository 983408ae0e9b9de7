"""Any camera that OpenCV opens, here a video file, and calibrating from one."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from baggie.calibration.intrinsics.camera_calibration import CameraCalibration
from baggie.cli import main
from baggie.errors import CameraError
from baggie.types import Intrinsics
from baggie.vision.targets import parse_target
from baggie.workcell.camera import Camera
from baggie.workcell.opencv_camera import OpenCVCamera
from board_pictures import random_pose, render_board

LENS = Intrinsics(
    640, 480, np.array([[520.0, 0, 322], [0, 521, 238], [0, 0, 1]]), np.array([0.05, 0, 0, 0, 0])
)
BOARD = "charuco:7x5:0.030:0.021:DICT_4X4_50"


@pytest.fixture(scope="module")
def video(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Somebody shows a board here and there."""
    path = tmp_path_factory.mktemp("video") / "board.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 10, (640, 480))
    rng, board = np.random.default_rng(0), parse_target(BOARD)
    for _ in range(14):
        writer.write(render_board(board, random_pose(board, LENS, rng), LENS, rng)[..., ::-1])
    writer.release()
    return path


def test_frames_come_one_after_the_other_until_the_video_is_over(video: Path) -> None:
    camera = OpenCVCamera(str(video))
    assert isinstance(camera, Camera)
    assert camera.size == (640, 480)
    first, second = camera.look(), camera.look()
    assert first.color.shape == (480, 640, 3)
    assert not np.array_equal(first.color, second.color)
    for _ in range(12):
        camera.look()
    with pytest.raises(CameraError, match="over"):
        camera.look()
    camera.close()


def test_what_is_no_camera_is_one_line() -> None:
    for source in ("7", "nowhere.mp4"):
        with pytest.raises(CameraError, match="no camera or video"):
            OpenCVCamera(source)


def test_intrinsics_from_a_camera_alone(video: Path, tmp_path: Path) -> None:
    out = tmp_path / "camera.yaml"
    assert main(["calibrate", "intrinsics", "--camera", str(video), "--board", BOARD, "--out", str(out)]) == 0
    found = CameraCalibration.load(out)
    assert found.camera.size == (640, 480)
    np.testing.assert_allclose(found.intrinsics.matrix, LENS.matrix, atol=4.0)
    assert len(list((tmp_path / "camera").glob("*.png"))) == len(found.views) + len(found.dropped)
    assert (
        main(["calibrate", "image-to-robot", "--camera", str(video), "--out", str(tmp_path / "map.yaml")])
        == 1
    )
