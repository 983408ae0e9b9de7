"""Franka's arms, FR3 and Panda.

What a workcell file says of one.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Literal

from pydantic import Field

from baggie.entries import Words
from baggie.robot.arm import ArmEntry, ArmInfo
from baggie.robot.franka.models import MODELS, ModelName

if TYPE_CHECKING:
    from baggie.robot.franka.arm import FrankaArm


class FrankaEntry(ArmEntry):
    """A real arm, or one behind the same protocol."""

    kind: Literal["franka"] = "franka"
    about: ClassVar[str] = "an FR3 or a Panda"
    host: Words = Field(min_length=1)
    """The address of its control box."""
    model: ModelName = "fr3"
    speed: float = Field(0.1, gt=0, le=1)
    """The share of every speed that it really goes at: as slow as this until a person has watched it work."""
    realtime: bool = True
    """Whether to refuse to move it from a computer without a real-time kernel."""

    def open(self, folder: Path) -> FrankaArm:
        """Make the arm. Raises `BaggieError` without franky."""
        from baggie.robot.franka.arm import FrankaArm  # noqa: PLC0415 -- kinematics runs on MuJoCo

        return FrankaArm(self.host, self.model, speed=self.speed, realtime=self.realtime)

    def info(self, folder: Path) -> ArmInfo:
        """What the arm can do, which is known without franky."""
        return MODELS[self.model].info(self.host)

    def title(self, folder: Path) -> str:
        """Its model, whatever its address."""
        return MODELS[self.model].title
