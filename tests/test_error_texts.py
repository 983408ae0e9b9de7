"""What `baggie` says where something is wrong, word for word.

`error_texts.txt` has commands, what they say on stderr, and their exit status; above a command stands the workcell file
it is about. Add a command there, and have all texts written anew, to be read before they are committed:

    WRITE_ERROR_TEXTS=1 python -m pytest tests/test_error_texts.py
"""

from __future__ import annotations

import os
import re
import shlex
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from baggie.cli.main import main
from baggie.data import DatasetWriter
from helpers.synthetic import make_attempt

KEPT = Path(__file__).with_name("error_texts.txt")
WRITE = "WRITE_ERROR_TEXTS" in os.environ
WIDTH = 100
"""Of the terminal, which usage errors are broken to."""


@dataclass(frozen=True)
class Case:
    """A command and what it says."""

    comment: str
    file: str
    """What `cell.yaml` holds; none where this is empty."""
    command: str
    said: str

    @classmethod
    def read(cls, text: str) -> Case:
        """From a part of the kept file."""
        lines = {mark: [line for line in text.splitlines() if mark_of(line) == mark] for mark in "#|$ "}
        file = "".join(f"{line[2:]}\n" for line in lines["|"])
        (command,) = lines["$"]
        return cls("\n".join(lines["#"]), file, command[2:], "\n".join(lines[" "]))

    def __str__(self) -> str:
        file = "\n".join(f"| {line}" for line in self.file.splitlines())
        return "\n".join(part for part in (self.comment, file, f"$ {self.command}", self.said) if part)


def mark_of(line: str) -> str:
    """What a line of the kept file is: a comment, a line of `cell.yaml`, a command, or what that says."""
    return line[0] if line[:2] in {"# ", "| ", "$ "} else " "


Say = Callable[[Case], str]
CASES = [Case.read(part) for part in KEPT.read_text().strip().split("\n\n")]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """With a recording, a folder that holds none, and a picture that is none."""
    folder = tmp_path_factory.mktemp("wrong")
    rng, size = np.random.default_rng(0), (64, 36)
    attempts = [make_attempt(number, rng, size, depth=False) for number in range(2)]
    with DatasetWriter(
        folder / "recording", task=attempts[0].task, robot_type="arm", picture_size=size
    ) as writer:
        for attempt in attempts:
            writer.append(attempt)
    (folder / "empty").mkdir()
    (folder / "picture.png").write_bytes(b"no picture")
    return folder


@pytest.fixture
def say(folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Say:
    """What a case says here: the same on every machine and terminal."""
    monkeypatch.chdir(folder)
    monkeypatch.setenv("COLUMNS", str(WIDTH))

    def said(case: Case) -> str:
        if case.file:
            Path("cell.yaml").write_text(case.file)
        try:
            status = main(shlex.split(case.command)[1:])
        except SystemExit as stopped:
            status = stopped.code
        text = capsys.readouterr().err.replace(str(folder), "FOLDER").replace(sys.executable, "python")
        lines = (re.sub(r"[─│╭╮╰╯]+|-{5,}", "", line).strip() for line in text.splitlines())
        return "\n".join([*(line for line in lines if line), f"[{status}]"])

    return said


@pytest.fixture(scope="module")
def now() -> Iterator[list[Case]]:
    """The cases with what they say now; kept, where that is asked for."""
    cases: list[Case] = []
    yield cases
    if WRITE:
        KEPT.write_text("\n\n".join(map(str, cases)) + "\n")


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.command)
def test_every_text_is_as_it_was(case: Case, say: Say, now: list[Case]) -> None:
    now.append(replace(case, said=say(case)))
    assert WRITE or now[-1] == case


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.command)
def test_every_text_is_one_line_or_says_how_to_get_help(case: Case) -> None:
    *lines, status = case.said.splitlines()
    assert status in {"[1]", "[2]"}
    if status == "[1]" or lines[0].startswith("error: "):
        assert [line.startswith("error: ") for line in lines] == [True]
    else:
        assert "For full helptext" in case.said
    assert "Traceback" not in case.said
