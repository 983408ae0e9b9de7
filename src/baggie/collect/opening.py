"""Which workcell is collected in."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from baggie.collect.cell import CollectorCell
from baggie.collect.options import CollectedScenery, CollectOptions
from baggie.errors import BaggieError

if TYPE_CHECKING:
    from baggie.workcell.workcell_file import WorkcellFile

OpenCell = Callable[[int], CollectorCell]
"""Opens the cell with a number; picklable, because each worker process opens its own."""
SIMULATED = "simulated FR3"


def open_simulated_cell(number: int, scenery: CollectedScenery = "plain") -> CollectorCell:
    """The simulated workcell; imported late, because MuJoCo takes its time."""
    from baggie.workcell.simulated import open_simulated  # noqa: PLC0415

    return open_simulated(number, scenery=scenery)


def open_written_cell(written: WorkcellFile, path: Path, number: int) -> CollectorCell:
    """The workcell `written` in a file. Raises `BaggieError` for one that cannot be used, or of another cell."""
    from baggie.workcell.config import open_written  # noqa: PLC0415 -- MuJoCo takes its time
    from baggie.workcell.real import RealWorkcell  # noqa: PLC0415
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


def what_opens(options: CollectOptions) -> tuple[OpenCell, str, dict[str, Any]]:
    """What opens the cell that the options say, what a recording of it says moved, and what else it says of the cell.

    A file is read once, now: of it a recording says what lies on the table and where.

    Raises `BaggieError` for a file that cannot be used, and where there are more workers than arms.
    """
    if options.workcell is None:
        return functools.partial(open_simulated_cell, scenery=options.scenery), SIMULATED, {}
    from baggie.workcell.workcell_file import REAL_ARMS, read_workcell_file  # noqa: PLC0415 -- MuJoCo takes its time

    written = read_workcell_file(options.workcell)
    if isinstance(written.arm, REAL_ARMS) and options.workers not in (None, 1):
        raise BaggieError(
            f"expected --workers 1 with {options.workcell}, which has one arm, got {options.workers}"
        )
    table = written.model_dump(mode="json", include={"bag", "workspace"})
    opener = functools.partial(open_written_cell, written, options.workcell)
    return opener, _robot(written), {"workcell": table}


def _robot(written: WorkcellFile) -> str:
    from baggie.workcell.franka_models import MODELS  # noqa: PLC0415 -- MuJoCo takes its time
    from baggie.workcell.workcell_file import REAL_ARMS, FrankaEntry  # noqa: PLC0415

    if isinstance(written.arm, FrankaEntry):
        return MODELS[written.arm.model].title
    return written.arm.kind if isinstance(written.arm, REAL_ARMS) else SIMULATED
