"""What an arm must offer, and what a workcell file says of one: the section `arm`.

`pick` and `place` are written once over the protocol `Arm`; a new arm implements eight methods.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar, Literal, Protocol, runtime_checkable

from pydantic import ConfigDict, Field

from baggie.entries import Section
from baggie.errors import BaggieError
from baggie.geometry import FloatArray, ToolPose, hand_matrix, wrap_angle
from baggie.registry import lacking, made_by

CLEAR_Z_M = 0.1
"""A height above all that lies on a table, metres."""


@dataclass(frozen=True)
class ArmInfo:
    """What an arm is and can do, readable before it is connected."""

    name: str
    max_width_m: float
    """The widest the gripper opens."""
    max_speed_m_s: float
    """The fastest the tool may ever move."""
    max_force_n: float
    """The hardest the gripper may squeeze."""
    tool_symmetry: int = 2
    """How often a turn the tool looks the same: 2 for two fingers; 0 for a round cup, which does at any angle."""
    feels_n: float = 5.0
    """The least force on its tool that the arm tells from none while it moves."""


@runtime_checkable
class Arm(Protocol):
    """An arm with a two-finger gripper whose tool points straight down.

    Every motion blocks until it is done and returns the pose *really* reached. Poses are in the robot's base frame
    (metres, radians); a yaw is taken modulo a turn, and the tool turns the shorter way where the wrist can.
    Implementations raise `ReachError` when a pose cannot be reached and move nothing.
    """

    info: ArmInfo

    def pose(self) -> ToolPose:
        """Where the tool is now."""
        ...

    def move_to(self, target: ToolPose, speed_m_s: float) -> ToolPose:
        """Move the tool along a straight line, smoothly, never faster than `speed_m_s`; the pose reached."""
        ...

    def lower_until_contact(self, z_min: float, speed_m_s: float, force_n: float) -> ToolPose:
        """Move straight down until something pushes the hand up with `force_n`, or the tool is at `z_min`; the pose
        reached.

        With `force_n` more than when it began, so that neither the hand's weight nor its load is felt.
        """
        ...

    def move_gripper(self, width_m: float) -> float:
        """Open or close to a width between the fingers, without squeezing; the width reached."""
        ...

    def grasp(self, force_n: float) -> float:
        """Close until the fingers meet something or each other, then keep squeezing; the width, 0 if empty."""
        ...

    def gripper_width(self) -> float:
        """Metres between the fingers now."""
        ...

    def park(self) -> ToolPose:
        """Move out of the camera's view; the pose reached."""
        ...

    def stop(self) -> None:
        """Stop moving, now."""
        ...


@runtime_checkable
class LedArm(Protocol):
    """An arm a person can lead by hand."""

    def hand_pose(self) -> FloatArray:
        """`T_base_hand` `(4, 4)` wherever it has been led, tilted too. The hand's frame: `geometry.hand_matrix`."""
        ...


def hand_pose(arm: Arm) -> FloatArray:
    """`T_base_hand` `(4, 4)` of any arm: the tool of one that cannot be led always points straight down."""
    return arm.hand_pose() if isinstance(arm, LedArm) else hand_matrix(arm.pose())


@runtime_checkable
class ForeseeingArm(Protocol):
    """An arm that knows beforehand what it reaches."""

    def foresee(self, way: Sequence[ToolPose]) -> float:
        """Radians that the tool would turn in all, moving straight from where it is through these poses; nothing moves.

        Raises `ReachError` where `move_to` would.
        """
        ...


def foresee(arm: Arm, way: Sequence[ToolPose]) -> float:
    """`ForeseeingArm.foresee` of any arm: one that does not foresee is taken to turn the shorter way everywhere."""
    if isinstance(arm, ForeseeingArm):
        return arm.foresee(way)
    return sum(abs(wrap_angle(after.yaw - before.yaw)) for before, after in pairwise([arm.pose(), *way]))


class ArmEntry(Section):
    """The section `arm` of a workcell file, of one kind. `baggie.registry.ARMS` has a subclass for each."""

    kind: str
    """The word it is registered by."""

    real: ClassVar[bool] = True
    """Whether it is a robot, of which there is one, and which needs a real camera."""
    about: ClassVar[str] = ""
    """What it is, in a few words, for a person who chooses."""

    def open(self, folder: Path) -> Arm:
        """Make the arm, which connects at its first use; paths in the section begin in `folder`.

        Raises `BaggieError` where it cannot be made here.
        """
        raise NotImplementedError

    def info(self, folder: Path) -> ArmInfo | None:
        """What the arm can do, nothing connected; None for one that is not real. Raises as `open` does."""
        arm = self.open(folder)
        let_go(arm)
        return arm.info

    def title(self, folder: Path) -> str:
        """What a recording says moved. Raises as `open` does."""
        info = self.info(folder)
        return self.kind if info is None else info.name


@runtime_checkable
class _Closable(Protocol):
    def close(self) -> None: ...


def let_go(*devices: object) -> None:
    """Close those arms and cameras that have a `close`."""
    for device in devices:
        if isinstance(device, _Closable):
            device.close()


class PythonArmEntry(ArmEntry):
    """An arm of one's own. Every other entry is an option of its factory."""

    model_config = ConfigDict(extra="allow")

    kind: Literal["python"] = "python"
    about: ClassVar[str] = "one of your own"
    factory: str = Field(pattern=r"^[\w.]+:\w+$")
    """`my_lab.my_arm:open_arm`, a function or class that makes an `Arm`; the module may be in the file's own folder."""

    def open(self, folder: Path) -> Arm:
        """Make the arm. Raises as `open_python_arm` does."""
        return open_python_arm(self.factory, self.model_extra or {}, folder)


def open_python_arm(factory: str, options: Mapping[str, Any], folder: Path) -> Arm:
    """What `factory` makes of `options`: `"my_lab.my_arm:open_arm"`, a function or class in a module.

    The module is looked for where Python looks, then in `folder`. Raises `BaggieError` when it cannot be imported, does
    not take these options, or makes no `Arm`; whatever the factory itself raises is passed on.
    """
    arm = made_by(factory, options, folder, "arm")
    if not isinstance(arm, Arm) or not isinstance(arm.info, ArmInfo):
        wrong = lacking(arm, Arm) or "has an `info` that is no ArmInfo"
        raise BaggieError(
            f"{factory} made a {type(arm).__name__}, which is no Arm: it {wrong}; see baggie/robot/arm.py"
        )
    return arm
