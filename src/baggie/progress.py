"""The progress bar that everything long shows on stderr."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn


class ProgressBar:
    """A bar that is on the terminal."""

    def __init__(self, progress: Progress, total: int, done: int) -> None:
        self._progress = progress
        self._bar = progress.add_task("", total=total, completed=done, note="")

    def __call__(self, note: str = "") -> None:
        """A piece of work is done; with or without a note to show beside the bar."""
        self._progress.update(self._bar, advance=1, note=note)

    @contextmanager
    def aside(self) -> Iterator[None]:
        """Leave the terminal to somebody else while the block runs."""
        self._progress.stop()
        try:
            yield
        finally:
            self._progress.start()


@contextmanager
def progress_bar(
    doing: str, total: int, done: int = 0, console: Console | None = None
) -> Iterator[ProgressBar]:
    """A bar from `done` to `total` with an estimate while open, on stderr unless another console is given.

    Call what it gives after every piece of work.
    """
    columns = (BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[note]}"), TimeRemainingColumn())
    with Progress(TextColumn(doing), *columns, console=console or Console(stderr=True)) as progress:
        yield ProgressBar(progress, total, done)
