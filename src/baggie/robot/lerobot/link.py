"""The link to a LeRobot robot: what it must offer, how it is found, positions in radians, errors in one line.

What a person writes down about a LeRobot robot, so that it can be moved in metres.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Annotated, Any, Literal, Protocol, Self

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from baggie.entries import Metres, Section, Words
from baggie.errors import ArmError, BaggieError, StuckError, pip_install
from baggie.geometry import FloatArray

Triple = tuple[float, float, float]


class LeRobotJoint(Section):
    """One joint, as the robot and as the model have it."""

    name: Words
    """The robot's: it reads and takes `NAME.pos`."""
    model: Words = ""
    """The model's name for it; the same unless given."""
    sign: Literal[1, -1] = 1
    """-1 where the robot counts the other way round."""
    zero_deg: float | None = None
    """The model's angle where the robot reads 0; unless given 0, or with normalised units the middle of its range."""

    @property
    def model_name(self) -> str:
        """In the MJCF or URDF file."""
        return self.model or self.name


def _name_alone(entry: Any) -> Any:
    return {"name": entry} if isinstance(entry, str) else entry


_SO101 = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")


class LeRobotSettings(Section):
    """Model, scales and speeds. The defaults fit an SO-101, where they can."""

    model: Path
    """Its MJCF or URDF file, of which only joints and frames are used."""
    tool: Words = "gripper_frame_link"
    """The site, body or link that moves with the hand."""
    tool_xyz_m: tuple[Metres, Metres, Metres] = (0.0, 0.0, 0.0)
    """From that frame to the point between the fingertips."""
    tool_rpy_deg: Triple = (0.0, 0.0, 0.0)
    """From that frame to the hand's: z along the fingers, y the way they open. Fixed axes x, y, z, as in URDF."""
    base_z_m: Metres = 0.0
    """How high above the table the model's world is: the height of a pedestal."""
    joints: tuple[Annotated[LeRobotJoint, BeforeValidator(_name_alone)], ...] = tuple(
        LeRobotJoint(name=name) for name in _SO101
    )
    """From the base to the wrist; a name alone will do."""
    units: Literal["degrees", "normalized"] = "degrees"
    """Of the joints' positions: degrees, or -100 to 100 over the range that the model gives them."""
    gripper: Words = "gripper"
    widths: tuple[tuple[float, Metres], ...] = ((0.0, 0.0), (100.0, 0.07))
    """Pairs of a gripper position and the metres between the fingertips there, from closed to open."""
    park: tuple[float, ...]
    """Where the joints are out of the camera's view, the tool pointing down; in the robot's units."""
    clear_z_m: float = Field(0.06, gt=0)
    """Parking begins with a straight rise to this height."""

    speed: float = Field(0.1, gt=0, le=1)
    """The share of every speed that it really goes at: as slow as this until a person has watched it work."""
    joint_speed_deg_s: float = Field(120.0, gt=0)
    """The fastest a joint may ever turn."""
    rate_hz: float = Field(30.0, gt=0, le=500)
    """Targets sent a second. No step between two of them is larger than a joint may turn in that time."""
    max_lag_deg: float = Field(20.0, gt=0)
    """A joint that is so far behind what it was sent is held by something: the motion ends."""
    lag_s: float = Field(0.15, ge=0)
    """How late the joints follow when nothing holds them."""
    feel_m_s: float = Field(0.05, gt=0)
    """The fastest it lowers: the lag of free joints, which touch has to exceed, grows with speed."""
    stiffness_n_m: float = Field(300.0, gt=0)
    """Newtons with which the tool presses for each metre that it is held above where it was sent."""
    grip_n: float = Field(1.0, gt=0)
    """Newtons with which the fingers squeeze for each unit of position that they are held open."""
    max_grip_n: float = Field(20.0, gt=0)

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if len(self.park) != len(self.joints):
            raise ValueError(f"park needs {len(self.joints)} numbers, one a joint, got {len(self.park)}")
        pairs = list(zip(self.widths, self.widths[1:], strict=False))
        if not pairs or not all(a < b and v < w for (a, v), (b, w) in pairs):
            raise ValueError(f"widths needs two or more pairs, both numbers rising, got {self.widths}")
        return self


class LeRobotRobot(Protocol):
    """As much of `lerobot.robots.Robot` (0.6.1) as is used; anything that offers it will do."""

    name: str

    @property
    def observation_features(self) -> Mapping[str, Any]:
        """What an observation holds, known before it is connected."""
        ...

    @property
    def action_features(self) -> Mapping[str, Any]:
        """What an action holds, likewise."""
        ...

    @property
    def is_connected(self) -> bool:
        """Whether it can be spoken with."""
        ...

    @property
    def is_calibrated(self) -> bool:
        """Whether it knows its own zeros and ranges."""
        ...

    def connect(self, calibrate: bool = True) -> None:
        """Find it."""
        ...

    def get_observation(self) -> Mapping[str, Any]:
        """`{"shoulder_pan.pos": 12.5, ...}`."""
        ...

    def send_action(self, action: dict[str, Any]) -> Mapping[str, Any]:
        """Position targets; what was really sent."""
        ...

    def disconnect(self) -> None:
        """Let go of it."""
        ...


