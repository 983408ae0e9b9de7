"""The arm and the camera of `simulator.py`, as docs/own-arm.md and docs/cameras.md ask for them."""

from __future__ import annotations

import base64
import contextlib
import json
import socket
import threading
import time
from typing import Any

import numpy as np

from baggie.errors import ArmError, BaggieError, CameraError, ReachError
from baggie.geometry import ToolPose
from baggie.robot.arm import ArmInfo
from baggie.types import Intrinsics, Observation

PORT = 8765
_CONNECT_S, _ANSWER_S = 5.0, 120.0


class Link:
    """A line of JSON to the simulator, a line back. It is opened at the first use, and again after it broke."""

    def __init__(self, port: int, error: type[BaggieError]) -> None:
        self._port, self._error = port, error
        self._lines: Any = None
        self._one_at_a_time = threading.Lock()

    def ask(self, do: str, **words: Any) -> Any:
        """What it answers. Raises `ReachError`, `ArmError`, or the error of a link that is not there."""
        with self._one_at_a_time:
            try:
                if self._lines is None:
                    link = socket.create_connection(("127.0.0.1", self._port), _CONNECT_S)
                    link.settimeout(_ANSWER_S)
                    self._lines = link.makefile("rwb")
                    link.close()  # the file keeps it open
                self._lines.write(json.dumps({"do": do, **words}).encode() + b"\n")
                self._lines.flush()
                line = self._lines.readline()
                if not line:
                    raise ConnectionResetError("it hung up")
            except OSError as error:
                self.close()
                raise self._error(
                    f"the simulator does not answer at port {self._port} ({error}); start simulator.py"
                ) from None
        answer = json.loads(line)
        if isinstance(answer, dict) and "error" in answer:
            if answer["kind"] == "reach":
                raise ReachError(f"{answer['error']}; choose a place nearer")
            raise ArmError(f"{answer['error']}; nothing moves until it is told to again")
        return answer

    def close(self) -> None:
        """Hang up."""
        lines, self._lines = self._lines, None
        if lines is not None:
            with contextlib.suppress(OSError):
                lines.close()


class PyBulletArm:
    """The eight methods of `baggie.robot.arm.Arm`, and `close`."""

    def __init__(self, port: int) -> None:
        self.info = ArmInfo("PyBullet's Panda", max_width_m=0.08, max_speed_m_s=1.0, max_force_n=40.0)
        self._link, self._brake = Link(port, ArmError), Link(port, ArmError)

    def pose(self) -> ToolPose:
        return ToolPose(**self._link.ask("pose"))

    def move_to(self, target: ToolPose, speed_m_s: float) -> ToolPose:
        there = {"x": target.x, "y": target.y, "z": target.z, "yaw": target.yaw}
        return ToolPose(**self._link.ask("move_to", **there, speed=speed_m_s))

    def lower_until_contact(self, z_min: float, speed_m_s: float, force_n: float) -> ToolPose:
        return ToolPose(**self._link.ask("lower_until_contact", z_min=z_min, speed=speed_m_s, force=force_n))

    def move_gripper(self, width_m: float) -> float:
        return float(self._link.ask("move_gripper", width=width_m))

    def grasp(self, force_n: float) -> float:
        return float(self._link.ask("grasp", force=force_n))

    def gripper_width(self) -> float:
        return float(self._link.ask("gripper_width"))

    def park(self) -> ToolPose:
        return ToolPose(**self._link.ask("park"))

    def stop(self) -> None:
        self._brake.ask("stop")  # on a line of its own: a motion occupies the other

    def close(self) -> None:
        self._link.close()
        self._brake.close()


class PyBulletCamera:
    """Three attributes and a method of `baggie.cameras.camera.Camera`, and `close`."""

    def __init__(self, port: int) -> None:
        self.name, self.size = "PyBullet camera", (640, 480)
        self.intrinsics: Intrinsics | None = None
        self._link = Link(port, CameraError)

    def look(self) -> Observation:
        seen = self._link.ask("picture")
        width, height = seen["size"]
        color = np.frombuffer(base64.b64decode(seen["rgb"]), np.uint8).reshape(height, width, 3).copy()
        return Observation(color, None, self.intrinsics, time.time())

    def close(self) -> None:
        self._link.close()


def open_arm(port: int = PORT) -> PyBulletArm:
    """The arm that a workcell file names."""
    return PyBulletArm(port)


def open_camera(port: int = PORT) -> PyBulletCamera:
    """The camera that a workcell file names."""
    return PyBulletCamera(port)
