"""The one way to a person: what is shown at a terminal and in a log file, who is there, and what they answer."""

from __future__ import annotations

import io
import os
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console

from baggie import operator
from baggie.errors import NobodyError
from baggie.operator import (
    Caution,
    Ended,
    Hint,
    Line,
    Nobody,
    Picture,
    Progress,
    Question,
    TerminalOperator,
    choice,
    errand,
    is_attended,
    progress,
)
from baggie.pictures import read_picture
from helpers.scripted import Scripted


class Screen(TerminalOperator):
    """A terminal, or a log file, that can be read; nothing is typed but what is given."""

    def __init__(self, *, is_terminal: bool = False) -> None:
        self.file = io.StringIO()
        super().__init__(Console(file=self.file, width=100, force_terminal=is_terminal))

    @property
    def lines(self) -> list[str]:
        """What was shown."""
        return self.file.getvalue().splitlines()


# -- progress --------------------------------------------------------------------------------------


def shown_by(screen: Screen, notes: list[str]) -> list[str]:
    with progress(screen, "collecting", 10, 4) as advance:
        for note in notes:
            advance(note)
    return screen.lines


def test_where_nothing_can_be_drawn_there_is_a_line_a_minute(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr(operator.time, "monotonic", lambda: now[0])
    screen = Screen()
    for done, note in enumerate(["", "5/5 succeeded", "6/6 succeeded", "7/7 succeeded"], start=4):
        now[0] += 25
        screen.tell(Progress("collecting", done, 10, note, 5400.0))
    screen.tell(Ended("collecting"))
    line, last = screen.lines
    assert line == "collecting 7/10, 7/7 succeeded, 1.5 h left"
    assert last.startswith("collecting ")
    assert "7/10" in last


def test_what_is_over_within_a_minute_says_so_once() -> None:
    (line,) = shown_by(Screen(), ["a"] * 6)
    assert "10/10" in line


def test_a_terminal_has_the_bar_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(operator, "LINE_S", 0.0)
    drawn = shown_by(Screen(is_terminal=True), ["note"])
    assert not any("collecting 5/10, note" in line for line in drawn)


def test_what_cannot_be_counted_leaves_nothing_in_a_log_file() -> None:
    screen = Screen()
    with progress(screen, "calibrating"):
        pass
    assert not screen.lines


@pytest.mark.parametrize(("seconds", "words"), [(42, "42 s"), (300, "5 min"), (10_000, "2.8 h")])
def test_what_is_left_is_said_in_units_that_fit(seconds: float, words: str) -> None:
    assert operator._in_words(seconds) == words


@given(st.integers(1, 50), st.floats(0.001, 1000), st.integers(0, 100), st.integers(1, 100))
def test_work_that_goes_evenly_takes_as_long_as_is_told(
    steps: int, seconds: float, before: int, after: int
) -> None:
    now, person, total = [0.0], Scripted(), before + steps + after
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(operator.time, "monotonic", lambda: now[0])
        with progress(person, "learning", total, before) as advance:
            for _ in range(steps):
                now[0] += seconds
                advance()
    first, *told, last = person.told
    assert first == Progress("learning", before, total)
    assert last == Ended("learning")
    for done, at in enumerate(told, start=before + 1):
        assert at.done == done
        assert at.left_s == pytest.approx((total - done) * seconds)


def test_a_note_stays_until_there_is_another() -> None:
    person = Scripted()
    with progress(person, "learning", 3) as advance:
        advance("loss 1")
        advance()
    assert [event.note for event in person.told if isinstance(event, Progress)] == ["", "loss 1", "loss 1"]


def test_work_that_breaks_off_is_over_too() -> None:
    person = Scripted()
    with pytest.raises(KeyboardInterrupt), progress(person, "learning", 3):
        raise KeyboardInterrupt
    assert person.told[-1] == Ended("learning")


# -- lines and pictures ----------------------------------------------------------------------------


def test_words_are_shown_as_they_are_each_in_a_line_however_long(tmp_path: Path) -> None:
    screen, long = Screen(), "a path/[with]/brackets " * 9
    for event in (Line(long), Caution("[it] is old"), Hint("tilt [it]")):
        screen.tell(event)
    assert screen.lines == [long, "warning: [it] is old", "→ tilt [it]"]


def test_a_picture_is_where_a_viewer_finds_it(tmp_path: Path) -> None:
    picture = np.full((8, 8, 3), 90, np.uint8)
    screen = Screen()
    screen.tell(Picture(picture, tmp_path / "seen.png"))
    assert np.array_equal(read_picture(tmp_path / "seen.png"), picture)
    assert not screen.lines


# -- questions -------------------------------------------------------------------------------------


def typed(monkeypatch: pytest.MonkeyPatch, text: str) -> Screen:
    monkeypatch.setattr(sys, "stdin", io.StringIO(text))
    return Screen()


def test_a_question_is_shown_as_it_is_and_answered_up_to_enter(monkeypatch: pytest.MonkeyPatch) -> None:
    screen = typed(monkeypatch, " 1 -0.5 \nmore")
    assert screen.ask(Question("how far is [it] off", None, str)) == "1 -0.5"
    assert screen.file.getvalue() == "→ how far is [it] off: "


def test_an_errand_is_done_when_enter_is_pressed(monkeypatch: pytest.MonkeyPatch) -> None:
    screen = typed(monkeypatch, "\n")
    screen.ask(errand("clear the table"))
    assert screen.file.getvalue() == "→ clear the table, then press Enter "


def test_it_is_asked_until_an_answer_will_do(monkeypatch: pytest.MonkeyPatch) -> None:
    screen = typed(monkeypatch, "green\n\n")
    assert screen.ask(choice("which colour", "red", ("red", "blue"))) == "red"
    first, again = screen.file.getvalue().split("→ ")[1:]
    assert first == "which colour (red): "
    assert again == "'green' will not do (expected red or blue); which colour (red): "


def test_nothing_is_no_answer_where_one_is_needed() -> None:
    person = Scripted("", "7")
    assert person.ask(Question("how many", None, int)) == 7
    assert person.asked[1] == "'' will not do (expected an answer); how many"


@pytest.mark.parametrize("nobody", [Nobody(), Screen()], ids=["nobody", "the end of input"])
def test_where_nobody_answers_that_is_an_error(
    monkeypatch: pytest.MonkeyPatch, nobody: operator.Operator
) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO())
    with pytest.raises(NobodyError, match=r"^nobody answers: clear the table; run this in a terminal$"):
        nobody.ask(errand("clear the table"))


