"""Work handed to workers that stream their results back: an `Executor`, such as processes of this machine."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
import traceback
from collections.abc import Callable, Iterable, Iterator
from multiprocessing.connection import Connection, wait
from typing import Any, Protocol, TypeVar

from baggie.errors import BaggieError, NobodyError, explained
from baggie.operator import Answer, Event, Operator, Question

Task = TypeVar("Task")
Result = TypeVar("Result")

_PARENT_CHECK_S = 0.5
OpenWorker = Callable[[Operator], Callable[[Task], Iterable[Result]]]
"""Makes what does one task after another, given whom it can tell and ask; picklable, as are tasks and results."""


class Executor(Protocol):
    """Where work is done that needs not be done here."""

    def stream(
        self,
        open_worker: OpenWorker[Task, Result],
        tasks: Iterable[Task],
        workers: int,
        operator: Operator,
    ) -> Iterator[Result]:
        """Every result of every task, each as soon as it is there, of at most so many workers at a time.

        Tasks are taken in order, by whichever worker is free; `open_worker` is called once in each. What workers tell
        and ask goes to `operator`; results wait while one is asked.

        A `BaggieError` in a worker is raised here as it is, after the results that came before it; any other
        exception, and a worker's death, as a `RuntimeError`, with the worker's traceback.
        """
        ...


class LocalProcesses:
    """Processes of this machine, which never outlive the one that started them.

    They are spawned, not forked: a forked GL context or thread pool does not work. They end with this process, even
    when it is killed with SIGKILL, and leave Ctrl-C to it.
    """

    def stream(
        self,
        open_worker: OpenWorker[Task, Result],
        tasks: Iterable[Task],
        workers: int,
        operator: Operator,
    ) -> Iterator[Result]:
        """Stream as `Executor.stream` does, with a process for each worker."""
        queue = iter(tasks)
        context = multiprocessing.get_context("spawn")
        processes = []
        busy: list[Connection] = []
        try:
            for _, task in zip(range(workers), queue, strict=False):
                ours, theirs = context.Pipe()
                process = context.Process(target=_work, args=(open_worker, theirs, os.getpid()), daemon=True)
                process.start()
                theirs.close()  # so that the end of the worker is the end of its stream
                ours.send(task)
                processes.append(process)
                busy.append(ours)
            while busy:
                for connection in wait(busy):
                    assert isinstance(connection, Connection)
                    kind, value = _receive(connection)
                    match kind:
                        case "result":
                            yield value
                        case "told":
                            operator.tell(value)
                        case "attended":
                            connection.send(operator.attended)
                        case "asked":
                            connection.send(_answer(operator, value))
                        case "done":
                            try:
                                connection.send(next(queue))
                            except StopIteration:
                                busy.remove(connection)
        finally:
            for process in processes:
                process.kill()
            for process in processes:
                process.join()


def _answer(operator: Operator, question: Question[Answer]) -> Answer | NobodyError:
    try:
        return operator.ask(question)
    except NobodyError as error:
        return error


class _Above:
    """The operator of the process that started this worker."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    @property
    def attended(self) -> bool:
        """Whether somebody is there now."""
        self._connection.send(("attended", None))
        return bool(self._connection.recv())

    def tell(self, event: Event) -> None:
        """Pass it on."""
        self._connection.send(("told", event))

    def ask(self, question: Question[Answer]) -> Answer:
        """Pass it on, and wait. Raises `NobodyError`."""
        self._connection.send(("asked", question))
        answer: Answer | NobodyError = self._connection.recv()
        if isinstance(answer, NobodyError):
            raise answer
        return answer


def _receive(connection: Connection) -> tuple[str, Any]:
    try:
        kind, value = connection.recv()
    except (EOFError, OSError):
        raise RuntimeError("a worker process died; with little memory, try fewer workers") from None
    if kind == "error":
        raise value
    if kind == "crash":
        raise RuntimeError(f"a worker process failed:\n{value}")
    return kind, value


def _work(open_worker: OpenWorker[Task, Result], connection: Connection, parent: int) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the parent decides
    threading.Thread(target=_die_with, args=(parent,), daemon=True).start()
    try:
        run = open_worker(_Above(connection))
        while True:
            for result in run(connection.recv()):
                connection.send(("result", result))
            connection.send(("done", None))
    except (EOFError, ConnectionError):
        return  # the parent has gone
    except BaggieError as error:
        connection.send(("error", error))
    except ImportError as error:
        missing = explained(error)
        connection.send(("error", missing) if missing else ("crash", traceback.format_exc()))
    except Exception:
        connection.send(("crash", traceback.format_exc()))


def _die_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(_PARENT_CHECK_S)
    os._exit(1)
