"""Which workcell is collected in."""

from __future__ import annotations

import functools
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

from baggie.errors import BaggieError
from baggie.options.collecting import CollectOptions
from baggie.options.values import USUAL_TASK, CollectedScenery
from baggie.registry import TASKS
from baggie.workcell.workcell import Workcell

if TYPE_CHECKING:
    from baggie.workcell.workcell_file import WorkcellFile


OpenCell = Callable[[int], Workcell]
"""Opens the cell with a number; picklable, because each worker process opens its own."""
SIMULATED = "simulated FR3"


def open_simulated_cell(number: int, task: str = USUAL_TASK, scenery: CollectedScenery = "plain") -> Workcell:
    """The simulated workcell; imported late, because MuJoCo takes its time."""
    from baggie.workcell.simulated import open_simulated  # noqa: PLC0415

    return open_simulated(number, task, scenery=scenery, depth=TASKS[task].depth)


def open_written_cell(written: WorkcellFile, path: Path, number: int) -> Workcell:
    """The workcell `written` in a file. Raises `BaggieError` for one that cannot be used, or of another cell."""
    from baggie.workcell.config import RealWorkcell, open_written  # noqa: PLC0415 -- MuJoCo takes its time
    from baggie.workcell.simulated import SimulatedWorkcell  # noqa: PLC0415

    cell = open_written(written, path)
    if isinstance(cell, RealWorkcell):
        return cell
    if not isinstance(cell, SimulatedWorkcell):
        cell.close()
        raise BaggieError(
            f"expected {path} to describe a workcell with an arm, to collect in; a recording has none"
        )
    if cell.world.cell.number != number:
        cell.close()
        raise BaggieError(
            f"{path} describes cell {cell.world.cell.number}, not {number}; give --cell to match"
        )
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
    from baggie.workcell.workcell_file import REAL_ARMS, read_workcell_file  # noqa: PLC0415 -- MuJoCo takes its time

    path = options.workcell
    written = read_workcell_file(path)
    if isinstance(written.arm, REAL_ARMS) and options.workers not in (None, 1):
        raise BaggieError(f"expected --workers 1 with {path}, which has one arm, got {options.workers}")
    table = {**written.model_dump(mode="json", include={"workspace"}), "bag": written.bag.recorded()}
    opener = functools.partial(open_written_cell, written, path)
    return opener, functools.partial(robot_of, written, path), {"workcell": table}


def robot_of(written: WorkcellFile, path: Path) -> str:
    """What moves in the workcell `written` in a file. Raises `BaggieError` where its arm cannot be made here."""
    from baggie.robot.franka.models import MODELS  # noqa: PLC0415
    from baggie.workcell.config import arm_of  # noqa: PLC0415 -- MuJoCo takes its time
    from baggie.workcell.workcell_file import FrankaEntry  # noqa: PLC0415

    if isinstance(written.arm, FrankaEntry):  # whatever its address
        return MODELS[written.arm.model].title
    arm = arm_of(written, path)
    return SIMULATED if arm is None else arm.name
