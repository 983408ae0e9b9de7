"""A workcell replayed from a recording: its pictures and its outcomes, in the order they were recorded."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NoReturn

from baggie.calibration.files import CameraIdentity
from baggie.errors import BaggieError, CameraError, ReachError
from baggie.geometry import ToolPose
from baggie.robot.arm import ArmInfo
from baggie.types import Attempt, Intrinsics, Observation, Outcome, PickPlace
from baggie.workcell.workcell import Workcell, WorkcellSettings


class ReplayCamera:
    """A `Camera` that shows the picture before one attempt after the other."""

    def __init__(self, attempts: Sequence[Attempt], name: str = "replay") -> None:
        """Raises `BaggieError` where there are no attempts."""
        if not len(attempts):
            raise BaggieError("expected a recording with attempts to replay, got an empty one; collect some")
        self.name = name
        self.attempts = attempts
        self.at = 0
        """Which attempt is shown."""
        first = attempts[0].before
        self.size = first.size
        self.intrinsics: Intrinsics | None = first.intrinsics

    def attempt(self) -> Attempt:
        """The one at hand. Raises `CameraError` when the recording is over."""
        if self.at >= len(self.attempts):
            raise CameraError(
                f"the recording is over: all {len(self.attempts)} attempts were played; open the workcell again"
            )
        return self.attempts[self.at]

    def look(self) -> Observation:
        """The recorded picture before the attempt at hand. Raises `CameraError` when the recording is over."""
        before = self.attempt().before
        return replace(before, color=before.color.copy(), intrinsics=self.intrinsics)


class ReplayArm:
    """An `Arm` that is nowhere: it can be parked, and nothing else."""

    info = ArmInfo("replay", max_width_m=0.08, max_speed_m_s=1.0, max_force_n=70.0)

    def pose(self) -> ToolPose:
        """Raises `ReachError`, as everything does that needs an arm."""
        _refuse()

    def move_to(self, target: ToolPose, speed_m_s: float) -> ToolPose:
        """Raises `ReachError`."""
        _refuse()

    def lower_until_contact(self, z_min: float, speed_m_s: float, force_n: float) -> ToolPose:
        """Raises `ReachError`."""
        _refuse()

    def move_gripper(self, width_m: float) -> float:
        """Raises `ReachError`."""
        _refuse()

    def grasp(self, force_n: float) -> float:
        """Raises `ReachError`."""
        _refuse()

    def gripper_width(self) -> float:
        """Raises `ReachError`."""
        _refuse()

    def park(self) -> ToolPose:
        """Out of every picture it is already."""
        return ToolPose(0.0, 0.0, 0.0)

    def stop(self) -> None:
        """It stands still."""


def _refuse() -> NoReturn:
    raise ReachError("a replayed arm cannot be moved; execute a whole action, or open a real workcell")


class ReplayWorkcell(Workcell):
    """Run a policy over old recordings through the same loop: what it plans is not done, only compared.

    `look` gives the recorded picture before; `execute`, whatever the action, the recorded outcome, and the next attempt
    is at hand.
    """

    def __init__(
        self,
        attempts: Sequence[Attempt],
        settings: WorkcellSettings | None = None,
        taken_by: CameraIdentity | None = None,
    ) -> None:
        """`attempts`: a `Dataset`, or any others. `taken_by`: the camera, where it is known (`Dataset.camera`).

        Calibrations of that camera are good for its pictures, which may have been resized for recording. Raises
        `BaggieError` where there are no attempts.
        """
        self._replayed = ReplayCamera(attempts)
        self._taken_by = taken_by
        super().__init__(ReplayArm(), self._replayed, settings or WorkcellSettings(name="replay"))

    @property
    def calibrated_camera(self) -> CameraIdentity:
        """The camera that took the pictures, at its own size, where it is known."""
        return self._taken_by or super().calibrated_camera

    @property
    def attempt(self) -> Attempt:
        """The recorded attempt at hand, to compare a plan with. Raises `CameraError` when the recording is over."""
        return self._replayed.attempt()

    def execute(self, action: PickPlace) -> Outcome:
        """The recorded outcome. Raises `LimitError` for an action outside the workspace, as every workcell does."""
        self.arm.check(action.pick, "pick")
        self.arm.check(action.place, "place")
        outcome = self.attempt.outcome
        self._replayed.at += 1
        return outcome

    def clock(self) -> float:
        """When the picture at hand was taken, seconds of the recording's clock."""
        return self.attempt.before.time
