import threading
import time

import pytest

from baggie.errors import ArmError, BaggieError, CameraError
from baggie.robot.limits import GuardedArm, Watchdog
from baggie.workcell.workcell import WorkcellSettings
from helpers.recording_arm import RecordingArm


class Camera:
    """Silent from the moment it is unplugged."""

    def __init__(self) -> None:
        self.unplugged: float | None = None

    def silent_s(self) -> float:
        return 0.0 if self.unplugged is None else time.monotonic() - self.unplugged

    def unplug(self, long_ago_s: float = 0.0) -> None:
        self.unplugged = time.monotonic() - long_ago_s


class SlowArm(RecordingArm):
    """A grasp takes ten seconds, unless it is stopped."""

    def __init__(self, complains: bool) -> None:
        super().__init__()
        self.complains, self.stopped = complains, threading.Event()

    def grasp(self, force_n: float) -> float:
        self.log.append("grasp")
        if self.stopped.wait(10) and self.complains:
            raise ArmError("the arm was stopped")
        return 0.0

    def stop(self) -> None:
        super().stop()
        self.stopped.set()


def watched(arm: RecordingArm, camera: Camera) -> GuardedArm:
    gate = GuardedArm(arm, WorkcellSettings().limits)
    gate.watchdog = Watchdog(camera.silent_s, 0.2, "the camera over the table")
    return gate


@pytest.mark.parametrize("complains", [False, True])
def test_a_camera_that_is_unplugged_stops_the_motion_under_way(complains: bool) -> None:
    arm, camera = SlowArm(complains), Camera()
    threading.Timer(0.1, camera.unplug).start()
    began = time.monotonic()
    with pytest.raises(CameraError, match=r"camera over the table was silent .* so the arm was stopped"):
        watched(arm, camera).grasp(5.0)
    assert time.monotonic() - began < 5
    assert arm.log == ["grasp", "stop"]


def test_a_stop_that_fails_is_tried_once_more() -> None:
    class Deaf(SlowArm):
        def stop(self) -> None:
            super().stop()
            if self.log.count("stop") == 1:
                raise ArmError("the link was lost")

    arm, camera = Deaf(complains=False), Camera()
    threading.Timer(0.1, camera.unplug).start()
    with pytest.raises(CameraError, match="the arm was stopped"):
        watched(arm, camera).grasp(5.0)
    assert arm.log == ["grasp", "stop", "stop"]


def test_nothing_but_parking_while_the_camera_is_silent() -> None:
    arm, camera = SlowArm(complains=False), Camera()
    camera.unplug(long_ago_s=1.0)
    gate = watched(arm, camera)
    with pytest.raises(CameraError, match="nothing was moved"):
        gate.grasp(5.0)
    assert not arm.log
    gate.park()  # but out of its way, so that a look can open it again


def test_a_camera_that_sees_lets_everything_through() -> None:
    arm = RecordingArm()
    assert watched(arm, Camera()).grasp(5.0) == 0.01
    assert arm.log == ["grasp"]


def test_what_the_arm_itself_complains_about_stays_what_it_was() -> None:
    class Broken(RecordingArm):
        def grasp(self, force_n: float) -> float:
            raise ArmError("a reflex")

    with pytest.raises(BaggieError, match="a reflex"):
        watched(Broken(), Camera()).grasp(5.0)
