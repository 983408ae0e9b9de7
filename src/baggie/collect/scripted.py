"""Demonstrations by a script that knows where everything is: whole episodes of tasks that take several steps."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

import cv2
import numpy as np

from baggie import seeds
from baggie.collect.recording import OpenCell, Recording, Size
from baggie.data import DatasetWriter, inspect_dataset
from baggie.data.record import fit, without_depth
from baggie.errors import BaggieError, LimitError, ReachError
from baggie.geometry import Grid
from baggie.operator import Operator
from baggie.options.collecting import CollectOptions
from baggie.pictures import recorded_size
from baggie.processes import OpenWorker
from baggie.registry import TASKS
from baggie.sim.cell import PICTURE_SIZE
from baggie.tasks.conditions import Score
from baggie.tasks.task import Task
from baggie.types import Attempt, Outcome
from baggie.workcell.workcell import Workcell
from baggie.workcell.workcell_file import SIMULATED

_NOT_LOOKED_FOR = np.full((4, 2), np.nan)
ROBOTS = {"cup": "simulated FR3 with a suction cup", "hand": SIMULATED}
"""What moves, by its tool."""


class Scripted:
    """Shows a task of the simulator, by its conditions."""

    doing, counted = "demonstrating", "demonstrations begun"
    simulated = True

    def __init__(self, options: CollectOptions, open_cell: OpenCell) -> None:
        self._options, self._open_cell = options, open_cell
        self._task = TASKS[options.task]
        self.robot = ROBOTS[self._task.tool]
        self.collection = {
            "task": self._task.name,
            "seed": options.seed,
            "cell": options.cell,
            "object_symmetry": self._task.object_symmetry,
            **({} if options.style == "plain" else {"style": options.style}),
        }

    def picture_size(self) -> Size:
        """That of what the task's policies see."""
        return size_of(self._task)

    def begun(self, writer: DatasetWriter) -> int:
        """How many demonstrations there are at least a step of."""
        return sum(number < self._options.attempts for number in writer.episodes)

    def missing(self, writer: DatasetWriter) -> list[int]:
        """The numbers of demonstrations still to be shown."""
        return missing_demonstrations(self._options.attempts, writer.episodes)

    def open_worker(self, recording: Recording) -> OpenWorker[int, list[Attempt]]:
        """Shows whole demonstrations, each by its number."""
        return functools.partial(_open_worker, self._open_cell, self._task.name, recording)

    def summary(self, rate: float | None) -> dict[str, Any]:
        """What `inspect` says of the recording, and the demonstrations a minute."""
        return {**inspect_dataset(self._options.out), "demonstrations_per_minute": rate}


def size_of(task: Task) -> Size:
    """`(width, height)` pixels at which a task's pictures are recorded in the simulator."""
    rows, columns = Grid().shape
    return (columns, rows) if task.view == "height-map" else recorded_size(PICTURE_SIZE)


def missing_demonstrations(count: int, recorded: Mapping[int, int]) -> list[int]:
    """The numbers still to be shown, of `0 .. count - 1`; first the one that may have been cut short.

    `recorded`: how many steps there are of each, in the order in which they were recorded, one after the other: so all
    but the last of them are whole.
    """
    last = [number for number in list(recorded)[-1:] if number < count]
    return last + [number for number in range(count) if number not in recorded]


def demonstrate(cell: Workcell, task: Task, recording: Recording, number: int) -> list[Attempt]:
    """Demonstration `number`, step by step; it depends on seed, cell and number alone.

    Only the last attempt has a picture after: that of the others is the next one's before. What the demonstrator
    asks for and the arm cannot reach ends it.
    """
    cell.reset((seeds.COLLECTION, recording.seed, number))
    return list(_steps(cell, task, recording, number))


def _steps(cell: Workcell, task: Task, recording: Recording, number: int) -> Iterator[Attempt]:
    assert cell.scene is not None
    score = Score(cell.scene.conditions)
    before = cell.look()
    for step in range(task.max_steps):
        whims = None
        if recording.style == "varied":
            whims = seeds.generator(seeds.STYLE, recording.seed, number, step)
        began, action = cell.clock(), cell.demonstrate(whims)
        if action is None:
            return
        try:
            outcome = cell.execute(action)
        except (LimitError, ReachError):
            outcome = Outcome(action, failure="unreachable")
        after = cell.look()
        ends = outcome.failure == "unreachable" or step == task.max_steps - 1 or cell.demonstrate() is None
        state = cell.state()
        assert state is not None
        attempt = Attempt(
            attempt_id=number * task.max_steps + step,
            task=recording.instruction,
            before=before,
            after=after if ends else None,
            commanded=action,
            outcome=outcome,
            box_before=_NOT_LOOKED_FOR,
            box_after=_NOT_LOOKED_FOR,
            cell=recording.cell,
            seed=recording.seed,
            time=began,
            episode=number,
            step=step,
            object_symmetry=task.object_symmetry,
            reward=score.count(state),
        )
        yield fit(attempt if recording.depth else without_depth(attempt), recording.size)
        if ends:
            return
        before = after


def _open_worker(
    open_cell: OpenCell, name: str, recording: Recording, _operator: Operator
) -> Callable[[int], Iterable[list[Attempt]]]:
    cv2.setNumThreads(1)
    task, cell = TASKS[name], open_cell(recording.cell)

    def show(number: int) -> Iterable[list[Attempt]]:
        shown = demonstrate(cell, task, recording, number)
        if not shown:
            raise BaggieError(
                f"expected something to do in every scene of {name}, got demonstration {number}, in which nothing is; "
                "draw scenes in which not every condition holds yet"
            )
        yield shown

    return show
