"""A robot with LeRobot's interface that exists in numbers only: an FR3 that follows late and a little short."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from baggie.geometry import FloatArray
from baggie.robot.franka.models import HOME, TOOL_OFFSET_M
from baggie.robot.kinematics import Kinematics, load_arm_model
from baggie.robot.lerobot.link import LeRobotSettings

FR3 = Path(str(files("franky_sim"))) / "assets" / "fr3.xml"
JOINTS = [f"fr3_joint{number}" for number in range(1, 8)]
TOOL_XYZ_M = (0.0, 0.0, TOOL_OFFSET_M)
KINEMATICS = Kinematics(load_arm_model(FR3, JOINTS, tool="hand", tool_xyz_m=TOOL_XYZ_M), HOME, JOINTS)
WIDEST_M = 0.08


def settings(**changes: Any) -> LeRobotSettings:
    """What one would write down about it."""
    written: dict[str, Any] = {
        "model": FR3,
        "tool": "hand",
        "tool_xyz_m": TOOL_XYZ_M,
        "joints": JOINTS,
        "widths": [(0, 0.0), (100, WIDEST_M)],
        "park": np.rad2deg(HOME).tolist(),
        "speed": 1.0,
    }
    return LeRobotSettings.model_validate(written | changes)


@dataclass
class NumbersRobot:
    """In degrees; the gripper from 0 to 100."""

    name: str = "numbers_follower"
    late_s: float = 0.1
    short_deg: float = 1.5
    """So much every joint hangs behind its target."""
    floor_z: float = -math.inf
    """No lower the tool can get."""
    thing_m: float = 0.0
    """So wide is what is between the fingers."""
    connected: bool = False
    is_calibrated: bool = True
    cable: bool = True
    sent: list[FloatArray] = field(default_factory=list)
    """Every target, `(8,)`."""

    def __post_init__(self) -> None:
        self.at = np.append(np.rad2deg(HOME), 50.0)
        self.target = self.at.copy()

    @property
    def observation_features(self) -> dict[str, Any]:
        return {f"{name}.pos": float for name in [*JOINTS, "gripper"]} | {"front": (480, 640, 3)}

    @property
    def action_features(self) -> dict[str, Any]:
        return {f"{name}.pos": float for name in [*JOINTS, "gripper"]}

    @property
    def is_connected(self) -> bool:
        return self.connected

    def connect(self, calibrate: bool = True) -> None:
        assert not calibrate, "nobody sits at a terminal to calibrate"
        if not self.cable:
            raise ConnectionError("could not open port /dev/ttyACM0")
        self.connected = True

    def get_observation(self) -> dict[str, Any]:
        self._answer()
        return dict(zip(self.action_features, self.at.tolist(), strict=True)) | {"front": None}

    def send_action(self, action: dict[str, Any]) -> Mapping[str, Any]:
        self._answer()
        self.target = np.array([action[key] for key in self.action_features])
        self.sent.append(self.target)
        return action

    def disconnect(self) -> None:
        self.connected = False

    def advance(self, seconds: float) -> None:
        """Follow the targets for a while; what is in the way holds."""
        share = 1 - math.exp(-seconds / self.late_s)
        short = np.append(np.full(7, self.short_deg), 0.0) if self.sent else 0.0
        to = self.at + share * (self.target - short - self.at)
        to[7] = max(to[7], 100 * self.thing_m / WIDEST_M)
        z, z_now = (KINEMATICS.tool_pose(np.deg2rad(q[:7])).z for q in (to, self.at))
        if z < self.floor_z and z < z_now:
            to[:7] = self.at[:7]
        self.at = to

    def _answer(self) -> None:
        if not self.cable:
            raise ConnectionError("Failed to sync read 'Present_Position'")
        assert self.connected


@dataclass
class RobotsClock:
    """The robot's own time: it passes while somebody waits."""

    robot: NumbersRobot
    now: float = 0.0

    def monotonic(self) -> float:
        return self.now

    def sleep(self, seconds: float, /) -> None:
        self.now += seconds
        if seconds > 0:
            self.robot.advance(seconds)
