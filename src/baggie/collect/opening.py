"""Which workcell is collected in."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path

from baggie.collect.cell import CollectorCell
from baggie.collect.options import CollectedScenery, CollectOptions
from baggie.errors import BaggieError

OpenCell = Callable[[int], CollectorCell]
"""Opens the cell with a number; picklable, because each worker process opens its own."""
SIMULATED = "simulated FR3"


def open_simulated_cell(number: int, scenery: CollectedScenery = "plain") -> CollectorCell:
    """The simulated workcell; imported late, because MuJoCo takes its time."""
    from baggie.workcell.simulated import open_simulated  # noqa: PLC0415

    return open_simulated(number, scenery=scenery)


def open_file_cell(path: Path, number: int) -> CollectorCell:
    """The workcell a file describes. Raises `BaggieError` for a file that cannot be used, or of another cell."""
    from baggie.workcell.config import open_workcell  # noqa: PLC0415 -- MuJoCo takes its time
    from baggie.workcell.real import RealWorkcell  # noqa: PLC0415
    from baggie.workcell.simulated import SimulatedWorkcell  # noqa: PLC0415

    cell = open_workcell(path)
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


def opener(options: CollectOptions) -> OpenCell:
    """What opens the cell that the options say."""
    if options.workcell is not None:
        return functools.partial(open_file_cell, options.workcell)
    return functools.partial(open_simulated_cell, scenery=options.scenery)


def robot_of(options: CollectOptions) -> str:
    """What the recording says moved. Raises `BaggieError` where there are more workers than arms."""
    from baggie.workcell.franka_models import MODELS  # noqa: PLC0415 -- MuJoCo takes its time
    from baggie.workcell.workcell_file import REAL_ARMS, FrankaEntry, read_workcell_file  # noqa: PLC0415

    arm = read_workcell_file(options.workcell).arm if options.workcell is not None else None
    if not isinstance(arm, REAL_ARMS):
        return SIMULATED
    if options.workers != 1:
        raise BaggieError(
            f"expected --workers 1 with {options.workcell}, which has one arm, got {options.workers or 'all cores'}"
        )
    return MODELS[arm.model].title if isinstance(arm, FrankaEntry) else arm.kind
