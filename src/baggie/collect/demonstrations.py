"""Demonstrations of tasks that take several steps: someone who knows where everything is shows how it is done."""

from __future__ import annotations

import functools
import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, Protocol

import cv2
import numpy as np

from baggie import seeds
from baggie.collect.sitting import Recording
from baggie.data import DatasetWriter, inspect_dataset
from baggie.data.record import fit, without_depth
from baggie.errors import LimitError, ReachError
from baggie.geometry import Grid
from baggie.operator import Operator, TerminalOperator, progress
from baggie.options.collecting import CollectOptions
from baggie.pictures import recorded_size
from baggie.processes import Executor, LocalProcesses
from baggie.registry import TASKS
from baggie.seeds import generator
from baggie.sim.cell import PICTURE_SIZE
from baggie.tasks.task import Task
from baggie.types import Attempt, Observation, Outcome, PickPlace
from baggie.workcell.workcell_file import SIMULATED

_NOT_LOOKED_FOR = np.full((4, 2), np.nan)
ROBOTS = {"cup": "simulated FR3 with a suction cup", "hand": SIMULATED}
"""What moved, by its tool."""


class DemonstratorCell(Protocol):
    """A workcell with a task and somebody who can do it."""

    @property
    def task(self) -> Task: ...  # noqa: D102 -- a workcell's attributes

    def reset(self, seed: Sequence[int]) -> None:
        """A new scene, drawn from the stream these integers name."""
        ...

    def look(self) -> Observation:
        """The table from straight above, the arm out of the way."""
        ...

    def demonstrate(self, rng: np.random.Generator | None = None) -> PickPlace | None:
        """What to do next; None when all is done. With a stream in the style of others, drawn from it."""
        ...

    def execute(self, action: PickPlace) -> Outcome:
        """Pick, verify, carry, place. Raises `LimitError` or `ReachError`; then the object is where it was."""
        ...

    def count(self) -> float:
        """What has been done of the task since the last call, all of it being 1."""
        ...

    def clock(self) -> float:
        """Seconds since the scene began."""
        ...


OpenDemonstratorCell = Callable[[str, int], DemonstratorCell]
"""Opens the cell for a task by name, with a number; picklable, because each worker process opens its own."""


def open_simulated_demonstrator(task: str, number: int) -> DemonstratorCell:
    """The simulated workcell with blocks; imported late, because MuJoCo takes its time."""
    from baggie.workcell.simulated import open_simulated  # noqa: PLC0415

    return open_simulated(number, task)


def demonstrate(cell: DemonstratorCell, recording: Recording, number: int) -> list[Attempt]:
    """Demonstration `number`, step by step; it depends on seed, cell and number alone.

    Only the last attempt has a picture after: that of the others is the next one's before. What the demonstrator
    asks for and the arm cannot reach ends it.
    """
    cell.reset((seeds.COLLECTION, recording.seed, number))
    return list(_steps(cell, recording, number))


def _steps(cell: DemonstratorCell, recording: Recording, number: int) -> Iterator[Attempt]:
    before = cell.look()
    for step in range(cell.task.max_steps):
        whims = generator(seeds.STYLE, recording.seed, number, step) if recording.style == "varied" else None
        began, action = cell.clock(), cell.demonstrate(whims)
        if action is None:
            return
        try:
            outcome = cell.execute(action)
        except (LimitError, ReachError):
            outcome = Outcome(action, failure="unreachable")
        after = cell.look()
        ends = (
            outcome.failure == "unreachable" or step == cell.task.max_steps - 1 or cell.demonstrate() is None
        )
        attempt = Attempt(
            attempt_id=number * cell.task.max_steps + step,
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
            object_symmetry=cell.task.object_symmetry,
            reward=cell.count(),
        )
        yield fit(attempt if recording.depth else without_depth(attempt), recording.size)
        if ends:
            return
        before = after


