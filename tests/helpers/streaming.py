"""Work that goes to workers of its own, done here: what costs most of a short test is the start of a process."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from baggie.operator import Operator
from baggie.processes import OpenWorker, Result, Task


class Here:
    """An executor that does everything in this process; keeps how many workers it was asked for each time."""

    def __init__(self) -> None:
        self.workers: list[int] = []

    def stream(
        self, open_worker: OpenWorker[Task, Result], tasks: Iterable[Task], workers: int, operator: Operator
    ) -> Iterator[Result]:
        """As `Executor.stream`."""
        self.workers.append(workers)
        run = open_worker(operator)
        for task in tasks:
            yield from run(task)
