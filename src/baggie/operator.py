"""The one way to a person: what is told, what is asked, and how far the work is.

`Operator` is whoever can be told and asked: `TerminalOperator` at the terminal, `Nobody` where nobody is.
"""

from __future__ import annotations

import os
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import timedelta
from functools import partial
from pathlib import Path
from typing import Generic, Protocol, TypeVar

import rich.progress
from rich.console import Console
from rich.status import Status

from baggie.errors import NobodyError
from baggie.files import write_if_possible
from baggie.pictures import write_picture
from baggie.types import Image

Answer = TypeVar("Answer")
Parse = Callable[[str], Answer]
"""Makes something of what was typed. Raises `ValueError`, in one line, where it cannot."""


@dataclass(frozen=True)
class Line:
    """Something to know."""

    text: str


@dataclass(frozen=True)
class Caution:
    """Something that may surprise later, and stops nothing."""

    text: str


@dataclass(frozen=True)
class Hint:
    """What a person can do now, and nothing waits for: it shows in the pictures when it was done."""

    text: str


@dataclass(frozen=True)
class Picture:
    """What a camera sees now, drawn upon for a person; each takes the place of the one before."""

    image: Image
    path: Path
    """Where it is written for a person who is not shown pictures: a viewer that reloads shows it live."""


@dataclass(frozen=True)
class Progress:
    """How far a piece of work is."""

    doing: str
    """What is done, in words; tells one piece of work from another."""
    done: int = 0
    total: int | None = None
    """How many parts there are; None where they cannot be counted."""
    note: str = ""
    left_s: float | None = None
    """How long the rest is expected to take, seconds."""


@dataclass(frozen=True)
class Ended:
    """A piece of work is over, done or not."""

    doing: str


Event = Line | Caution | Hint | Picture | Progress | Ended


@dataclass(frozen=True)
class Question(Generic[Answer]):
    """What a person is asked to say or to do."""

    text: str
    default: str | None
    """What nothing stands for; None where there has to be an answer."""
    parse: Parse[Answer]
    choices: Sequence[str] = ()
    """All that may be answered, where that can be listed."""
    keys: str = ":"
    """What the text is followed by for a person with a keyboard."""

    def meaning(self, typed: str) -> Answer:
        """What is meant by what was typed. Raises `ValueError`, in one line, where it will not do."""
        if not typed and self.default is None:
            raise ValueError("expected an answer")
        return self.parse(typed or self.default or "")

    def answered(self, read: Callable[[str], str]) -> Answer:
        """What is meant by the first answer that will do; `read` shows a text and returns what is typed."""
        hint = ""
        while True:
            typed = read(hint + self.text).strip()
            try:
                return self.meaning(typed)
            except ValueError as error:
                hint = f"{typed!r} will not do ({error}); "


ENTER = ", then press Enter"


def errand(text: str) -> Question[None]:
    """Ask for something to be done; any answer says that it is."""
    return Question(text, "", _done, keys=ENTER)


def _done(_typed: str) -> None:
    """Mean that it is done."""


def choice(text: str, default: str, choices: Sequence[str]) -> Question[str]:
    """Ask for one of these words."""
    return Question(text, default, partial(_one_of, tuple(choices)), choices)


def _one_of(choices: tuple[str, ...], typed: str) -> str:
    if typed not in choices:
        raise ValueError(f"expected {', '.join(choices[:-1])} or {choices[-1]}")
    return typed


class Operator(Protocol):
    """Whoever watches over the work, and can be asked."""

    @property
    def attended(self) -> bool:
        """Whether somebody is there to answer."""
        ...

    def tell(self, event: Event) -> None:
        """Show what happens."""
        ...

    def ask(self, question: Question[Answer]) -> Answer:
        """Wait for an answer that will do. Raises `NobodyError` where nobody gives one."""
        ...


class Nobody:
    """Nobody: hears nothing, answers nothing."""

    attended = False

    def tell(self, event: Event) -> None:
        """Let it go by."""

    def ask(self, question: Question[Answer]) -> Answer:
        """Raise `NobodyError`."""
        raise _unanswered(question)


def _unanswered(question: Question[Answer]) -> NobodyError:
    return NobodyError(f"nobody answers: {question.text}; run this in a terminal")


_REMEMBERED = 1000
"""Parts of a piece of work from which it is told how long the rest takes."""


class Advance:
    """Tells an operator how far a piece of work is."""

    def __init__(self, operator: Operator, at: Progress) -> None:
        """Begin with what is done already."""
        self._operator, self._at = operator, at
        self._times = deque([(time.monotonic(), at.done)], _REMEMBERED)
        operator.tell(at)

    def __call__(self, note: str = "", steps: int = 1) -> None:
        """Count `steps` of the work as done; with a note to show from now on, or the one before."""
        done = self._at.done + steps
        self._times.append((time.monotonic(), done))
        self._at = replace(self._at, done=done, note=note or self._at.note, left_s=self._left_s())
        self._operator.tell(self._at)

    def _left_s(self) -> float | None:
        (began, first), (now, done) = self._times[0], self._times[-1]
        if self._at.total is None or done == first:
            return None
        return max(0, self._at.total - done) * (now - began) / (done - first)


