"""Work spread over processes that stream their results back and never outlive the one that started them."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
import traceback
from collections.abc import Callable, Iterable, Iterator
from multiprocessing.connection import Connection, wait
from typing import TypeVar, cast

from baggie.errors import BaggieError, explained

Task = TypeVar("Task")
Result = TypeVar("Result")

_PARENT_CHECK_S = 0.5
_to_parent: Connection | None = None
"""Of a worker."""


def nobody(_question: str) -> bool:
    """No, whatever is asked."""
    return False


def ask_parent(question: str) -> bool:
    """Wait for what the process that started this worker answers to a question; no where this is no worker."""
    if _to_parent is None:
        return nobody(question)
    _to_parent.send(("question", question))
    return bool(_to_parent.recv())


def stream_in_processes(
    open_worker: Callable[[], Callable[[Task], Iterable[Result]]],
    tasks: Iterable[Task],
    workers: int,
    answer: Callable[[str], bool] = nobody,
) -> Iterator[Result]:
    """Every result of `open_worker()(task)` for every task, each as soon as it is there.

    Tasks are taken in order, by whichever process is free. `open_worker` is called once in each process and
    must be picklable, as must tasks and results. Processes are spawned, not forked: a forked GL context or
    thread pool does not work. They end with this process, even when it is killed with SIGKILL, and leave
    Ctrl-C to it. `answer` is called here for what a worker asks (`ask_parent`); results wait meanwhile.

    A `BaggieError` in a worker is raised here as it is, after the results that came before it; any other
    exception, and a worker's death, as a `RuntimeError`, with the worker's traceback.
    """
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
                if kind == "result":
                    yield cast(Result, value)
                    continue
                if kind == "question":
                    connection.send(answer(str(value)))
                    continue
                try:
                    connection.send(next(queue))
                except StopIteration:
                    busy.remove(connection)
    finally:
        for process in processes:
            process.kill()
        for process in processes:
            process.join()


def _receive(connection: Connection) -> tuple[str, object]:
    try:
        kind, value = connection.recv()
    except (EOFError, OSError):
        raise RuntimeError("a worker process died; with little memory, try fewer workers") from None
    if kind == "error":
        raise value
    if kind == "crash":
        raise RuntimeError(f"a worker process failed:\n{value}")
    return kind, value


def _work(
    open_worker: Callable[[], Callable[[Task], Iterable[Result]]], connection: Connection, parent: int
) -> None:
    global _to_parent  # noqa: PLW0603 -- what a worker does need not hand it down to where somebody asks
    _to_parent = connection
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the parent decides
    threading.Thread(target=_die_with, args=(parent,), daemon=True).start()
    try:
        run = open_worker()
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