def open_demonstrator(
    open_cell: OpenDemonstratorCell, task: str, recording: Recording, _operator: Operator
) -> Callable[[int], Iterable[list[Attempt]]]:
    """What a worker process does: show whole demonstrations, each by its number."""
    cv2.setNumThreads(1)
    cell = open_cell(task, recording.cell)

    def show(number: int) -> Iterable[list[Attempt]]:
        yield demonstrate(cell, recording, number)

    return show


def size_of(task: Task) -> tuple[int, int]:
    """`(width, height)` pixels at which a task's pictures are recorded in the simulator."""
    rows, columns = Grid().shape
    return (columns, rows) if task.view == "height-map" else recorded_size(PICTURE_SIZE)


def record_demonstrations(
    options: CollectOptions,
    open_cell: OpenDemonstratorCell = open_simulated_demonstrator,
    *,
    operator: Operator | None = None,
    executor: Executor | None = None,
) -> dict[str, Any]:
    """Record until `options.attempts` demonstrations are in `options.out`; the summary, ready for JSON.

    The person at the terminal is told, and processes of this machine show them, unless `operator` or `executor` is
    given.
    Raises `BaggieError` when the disk is full or the folder holds another recording, and `KeyboardInterrupt`, with how
    to go on as its message, when stopped; what was recorded before stays, and the same command goes on from there.
    """
    task = TASKS[options.task]
    size = size_of(task)
    recording = Recording(task.instruction, options.seed, options.cell, size, options.style, depth=task.depth)
    with DatasetWriter(
        options.out,
        task=task.instruction,
        robot_type=ROBOTS[task.tool],
        picture_size=size,
        collection={
            "task": task.name,
            "seed": options.seed,
            "cell": options.cell,
            "object_symmetry": task.object_symmetry,
            **({} if options.style == "plain" else {"style": options.style}),
        },
    ) as writer:
        try:
            worker = functools.partial(open_demonstrator, open_cell, options.task, recording)
            workers, operator = options.workers or os.cpu_count() or 1, operator or TerminalOperator()
            run = functools.partial(
                (executor or LocalProcesses()).stream, worker, workers=workers, operator=operator
            )
            rate = _record(options, writer, run, operator)
        except KeyboardInterrupt:
            begun = f"{len(writer.episodes)} of {options.attempts} demonstrations begun"
            raise KeyboardInterrupt(f"interrupted with {begun}; go on with: {options.command()}") from None
    return {**inspect_dataset(options.out), "demonstrations_per_minute": rate}


def missing_demonstrations(count: int, recorded: Mapping[int, int]) -> list[int]:
    """The numbers still to be shown, of `0 .. count - 1`; first the one that may have been cut short.

    `recorded`: how many steps there are of each, in the order in which they were recorded, one after the other: so all
    but the last of them are whole.
    """
    last = [number for number in list(recorded)[-1:] if number < count]
    return last + [number for number in range(count) if number not in recorded]


def first_of_all(first: int | None, shown: Iterable[list[Attempt]]) -> Iterator[list[Attempt]]:
    """Demonstrations as they come, but none before that with the number `first`: nothing may come between its steps."""
    waiting: list[list[Attempt]] = []
    for attempts in shown:
        if first is None or attempts[0].episode == first:
            first = None
            yield attempts
            yield from waiting
            waiting = []
        else:
            waiting.append(attempts)


def _record(
    options: CollectOptions,
    writer: DatasetWriter,
    run: Callable[[Iterable[int]], Iterator[list[Attempt]]],
    operator: Operator,
) -> float | None:
    """Have what is missing `run`; demonstrations a minute, or None when nothing was."""
    recorded = dict(writer.episodes)
    missing = missing_demonstrations(options.attempts, recorded)
    cut_short = missing[0] if missing and missing[0] in recorded else None
    done, start = 0, time.monotonic()
    with progress(operator, "demonstrating", options.attempts, options.attempts - len(missing)) as advance:
        for attempts in first_of_all(cut_short, run(missing)):
            for attempt in attempts:
                if attempt.attempt_id not in writer.attempt_ids:
                    writer.append(attempt)
            done += 1
            advance(f"{60 * done / (time.monotonic() - start):.0f} a minute")
    return 60 * done / (time.monotonic() - start) if done else None
