"""The progress bar that everything long shows on stderr."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn


@contextmanager
def progress_bar(
    doing: str, total: int, done: int = 0, console: Console | None = None
) -> Iterator[Callable[..., None]]:
    """A bar from `done` to `total` with an estimate while open, on stderr unless another console is given.

    Call what it gives after every piece of work, with or without a note to show beside the bar.
    """
    columns = (BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[note]}"), TimeRemainingColumn())
    with Progress(TextColumn(doing), *columns, console=console or Console(stderr=True)) as progress:
        bar = progress.add_task("", total=total, completed=done, note="")

        def advance(note: str = "") -> None:
            progress.update(bar, advance=1, note=note)

        yield advance