def test_the_bar_makes_room_for_a_question_and_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    screen = typed(monkeypatch, "\n")
    with progress(screen, "collecting", 2) as advance:
        advance()
        screen.ask(errand("lay it back"))
        advance("there")
    before, question, after = screen.file.getvalue().rstrip().partition("→ lay it back, then press Enter ")
    assert "1/2" in before
    assert question
    assert "2/2 there" in after


@pytest.mark.parametrize("question", [errand("clear the table"), choice("which", "a", ("a", "b"))])
def test_a_question_reaches_another_process(question: Question[object]) -> None:
    again = pickle.loads(pickle.dumps(question))
    assert (again.text, again.meaning("")) == (question.text, question.meaning(""))


# -- who is there ----------------------------------------------------------------------------------

PROGRAM = """
import fcntl, os, termios
from baggie.operator import is_attended
fcntl.ioctl(0, termios.TIOCSCTTY, 0)
print(is_attended(), flush=True)
if os.fork() == 0:
    os.setpgrp()
    print(is_attended(), flush=True)
    os._exit(0)
os.wait()
"""


def test_it_is_attended_in_the_foreground_of_a_terminal_only() -> None:
    pty = pytest.importorskip("pty", reason="terminals are told apart on POSIX only")
    ours, theirs = pty.openpty()
    command = [sys.executable, "-c", PROGRAM]
    done = subprocess.run(
        command, stdin=theirs, capture_output=True, text=True, start_new_session=True, check=True
    )
    os.close(ours), os.close(theirs)
    assert done.stdout.split() == ["True", "False"]


@pytest.mark.parametrize("stdin", [None, io.StringIO("yes\n")])
def test_nobody_is_there_without_a_terminal(
    monkeypatch: pytest.MonkeyPatch, stdin: io.StringIO | None
) -> None:
    monkeypatch.setattr(sys, "stdin", stdin)
    assert not is_attended()
