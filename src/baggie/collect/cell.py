"""Which workcell is collected in."""

from __future__ import annotations

import functools
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

from baggie.errors import BaggieError
from baggie.options.collecting import CollectOptions
from baggie.options.values import USUAL_TASK, CollectedScenery
from baggie.registry import TASKS
from baggie.workcell.config import open_written
from baggie.workcell.replay import ReplayWorkcell
from baggie.workcell.workcell import Workcell
from baggie.workcell.workcell_file import SIMULATED, WorkcellFile, read_workcell_file

OpenCell = Callable[[int], Workcell]
"""Opens the cell with a number; picklable, because each worker process opens its own."""


def open_simulated_cell(number: int, task: str = USUAL_TASK, scenery: CollectedScenery = "plain") -> Workcell:
    """The simulated workcell; imported late, because MuJoCo takes its time."""
    from baggie.workcell.simulated import open_simulated  # noqa: PLC0415

    return open_simulated(number, task, scenery=scenery, depth=TASKS[task].depth)


def open_written_cell(written: WorkcellFile, path: Path, number: int) -> Workcell:
    """The workcell `written` in a file. Raises `BaggieError` for one that cannot be used, or of another cell."""
    cell = open_written(written, path)
    if isinstance(cell, ReplayWorkcell):
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
