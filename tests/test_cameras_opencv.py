"""Any camera that OpenCV opens: video files, MJPEG over HTTP, a driver that obeys or does not; calibrating from one."""

from __future__ import annotations

import struct
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from baggie.calibration.intrinsics.camera_calibration import CameraCalibration
from baggie.cameras import open_camera
from baggie.cameras.camera import CameraSettings, OpenCamera, check_camera
from baggie.cli.main import main
from baggie.errors import CameraError
from baggie.pictures import read_pictures
from baggie.types import Intrinsics
from baggie.vision.targets import parse_target
from helpers.board_pictures import random_pose, render_board
from helpers.mjpeg_server import SIZE, MjpegServer, number_in

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


def open_opencv(source: str, **settings: Any) -> OpenCamera:
    return open_camera(CameraSettings(source=source, **settings))


def test_frames_come_one_after_the_other_until_the_video_is_over(video: Path) -> None:
    camera = open_opencv(str(video))
    assert camera.size == (640, 480)
    check_camera(camera)
    for _ in range(12):
        camera.look()
    with pytest.raises(CameraError, match="over"):
        camera.look()
    camera.close()


def test_a_film_with_a_rotation_mark_shows_the_sensors_own_rows_live_as_from_a_folder(tmp_path: Path) -> None:
    path = tmp_path / "upright.mp4"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), 10, (64, 48))
    for value in (50, 100, 150):
        writer.write(np.full((48, 64, 3), value, np.uint8))
    writer.release()
    one, straight = 1 << 16, struct.Struct(">9i")  # ISO/IEC 14496-12: a matrix in each track's header
    content = path.read_bytes()
    upright, turned = (
        straight.pack(*numbers, 0, 0, 1 << 30)
        for numbers in ((one, 0, 0, 0, one, 0), (0, one, 0, -one, 0, 0))
    )
    track = content.index(b"tkhd")
    path.write_bytes(content[:track] + content[track:].replace(upright, turned, 1))
    as_film = cv2.VideoCapture(str(path)).read()[1]
    assert as_film.shape == (64, 48, 3), "OpenCV turns it unless told otherwise"
    live = open_opencv(str(path))
    assert live.size == (64, 48)
    assert live.look().color.shape == (48, 64, 3)
    live.close()
    assert {picture.shape for _, picture in read_pictures(path)} == {(48, 64, 3)}


def test_what_is_no_camera_is_one_line() -> None:
    for source in ("7", "nowhere.mp4", "http://user:secret@127.0.0.1:9/x"):
        with pytest.raises(CameraError, match="no camera or video") as caught:
            open_opencv(source)
        assert "secret" not in str(caught.value)


def test_a_size_that_does_not_come_is_refused(video: Path, server: MjpegServer) -> None:
    for source in (str(video), server.address):
        with pytest.raises(CameraError, match="to give 800 x 600 pixels at 15 pictures per second, got"):
            open_opencv(source, size=(800, 600), fps=15)
    camera = open_opencv(str(video), size=(640, 480), fps=10)
    assert camera.look().size == (640, 480)
    camera.close()


@pytest.fixture
def server() -> Iterator[MjpegServer]:
    server = MjpegServer()
    yield server
    server.mode = "run"
    server.go_away()


@pytest.fixture
def network(server: MjpegServer) -> Iterator[OpenCamera]:
    camera = open_opencv(server.address, timeout_s=4.0)
    yield camera
    camera.close()


def test_a_network_camera_keeps_the_contract(network: OpenCamera) -> None:
    assert network.size == SIZE
    check_camera(network)


def test_pictures_are_taken_after_the_call_however_long_nobody_looked(
    network: OpenCamera, server: MjpegServer
) -> None:
    for pause in (0.0, 0.0, 0.5, 0.01):
        time.sleep(pause)
        called = time.monotonic()
        assert server.made_at[number_in(network.look().color)] > called


@pytest.mark.slow
def test_a_network_camera_that_hangs_or_repeats_itself_is_noticed_and_comes_back(
    network: OpenCamera, server: MjpegServer
) -> None:
    network.look()
    server.mode = "hang"
    with pytest.raises(CameraError, match="no picture within 4 s"):
        network.look()
    server.repeat()
    with pytest.raises(CameraError, match="has frozen"):
        [network.look() for _ in range(2)]  # the first may still see it change
    server.mode = "run"
    called = time.monotonic()
    assert server.made_at[number_in(network.look().color)] > called


@pytest.mark.slow
def test_a_dropped_connection_is_opened_again(network: OpenCamera, server: MjpegServer) -> None:
    network.look()
    server.go_away()
    with pytest.raises(CameraError, match="no picture within 4 s"):
        network.look()
    threading.Timer(0.5, server.come_back).start()
    called = time.monotonic()
    assert server.made_at[number_in(network.look().color)] > called
    assert server.connections == 2


