"""Robots with LeRobot's interface.

What a workcell file says of one.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from pydantic import Field

from baggie.entries import Words
from baggie.robot.arm import ArmEntry
from baggie.robot.lerobot.link import LeRobotSettings, open_robot

if TYPE_CHECKING:
    from baggie.robot.lerobot.arm import LeRobotArm


class LeRobotEntry(LeRobotSettings, ArmEntry):
    """A robot of LeRobot's. `model` is looked for from the workcell file's own folder."""

    kind: Literal["lerobot"] = "lerobot"
    about: ClassVar[str] = "a robot that LeRobot drives"
    type: Words = Field(min_length=1)
    """LeRobot's name for it, `so101_follower`."""
    port: Words | None = None
    id: Words | None = None
    """The name of its calibration."""
    options: dict[str, Any] = Field(default_factory=dict)
    """Whatever else LeRobot's configuration of this type takes."""

    def open(self, folder: Path) -> LeRobotArm:
        """Make the arm. Raises `BaggieError` without LeRobot, and for what it or the model's file does not take."""
        from baggie.robot.lerobot.arm import LeRobotArm  # noqa: PLC0415 -- kinematics runs on MuJoCo

        given = {"port": self.port, "id": self.id}
        options = {name: value for name, value in given.items() if value is not None} | self.options
        robot = open_robot(self.type, options)
        return LeRobotArm(robot, self.model_copy(update={"model": folder / self.model}))
