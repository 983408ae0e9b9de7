"""What every camera that streams does, with a stream that obeys."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator

import numpy as np
import pytest

from baggie.cameras import settings_of
from baggie.cameras.camera import CameraSettings, check_camera
from baggie.cameras.live import LiveCamera
from baggie.errors import CameraError
from baggie.types import Intrinsics, Observation

PERIOD_S = 0.05


class Device:
    """What a cable leads to. It makes a frame every `PERIOD_S`; its driver keeps the last ones until they are taken."""

    def __init__(self) -> None:
        self.plugged_in = True
        self.noise = True
        self.size = (8, 6)
        self.buffered: list[float] = []
        """When the frames were made that wait in the driver."""
        self.opened: list[CameraSettings] = []
        self.held = threading.Event()
        self.held.set()
        """Cleared, whoever takes frames is held up, as a busy computer does."""

    def open(self, settings: CameraSettings) -> DeviceStream:
        if not self.plugged_in:
            raise CameraError("nothing there; plug it in")
        self.opened.append(settings)
        return DeviceStream(self, settings.model_copy(update={"exposure_ms": settings.exposure_ms or 12.5}))


class DeviceStream:
    name = "device"
    intrinsics: Intrinsics | None = None

    def __init__(self, device: Device, settings: CameraSettings) -> None:
        self.device, self.settings = device, settings
        self.made = 0.0

    def grab(self) -> None:
        self.device.held.wait()
        if not self.device.plugged_in:
            raise CameraError("it was unplugged")
        if self.device.buffered:
            self.made = self.device.buffered.pop(0)
        else:
            self.made = time.monotonic()  # it exposes, and reads out
            time.sleep(PERIOD_S)

    def retrieve(self) -> Observation:
        made = np.array([self.made]).view(np.uint8)
        width, height = self.device.size
        color = np.zeros((height, width, 3), np.uint8)
        if self.device.noise:
            color[0, :8, 0] = made
        return Observation(color)

    def close(self) -> None:
        return None


def made_at(observation: Observation) -> float:
    return float(observation.color[0, :8, 0].copy().view(np.float64)[0])


@pytest.fixture
def device() -> Device:
    return Device()


@pytest.fixture
def camera(device: Device) -> Iterator[LiveCamera]:
    camera = LiveCamera(device.open, CameraSettings(timeout_s=1.5))
    yield camera
    device.held.set()
    camera.close()


def test_it_keeps_the_contract(camera: LiveCamera) -> None:
    check_camera(camera)


def test_a_picture_is_made_after_the_call_and_dated(camera: LiveCamera) -> None:
    for pause in (0.0, 0.0, 0.3 * PERIOD_S, 0.8 * PERIOD_S):
        time.sleep(pause)
        called, wall = time.monotonic(), time.time()
        observation = camera.look()
        assert made_at(observation) > called
        assert wall <= observation.time <= time.time()


def test_frames_that_waited_in_the_driver_while_the_computer_was_busy_are_passed_over(
    camera: LiveCamera, device: Device
) -> None:
    for _ in range(4):
        camera.look()  # it knows the usual pace by now
    device.held.clear()
    time.sleep(3 * PERIOD_S)
    now = time.monotonic()
    device.buffered = [now - 0.09, now - 0.06, now - 0.03]
    threading.Timer(0.02, device.held.set).start()
    called = time.monotonic()
    assert made_at(camera.look()) > called
    assert not device.buffered


def test_several_may_look_at_once(camera: LiveCamera) -> None:
    seen: list[float] = []
    lookers = [threading.Thread(target=lambda: seen.append(made_at(camera.look()))) for _ in range(4)]
    for looker in lookers:
        looker.start()
    for looker in lookers:
        looker.join(5)
    assert len(set(seen)) == 4


def test_unplugged_it_says_so_in_time_and_plugged_in_again_it_goes_on_as_before(
    camera: LiveCamera, device: Device
) -> None:
    camera.look()
    device.plugged_in = False
    start = time.monotonic()
    with pytest.raises(
        CameraError, match=r"no picture within 1\.5 s \(nothing there\); check its cable"
    ) as caught:
        camera.look()
    assert 1.2 < time.monotonic() - start < 4
    assert "\n" not in str(caught.value)
    device.plugged_in = True
    assert made_at(camera.look()) > start
    assert [each.exposure_ms for each in device.opened] == [None, 12.5], "locked as it was at first"


def test_a_look_survives_a_loose_cable(camera: LiveCamera, device: Device) -> None:
    device.plugged_in = False
    threading.Timer(0.7, lambda: setattr(device, "plugged_in", True)).start()
    called = time.monotonic()
    assert made_at(camera.look()) > called


def test_a_camera_that_repeats_itself_has_frozen(camera: LiveCamera, device: Device) -> None:
    camera.look()
    device.noise = False  # at a picture that nobody has looked at
    with pytest.raises(CameraError, match="has frozen"):
        camera.look()
    device.noise = True
    camera.look()


def test_another_size_is_refused(camera: LiveCamera, device: Device) -> None:
    device.size = (16, 12)
    with pytest.raises(CameraError, match="used to give pictures of 8 x 6 pixels, now of 16 x 12"):
        camera.look()


def test_a_calibration_that_was_taken_into_use_shows_in_the_pictures(camera: LiveCamera) -> None:
    lens = Intrinsics(8, 6, np.diag([5.0, 5.0, 1.0]), np.zeros(5))
    camera.intrinsics = lens
    assert camera.look().intrinsics is lens


def test_what_never_delivers_is_refused_when_it_is_opened(device: Device) -> None:
    device.held.clear()
    threading.Timer(1.5, device.held.set).start()
    with pytest.raises(CameraError, match=r"no picture within 0\.5 s"):
        LiveCamera(device.open, CameraSettings(timeout_s=0.5))
    device.plugged_in = False
    with pytest.raises(CameraError, match="nothing there"):
        LiveCamera(device.open, CameraSettings(timeout_s=0.5))


def test_a_closed_camera_leaves_no_thread_behind(device: Device) -> None:
    camera = LiveCamera(device.open, CameraSettings(timeout_s=3.0))
    before = threading.active_count()
    camera.close()
    assert threading.active_count() == before - 1
    with pytest.raises(CameraError, match="closed"):
        camera.look()


@pytest.mark.parametrize(
    ("words", "kind", "source"),
    [
        ("0", "opencv", "0"),
        ("rtsp://10.0.0.2/1", "opencv", "rtsp://10.0.0.2/1"),
        ("realsense", "realsense", None),
        ("orbbec:CL8", "orbbec", "CL8"),
        ("k4a:0001", "k4a", "0001"),
        ("realsense.mp4", "opencv", "realsense.mp4"),
    ],
)
def test_a_camera_in_one_word(words: str, kind: str, source: str | None) -> None:
    settings = settings_of(words)
    assert (settings.kind, settings.source) == (kind, source)