class Driver:
    """A `cv2.VideoCapture` over V4L2 as its drivers are: it takes what it knows, in its own units, and says so.

    Its automatic controls settle at 21 ms and 3900 K.
    """

    def __init__(
        self, *, sizes: tuple[tuple[int, int], ...] = ((640, 480),), fast_when_compressed: bool = False
    ):
        self.sizes, self.fast_when_compressed = sizes, fast_when_compressed
        self.values = {
            cv2.CAP_PROP_FRAME_WIDTH: 640.0,
            cv2.CAP_PROP_FRAME_HEIGHT: 480.0,
            cv2.CAP_PROP_FPS: 10.0 if fast_when_compressed else 30.0,
            cv2.CAP_PROP_AUTO_EXPOSURE: 3.0,
            cv2.CAP_PROP_EXPOSURE: 210.0,
            cv2.CAP_PROP_AUTO_WB: 1.0,
            cv2.CAP_PROP_WB_TEMPERATURE: 3900.0,
        }
        self._rng = np.random.default_rng(0)

    def isOpened(self) -> bool:
        return True

    def getBackendName(self) -> str:
        return "V4L2"

    def get(self, name: int) -> float:
        return self.values.get(name, -1.0)

    def set(self, name: int, value: float) -> bool:
        if name == cv2.CAP_PROP_FOURCC and self.fast_when_compressed:
            self.values[cv2.CAP_PROP_FPS] = 30.0
        if not self._taken(name, value):
            return False
        widths, heights = zip(*self.sizes, strict=True)
        offered = {cv2.CAP_PROP_FRAME_WIDTH: widths, cv2.CAP_PROP_FRAME_HEIGHT: heights, cv2.CAP_PROP_FPS: ()}
        if value in offered.get(name, (value,)):  # of what is not, drivers take the nearest without a word
            self.values[name] = value
        return True

    def _taken(self, name: int, value: float) -> bool:
        if name == cv2.CAP_PROP_EXPOSURE:
            return self.values[cv2.CAP_PROP_AUTO_EXPOSURE] == 1 and 1 <= value <= 5000
        if name == cv2.CAP_PROP_WB_TEMPERATURE:
            return self.values[cv2.CAP_PROP_AUTO_WB] == 0
        return True

    def grab(self) -> bool:
        time.sleep(0.01)
        return True

    def retrieve(self) -> tuple[bool, np.ndarray]:
        width, height = int(self.values[3]), int(self.values[4])
        return True, self._rng.integers(0, 255, (height, width, 3), dtype=np.uint8)

    def release(self) -> None:
        return None


@pytest.fixture
def driver(monkeypatch: pytest.MonkeyPatch) -> Driver:
    driver = Driver(sizes=((640, 480), (1280, 720)), fast_when_compressed=True)
    monkeypatch.setattr(cv2, "VideoCapture", lambda *source: driver)
    return driver


def test_exposure_and_white_balance_stay_where_they_settled(driver: Driver) -> None:
    camera = open_opencv("0")
    check_camera(camera)
    camera.close()
    assert driver.values[cv2.CAP_PROP_AUTO_EXPOSURE] == 1
    assert driver.values[cv2.CAP_PROP_AUTO_WB] == 0
    assert driver.values[cv2.CAP_PROP_EXPOSURE] == 210
    assert driver.values[cv2.CAP_PROP_WB_TEMPERATURE] == 3900


def test_exposure_and_white_balance_are_what_was_asked_for(driver: Driver) -> None:
    open_opencv("0", exposure_ms=8, white_balance_k=5200).close()
    assert driver.values[cv2.CAP_PROP_EXPOSURE] == 80
    assert driver.values[cv2.CAP_PROP_WB_TEMPERATURE] == 5200
    with pytest.raises(CameraError, match="to keep exposure_ms at 9000, but its driver"):
        open_opencv("0", exposure_ms=9000)


def test_nothing_is_locked_where_nobody_wants_it(driver: Driver) -> None:
    open_opencv("0", lock=False).close()
    assert driver.values[cv2.CAP_PROP_AUTO_EXPOSURE] == 3
    assert driver.values[cv2.CAP_PROP_AUTO_WB] == 1


def test_a_stream_whose_exposure_cannot_be_set_says_so(server: MjpegServer) -> None:
    with pytest.raises(CameraError, match="to keep exposure_ms at 8, but its driver"):
        open_opencv(server.address, exposure_ms=8)


def test_size_and_rate_are_honoured_compressed_if_need_be_or_refused(driver: Driver) -> None:
    camera = open_opencv("0", size=(1280, 720), fps=30, lock=False)
    assert camera.size == (1280, 720)
    assert driver.values[cv2.CAP_PROP_FPS] == 30
    camera.close()
    with pytest.raises(CameraError, match="to give 1920 x 1080 pixels, got 1280 x 720"):
        open_opencv("0", size=(1920, 1080))


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