class LeRobotLink:
    """A robot's joints and gripper as one vector: `(J + 1,)` radians, and last the gripper in its own units.

    Connects when it is first needed, and again when the link was lost. Raises `ArmError` for whatever the robot or the
    bus answers, `BaggieError` when the robot has no such joints.
    """

    def __init__(self, robot: LeRobotRobot, names: list[str], zero: FloatArray, gain: FloatArray) -> None:
        """`names`: J joints and the gripper. A position is `zero + gain * reading`, each `(J + 1,)`."""
        self._robot, self._zero, self._gain = robot, zero, gain
        self._keys = [f"{name}.pos" for name in names]
        for features in (robot.observation_features, robot.action_features):
            missing = [key for key in self._keys if key not in features]
            if missing:
                raise BaggieError(
                    f"expected a robot with {', '.join(missing)}, {robot.name} has {', '.join(features)}; give its own "
                    "names as joints and gripper"
                )
        self.sent: FloatArray | None = None
        """The last target `(J + 1,)`, as it was really sent; None since it was connected."""

    def measured(self) -> FloatArray:
        """Where joints and gripper are, `(J + 1,)`."""
        self._connect()
        with self._speaking():
            return self._read(self._robot.get_observation())

    def send(self, target: FloatArray) -> None:
        """Send targets, `(J + 1,)`."""
        readings = (target - self._zero) / self._gain
        action = {key: float(value) for key, value in zip(self._keys, readings, strict=True)}
        with self._speaking():
            self.sent = self._read(self._robot.send_action(action))

    def close(self) -> None:
        """Let go of the robot. Whether it stays stiff is up to its own settings."""
        self.sent = None
        if self._robot.is_connected:
            with self._speaking():
                self._robot.disconnect()

    def _read(self, answer: Mapping[str, Any]) -> FloatArray:
        missing = [key for key in self._keys if key not in answer]
        if missing:
            raise ArmError(f"{self._robot.name} says nothing about {', '.join(missing)}; restart it")
        values = np.array([float(answer[key]) for key in self._keys])
        if not np.isfinite(values).all():
            raise ArmError(f"{self._robot.name} answers {values}, which are no positions; restart it")
        return np.asarray(self._zero + self._gain * values)

    def _connect(self) -> None:
        if self._robot.is_connected:
            return
        self.sent = None
        with self._speaking():
            self._robot.connect(calibrate=False)  # calibrating asks a person at the terminal
            calibrated = self._robot.is_calibrated
        if not calibrated:
            self.close()
            raise StuckError(
                f"{self._robot.name} is not calibrated; run lerobot-calibrate with the same type, port and id"
            )

    @contextmanager
    def _speaking(self) -> Iterator[None]:
        try:
            yield
        except (OSError, RuntimeError) as error:  # ConnectionError and what serial ports raise are OSErrors
            self.sent = None
            with suppress(OSError, RuntimeError):
                self._robot.disconnect()
            raise ArmError(
                f"the link to {self._robot.name} was lost ({' '.join(str(error).split())}); check its power, its cable "
                "and that no other program uses its port. The next motion connects again"
            ) from None


def open_robot(kind: str, options: Mapping[str, Any]) -> LeRobotRobot:
    """LeRobot's robot of a type such as `so101_follower`, not yet connected. `options`: of its own configuration.

    Raises `BaggieError` without `lerobot`, for a type it does not know, and for options that the type does not take.
    """
    try:
        robots = importlib.import_module("lerobot.robots")
        decode = importlib.import_module("draccus").decode  # as LeRobot's own commands read a configuration
        plugins = importlib.import_module("lerobot.utils.import_utils").register_third_party_plugins
    except ImportError as error:
        raise BaggieError(
            f"a LeRobot robot needs lerobot, which cannot be imported ({_line(error)}); install it with what the "
            f"robot's motors need, for an SO-101: {pip_install('lerobot[feetech]')}"
        ) from None
    config = _config(robots, kind, plugins)
    try:
        return robots.make_robot_from_config(decode(config, dict(options)))  # type: ignore[no-any-return]
    except Exception as error:  # draccus and LeRobot raise whatever they like here; nothing is connected yet
        raise BaggieError(f"LeRobot cannot make a {kind} of {dict(options)}: {_line(error)}") from None


def _config(robots: Any, kind: str, plugins: Callable[[], None]) -> Any:
    """The configuration class of a type. LeRobot knows a type only once its module was imported, so they all are."""
    for module in pkgutil.iter_modules(robots.__path__, "lerobot.robots."):
        if kind not in robots.RobotConfig.get_known_choices():
            with suppress(ImportError):  # another robot's, whose own library is not installed
                importlib.import_module(module.name)
    if kind not in robots.RobotConfig.get_known_choices():
        plugins()
    known = robots.RobotConfig.get_known_choices()
    if kind not in known:
        raise BaggieError(f"LeRobot knows no robot of type {kind!r}; it knows {', '.join(sorted(known))}")
    return known[kind]


def _line(error: object) -> str:
    return " ".join(str(error).split())
