"""Collect a recording unattended: whoever shows how the task is done works on every core, and one loop records it."""

from __future__ import annotations

import functools
import os
import time
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from baggie.collect.patience import Awaited, Patience
from baggie.collect.recording import Demonstrator, OpenCell, Recording, Work, open_simulated_cell
from baggie.collect.scripted import Scripted
from baggie.collect.self_taught import SelfTaught
from baggie.data import DatasetWriter
from baggie.data.summary import did_its_task
from baggie.operator import Line, Operator, TerminalOperator, progress
from baggie.options.collecting import CollectOptions
from baggie.processes import Executor, LocalProcesses
from baggie.registry import TASKS
from baggie.types import Attempt


def collect(
    options: CollectOptions,
    open_cell: OpenCell | None = None,
    *,
    operator: Operator | None = None,
    executor: Executor | None = None,
) -> dict[str, Any]:
    """Collect until `options.attempts` attempts or demonstrations are in `options.out`; the summary, ready for JSON.

    In the cell that the options say, unless `open_cell` opens another. Faults of an arm or a camera that are not
    simulated are borne with patience (`patience.py`), and a person is asked for what only one can do: the one at the
    terminal unless `operator` is given. Attempts are made in processes of this machine unless `executor` is given.
    Raises `BaggieError` when faults do not end, nobody helps, the cell cannot be calibrated, the disk is full, or the
    folder holds another recording: what was recorded before stays, and the same command goes on from there. Raises
    `KeyboardInterrupt`, with how to go on as its message, when stopped.
    """
    options.check()
    operator = operator or TerminalOperator()
    if options.demonstrated:
        usual = functools.partial(open_simulated_cell, task=options.task)
        return _collect(options, Scripted(options, open_cell or usual), operator, executor)
    return _collect(options, SelfTaught(options, open_cell, operator), operator, executor)


def _collect(
    options: CollectOptions, demonstrator: Demonstrator[Work], operator: Operator, executor: Executor | None
) -> dict[str, Any]:
    task, simulated = TASKS[options.task], demonstrator.simulated
    writer: DatasetWriter | None = None
    try:
        with DatasetWriter(
            options.out,
            task=task.instruction,
            robot_type=demonstrator.robot,
            picture_size=demonstrator.picture_size,
            collection=demonstrator.collection,
        ) as writer:
            size = writer.settings.picture_size
            recording = Recording(
                task.instruction,
                options.seed,
                options.cell,
                size,
                options.style,
                depth=task.depth,
                stacks=task.has_goal and len(task.things) > 1,
            )
            awaited = Awaited(operator, 60 * options.wait, can_help=not simulated)
            run = functools.partial(
                (executor or LocalProcesses()).stream,
                demonstrator.open_worker(recording),
                workers=options.workers or ((os.cpu_count() or 1) if simulated else 1),
                operator=awaited,
            )
            rate = _record(options, demonstrator, writer, run, awaited)
    except KeyboardInterrupt:
        recorded = (
            f"{demonstrator.begun(writer) if writer else 0} of {options.attempts} {demonstrator.counted}"
        )
        raise KeyboardInterrupt(f"interrupted with {recorded}; go on with: {options.command()}") from None
    return demonstrator.summary(rate)


def _record(
    options: CollectOptions,
    demonstrator: Demonstrator[Work],
    writer: DatasetWriter,
    run: Callable[[Iterable[Work]], Iterator[list[Attempt]]],
    operator: Awaited,
) -> float | None:
    """Have what is missing `run`; how many episodes a minute, or None when nothing was."""
    work = demonstrator.missing(writer)
    if not work:
        operator.tell(Line(f"all {options.attempts} {demonstrator.counted} already"))
        return None
    patience = Patience.for_cell(operator.operator, simulated=demonstrator.simulated)
    cut_short = work[0] if work[0] in writer.episodes else None
    recorded = demonstrator.begun(writer) - (cut_short is not None)
    done, good, start = 0, 0, time.monotonic()

    def missing() -> Iterator[list[Attempt]]:
        return run(demonstrator.missing(writer))

    with progress(operator, demonstrator.doing, options.attempts, recorded) as advance:
        for attempts in first_of_all(cut_short, patience.bear(missing)):
            for attempt in attempts:
                if attempt.attempt_id not in writer.attempt_ids:
                    writer.append(attempt)
            succeeded = attempts[-1].outcome.success and did_its_task(attempt.reward for attempt in attempts)
            if succeeded:
                operator.worked()
            done, good = done + 1, good + succeeded
            rate = 60 * done / (time.monotonic() - start)
            advance(f"{good}/{done} succeeded, {rate:.0f} a minute")
    return 60 * done / (time.monotonic() - start)


def first_of_all(first: object, shown: Iterable[list[Attempt]]) -> Iterator[list[Attempt]]:
    """Episodes as they come, but none before the one with the number `first`: nothing may come between its steps.

    As they come where that is None.
    """
    waiting: list[list[Attempt]] = []
    for attempts in shown:
        if first is None or attempts[0].episode == first:
            first = None
            yield attempts
            yield from waiting
            waiting = []
        else:
            waiting.append(attempts)
