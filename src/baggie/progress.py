"""The progress that everything long shows on stderr: a bar on a terminal, now and then a line where there is none.

The terminal: whether a person is at it, and what that person answers.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)


def is_attended() -> bool:
    """Whether somebody can answer: standard input is a terminal, and this process is not in its background."""
    if sys.stdin is None or not sys.stdin.isatty():
        return False
    try:
        return os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()
    except (AttributeError, OSError):  # Windows; a terminal that controls another session
        return True


def ask(console: Console, question: str) -> str:
    """What is typed in answer to a question, up to Enter. Raises `EOFError` at the end of input."""
    console.print("[bold]→[/]", end=" ")
    return console.input(f"{question} ", markup=False).strip()


LINE_S = 60.0
"""Seconds between lines in a log file, or wherever else no bar can be drawn."""


class ProgressBar:
    """How far a piece of work is."""

    def __init__(self, progress: Progress, bar: TaskID) -> None:
        self._progress, self._bar = progress, bar
        self._said_at = time.monotonic()

    def __call__(self, note: str = "", steps: int = 1) -> None:
        """`steps` of the work are done; with or without a note to show beside the bar."""
        self._progress.update(self._bar, advance=steps)
        if note:
            self._progress.update(self._bar, note=note)
        console = self._progress.console
        if (
            not console.is_terminal
            and not self._progress.disable
            and time.monotonic() - self._said_at >= LINE_S
        ):
            self._said_at = time.monotonic()
            console.print(self._line(), markup=False, highlight=False, soft_wrap=True)

    @contextmanager
    def aside(self) -> Iterator[None]:
        """Leave the terminal to somebody else while the block runs."""
        self._progress.stop()
        try:
            yield
        finally:
            self._progress.start()

    def _line(self) -> str:
        task = next(task for task in self._progress.tasks if task.id == self._bar)
        left = task.time_remaining
        words = [f"{task.description} {task.completed:.0f}/{task.total:.0f}", task.fields["note"]]
        words += [] if left is None else [f"{_in_words(left)} left"]
        return ", ".join(filter(None, words))


def _in_words(seconds: float) -> str:
    minutes = seconds / 60
    return (
        f"{minutes / 60:.1f} h"
        if minutes >= 90
        else f"{minutes:.0f} min"
        if minutes >= 2
        else f"{seconds:.0f} s"
    )


@contextmanager
def progress_bar(
    doing: str, total: int, done: int = 0, console: Console | None = None, *, shown: bool = True
) -> Iterator[ProgressBar]:
    """A bar from `done` to `total` with an estimate while open, on stderr unless another console is given.

    Call what it gives after every piece of work. Where nothing can be drawn, there is a line a minute instead.
    """
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[note]}"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console or Console(stderr=True), disable=not shown) as progress:
        yield ProgressBar(progress, progress.add_task(doing, total=total, completed=done, note=""))
