"""What the collector asks of a workcell.

Which workcell is collected in.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from baggie.cameras.camera import Camera
from baggie.errors import BaggieError
from baggie.geometry import PlanarPose
from baggie.options.choices import USUAL_TASK, CollectedScenery
from baggie.options.collecting import CollectOptions
from baggie.registry import TASKS
from baggie.robot.arm import Arm
from baggie.types import Observation, Outcome, PickPlace
from baggie.workcell.config import open_written
from baggie.workcell.workcell import Calibrations, Watch, WorkcellSettings
from baggie.workcell.workcell_file import SIMULATED, WorkcellFile, read_workcell_file


@runtime_checkable
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


OpenCell = Callable[[int], CollectorCell]
"""Opens the cell with a number; picklable, because each worker process opens its own."""


def open_simulated_cell(
    number: int, task: str = USUAL_TASK, scenery: CollectedScenery = "plain"
) -> CollectorCell:
    """The simulated workcell; imported late, because MuJoCo takes its time."""
    from baggie.workcell.simulated import open_simulated  # noqa: PLC0415

    return open_simulated(number, task, scenery=scenery, depth=TASKS[task].depth)


def open_written_cell(written: WorkcellFile, path: Path, number: int) -> CollectorCell:
    """The workcell `written` in a file. Raises `BaggieError` for one that cannot be used, or of another cell."""
    cell = open_written(written, path)
    if not isinstance(cell, CollectorCell):
        cell.close()
        raise BaggieError(
            f"expected {path} to describe a workcell with an arm, to collect in; a recording has none"
        )
    if not written.arm.real and written.cell != number:
        cell.close()
        raise BaggieError(f"{path} describes cell {written.cell}, not {number}; give --cell to match")
    return cell


def what_opens(
    options: CollectOptions, open_cell: OpenCell | None = None
) -> tuple[OpenCell, str, dict[str, Any]]:
    """What opens the cell that the options say, what a recording of it says moved, and what else it says of the cell.

    Or `open_cell`, where it is given, whose arm says its name. A file is read once, now: of it a recording says what
    lies on the table and where.

    Raises `BaggieError` for a file that cannot be used, and where there are more workers than arms.
    """
    opener, robot, table = _written(options)
    if open_cell is not None:
        with closing(open_cell(options.cell)) as cell:
            return open_cell, cell.arm.info.name, table
    return opener, robot(), table


def _written(options: CollectOptions) -> tuple[OpenCell, Callable[[], str], dict[str, Any]]:
    """As `what_opens`, but the robot's name only where it is asked for: some arms have to be made for it."""
    if options.workcell is None:
        return (
            functools.partial(open_simulated_cell, task=options.task, scenery=options.scenery),
            lambda: SIMULATED,
            {},
        )
    path = options.workcell
    written = read_workcell_file(path)
    if written.arm.real and options.workers not in (None, 1):
        raise BaggieError(f"expected --workers 1 with {path}, which has one arm, got {options.workers}")
    table = {**written.model_dump(mode="json", include={"workspace"}), "bag": written.bag.recorded()}
    opener = functools.partial(open_written_cell, written, path)
    return opener, functools.partial(written.arm.title, path.parent), {"workcell": table}
