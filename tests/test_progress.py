"""What everything long shows of how far it is: a bar to look at, lines to read later."""

import io

import pytest
from rich.console import Console

from baggie import progress
from baggie.progress import progress_bar


def shown_by(console: Console, notes: list[str]) -> list[str]:
    with progress_bar("collecting", 10, 4, console) as advance:
        for note in notes:
            advance(note)
    console.file.seek(0)
    return console.file.read().splitlines()


def log_file() -> Console:
    return Console(file=io.StringIO(), width=100, force_terminal=False)


def test_where_nothing_can_be_drawn_there_is_a_line_a_minute(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: now.append(now[-1] + 25) or now[-1])
    lines = shown_by(log_file(), ["5/5 succeeded", "", "7/7 succeeded", "", "", ""])
    *lines, last = [line.split(", ") for line in lines]
    assert [line[:2] for line in lines] == [
        ["collecting 7/10", "7/7 succeeded"],
        ["collecting 10/10", "7/7 succeeded"],
    ]
    assert last[0].startswith("collecting ")
    assert "10/10" in last[0]


def test_what_is_over_within_a_minute_says_so_once() -> None:
    (line,) = shown_by(log_file(), ["a"] * 6)
    assert "10/10" in line


def test_a_terminal_has_the_bar_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(progress, "LINE_S", 0.0)
    drawn = shown_by(Console(file=io.StringIO(), width=100, force_terminal=True), ["note"])
    assert not any("collecting 5/10, note" in line for line in drawn)


@pytest.mark.parametrize(("seconds", "words"), [(42, "42 s"), (300, "5 min"), (10_000, "2.8 h")])
def test_what_is_left_is_said_in_units_that_fit(seconds: float, words: str) -> None:
    assert progress._in_words(seconds) == words