@contextmanager
def progress(operator: Operator, doing: str, total: int | None = None, done: int = 0) -> Iterator[Advance]:
    """Tell an operator of a piece of work, from `done` to `total` parts, while the block does it.

    Call what it gives after every part; where parts cannot be counted, there is nothing to call.
    """
    try:
        yield Advance(operator, Progress(doing, done, total))
    finally:
        operator.tell(Ended(doing))


def is_attended() -> bool:
    """Whether somebody can answer: standard input is a terminal, and this process is not in its background."""
    if sys.stdin is None or not sys.stdin.isatty():
        return False
    try:
        return os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()
    except (AttributeError, OSError):  # Windows; a terminal that controls another session
        return True


class TerminalOperator:
    """The person at the terminal: all is shown on stderr, and answers come from standard input.

    Progress is a bar; where none can be drawn, such as in a log file, a line a minute.
    """

    def __init__(self, console: Console | None = None) -> None:
        """`console` takes the place of stderr."""
        self._console = console or Console(stderr=True)
        self._shown: dict[str, _Bar | Status] = {}
        """What is drawn of each piece of work."""

    @property
    def attended(self) -> bool:
        """Whether standard input is a terminal, and this process not in its background."""
        return is_attended()

    def tell(self, event: Event) -> None:
        """Print it, above the bar if there is one, or draw it; a picture is written to its file."""
        match event:
            case Line(text):
                self._print(text)
            case Caution(text):
                self._print(f"warning: {text}")
            case Hint(text):
                self._arrow()
                self._print(text)
            case Picture(image, path):
                write_if_possible(path, lambda path: write_picture(path, image))
            case Progress():
                self._draw(event)
            case Ended(doing) if doing in self._shown:
                self._shown.pop(doing).stop()

    def ask(self, question: Question[Answer]) -> Answer:
        """Ask until an answer will do; the bar makes room. Raises `NobodyError` at the end of input."""
        offer = f" ({question.default})" if question.default else ""
        for shown in self._shown.values():
            shown.stop()
        try:
            return question.answered(lambda text: self._read(f"{text}{offer}{question.keys} "))
        except EOFError:
            raise _unanswered(question) from None
        finally:
            for shown in self._shown.values():
                shown.start()

    def _read(self, prompt: str) -> str:
        self._arrow()
        return self._console.input(prompt, markup=False)

    def _arrow(self) -> None:
        self._console.print("[bold]→[/]", end=" ")

    def _print(self, text: str) -> None:
        self._console.print(text, markup=False, highlight=False, soft_wrap=True)

    def _draw(self, at: Progress) -> None:
        shown = self._shown.get(at.doing)
        if isinstance(shown, _Bar):
            shown.update(at)
        elif shown is None:
            shown = self._console.status(at.doing) if at.total is None else _Bar(at, self._console)
            self._shown[at.doing] = shown
            shown.start()


LINE_S = 60.0
"""Seconds between lines in a log file, or wherever else no bar can be drawn."""


class _Bar:
    """A piece of work on a console: a bar, or a line a minute."""

    def __init__(self, at: Progress, console: Console) -> None:
        self._console, self._said_at = console, time.monotonic()
        self._drawn = rich.progress.Progress(
            rich.progress.TextColumn("{task.description}"),
            rich.progress.BarColumn(),
            rich.progress.MofNCompleteColumn(),
            rich.progress.TextColumn("{task.fields[note]}"),
            rich.progress.TimeElapsedColumn(),
            rich.progress.TextColumn("{task.fields[left]}", style="progress.remaining"),
            console=console,
        )
        self._task = self._drawn.add_task(at.doing, total=at.total, note="", left="")
        self.update(at)

    def start(self) -> None:
        """Draw it from now on."""
        self._drawn.start()

    def stop(self) -> None:
        """Leave the console to others."""
        self._drawn.stop()

    def update(self, at: Progress) -> None:
        """Draw how far it is now; where nothing can be drawn, say so now and then."""
        left = "-:--:--" if at.left_s is None else str(timedelta(seconds=round(at.left_s)))
        self._drawn.update(self._task, completed=at.done, note=at.note, left=left)
        if not self._console.is_terminal and time.monotonic() - self._said_at >= LINE_S:
            self._said_at = time.monotonic()
            self._console.print(_in_a_line(at), markup=False, highlight=False, soft_wrap=True)


def _in_a_line(at: Progress) -> str:
    left = "" if at.left_s is None else f"{_in_words(at.left_s)} left"
    return ", ".join(filter(None, [f"{at.doing} {at.done}/{at.total}", at.note, left]))


def _in_words(seconds: float) -> str:
    minutes = seconds / 60
    return (
        f"{minutes / 60:.1f} h"
        if minutes >= 90
        else f"{minutes:.0f} min"
        if minutes >= 2
        else f"{seconds:.0f} s"
    )
