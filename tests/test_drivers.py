"""Every kind of arm and camera that a workcell file can name keeps its contract, opened by such a file.

Who registers another one says here how it is opened without the device.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

import baggie
from baggie.cameras.camera import check_camera
from baggie.registry import ARMS, CAMERAS
from baggie.robot.contract import check_arm
from baggie.workcell.workcell import Workcell
from helpers.lerobot_robot import NumbersRobot, RobotsClock, settings
from helpers.mjpeg_server import MjpegServer

Section = dict[str, Any]
PATCH = pytest.MonkeyPatch
PYTHON_ARM = {"kind": "python", "factory": "helpers.cube_world:open_arm"}


def video(folder: Path) -> str:
    """A film of a grey table with a sensor's noise."""
    path = folder / "table.avi"
    film = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 10, (64, 48))
    for _ in range(3):
        film.write(np.random.default_rng().integers(0, 255, (48, 64, 3), np.uint8))
    film.release()
    return str(path)


@contextmanager
def as_it_is(section: Section, _folder: Path, _patch: PATCH) -> Iterator[Section]:
    """What is there without any device."""
    yield section


@contextmanager
def franka(_folder: Path, _patch: PATCH) -> Iterator[Section]:
    """A simulated robot behind Franka's own protocol."""
    from helpers.fci_process import Server

    server = Server(*(f"127.0.251.{number}" for number in range(1, 250)))
    yield {"host": server.host, "speed": 1.0, "realtime": False}
    server.kill()


@contextmanager
def lerobot(_folder: Path, patch: PATCH) -> Iterator[Section]:
    """A robot that exists in numbers only."""
    from baggie.robot.lerobot.arm import LeRobotArm

    robot = NumbersRobot()
    patch.setattr("baggie.robot.lerobot.open_robot", lambda *_: robot)
    patch.setattr("baggie.robot.lerobot.arm.LeRobotArm", partial(LeRobotArm, clock=RobotsClock(robot)))
    yield {"type": "numbers", **settings().model_dump(mode="json")}


@contextmanager
def network_camera(_folder: Path, _patch: PATCH) -> Iterator[Section]:
    """A stream over HTTP."""
    server = MjpegServer()
    yield {"source": server.address}
    server.go_away()


@contextmanager
def realsense(folder: Path, _patch: PATCH) -> Iterator[Section]:
    """A recording, made by the SDK's software device."""
    from helpers.realsense_recording import record

    record(folder / "wall.db3", frames=60)
    yield {"source": str(folder / "wall.db3"), "timeout_s": 12.0}


@contextmanager
def orbbec(_folder: Path, patch: PATCH) -> Iterator[Section]:
    """The SDK's classes, with nothing behind them."""
    pytest.importorskip("pyorbbecsdk", reason="needs pyorbbecsdk", exc_type=ImportError)
    from helpers.orbbec_camera import plug_in

    plug_in(patch)
    yield {}


@contextmanager
def k4a(_folder: Path, patch: PATCH) -> Iterator[Section]:
    """The SDK's classes likewise."""
    pytest.importorskip("pyk4a", reason="needs the Azure Kinect Sensor SDK", exc_type=ImportError)
    from helpers.k4a_camera import plug_in

    plug_in(patch)
    yield {"timeout_s": 4.0}


Opened = Callable[[Path, PATCH], Any]
OPENED_ARMS: dict[str, Opened] = {
    "sim": partial(as_it_is, {}),
    "franka": franka,
    "lerobot": lerobot,
    "python": partial(as_it_is, PYTHON_ARM),
}
OPENED_CAMERAS: dict[str, Opened] = {
    "sim": partial(as_it_is, {"width": 320, "height": 240}),
    "opencv": network_camera,
    "realsense": realsense,
    "orbbec": orbbec,
    "k4a": k4a,
    "python": partial(as_it_is, {"factory": "helpers.cube_world:open_camera"}),
}


def open_written(folder: Path, **sections: Section) -> Workcell:
    """The workcell of a file with these sections."""
    path = folder / "cell.yaml"
    path.write_text(yaml.safe_dump(sections))
    return baggie.open_workcell(path)


@pytest.mark.parametrize("kind", [kind for kind in ARMS.names() if kind != "replay"])
def test_every_arm_keeps_the_contract(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert kind in OPENED_ARMS, "say above how it is opened"
    camera = {"camera": {"source": video(tmp_path)}} if ARMS[kind].real else {}
    with OPENED_ARMS[kind](tmp_path, monkeypatch) as section:
        arm = {"kind": kind, **section}
        with closing(open_written(tmp_path, arm=arm, **camera)) as cell:
            check_arm(cell.arm)


@pytest.mark.parametrize("kind", CAMERAS.names())
def test_every_camera_keeps_the_contract(kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert kind in OPENED_CAMERAS, "say above how it is opened"
    arm = PYTHON_ARM if CAMERAS[kind].real else {"kind": "sim"}
    with (
        OPENED_CAMERAS[kind](tmp_path, monkeypatch) as section,
        closing(open_written(tmp_path, arm=arm, camera={"kind": kind, **section})) as cell,
    ):
        check_camera(cell.camera)


def test_a_real_workcell_opens_without_the_simulator(tmp_path: Path) -> None:
    path = tmp_path / "cell.yaml"
    path.write_text(
        yaml.safe_dump({"arm": PYTHON_ARM, "camera": {"kind": "opencv", "source": video(tmp_path)}})
    )
    program = f"import sys, baggie; baggie.open_workcell({str(path)!r}); assert 'mujoco' not in sys.modules"
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])}
    done = subprocess.run(
        [sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
