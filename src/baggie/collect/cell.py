"""What the collector asks of a workcell."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

from baggie.geometry import PlanarPose
from baggie.types import Observation, Outcome, PickPlace
from baggie.workcell.arm import Arm
from baggie.workcell.calibrations import Calibrations
from baggie.workcell.camera import Camera
from baggie.workcell.watch import Watch
from baggie.workcell.workcell import WorkcellSettings

Ask = Callable[[str], bool]
"""Asks a person for help, in one line; True when it is worth another look."""


class CollectorCell(Protocol):
    """A workcell that can start a sitting afresh and be put right when the object is lost."""

    @property
    def arm(self) -> Arm: ...  # noqa: D102 -- a workcell's attributes
    @property
    def camera(self) -> Camera: ...  # noqa: D102 -- a workcell's attributes
    @property
    def settings(self) -> WorkcellSettings: ...  # noqa: D102 -- a workcell's attributes

    @property
    def repeatable(self) -> bool:
        """Whether `reset` gives the same scene again, and with it the same attempts."""
        ...

    calibrations: Calibrations
    watch: Watch | None
    """Set once the cell is calibrated; then `look` raises `BumpedError` when the camera or the table has moved."""

    def look(self) -> Observation:
        """A picture with the arm out of the way."""
        ...

    def execute(self, action: PickPlace) -> Outcome:
        """Pick, verify, carry, place. Raises `LimitError` or `ReachError`; then the object is where it was."""
        ...

    def reset(self, seed: Sequence[int]) -> None:
        """A new scene, drawn from the stream these integers name, where the cell is repeatable."""
        ...

    def rescue(self) -> bool:
        """Get the object back into the workspace; whether that was done."""
        ...

    def truth(self) -> PlanarPose | None:
        """The object's true pose, recorded for evaluation only; None where nobody knows."""
        ...

    def show_paddle(self, shown: bool) -> None:
        """Put the calibration marker into the hand, or take it away."""
        ...

    def clock(self) -> float:
        """Seconds since the scene began."""
        ...

    def close(self) -> None:
        """Let go of everything."""
        ...
