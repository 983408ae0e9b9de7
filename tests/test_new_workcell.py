from collections.abc import Callable
from pathlib import Path

import pytest

from baggie.commissioning.new_workcell import NewWorkcellOptions, new_workcell
from baggie.errors import BaggieError
from baggie.workcell.cameras.settings import CameraSettings
from baggie.workcell.workcell_file import FrankaEntry, SimulatedEntry, read_workcell_file


def answering(*answers: str) -> tuple[list[str], Callable[[str], str]]:
    """Somebody who gives these answers, and what they were asked."""
    asked: list[str] = []
    left = iter(answers)

    def ask(prompt: str) -> str:
        asked.append(prompt)
        try:
            return next(left)
        except StopIteration:
            raise EOFError from None

    return asked, ask


def test_enter_alone_gives_a_slow_franka(tmp_path: Path) -> None:
    _, ask = answering(*[""] * 20)
    path = tmp_path / "cell.yaml"
    assert new_workcell(NewWorkcellOptions(path), ask)["workcell"] == str(path)
    written = read_workcell_file(path)
    assert isinstance(written.arm, FrankaEntry)
    assert (written.arm.speed, written.arm.model) == (0.1, "fr3")
    assert written.camera == CameraSettings(source="0")


def test_what_was_answered_is_what_is_read(tmp_path: Path) -> None:
    path = tmp_path / "cell.yaml"
    answers = (
        "franka",
        "10.0.0.7",
        "panda",
        "0.2",
        "no",
        "realsense",
        "0.4 0.6",
        "-0.2, 0.1",
        "0.1 0.15",
        "1 2 3",
    )
    new_workcell(NewWorkcellOptions(path), answering(*answers)[1])
    written = read_workcell_file(path)
    assert written.arm == FrankaEntry(
        kind="franka", host="10.0.0.7", model="panda", speed=0.2, realtime=False
    )
    assert written.camera == CameraSettings(kind="realsense")
    assert (written.workspace.x, written.workspace.y) == ((0.4, 0.6), (-0.2, 0.1))
    assert (written.bag.length_m, written.bag.width_m, written.bag.color) == (0.15, 0.1, (1, 2, 3))


def test_a_wrong_answer_is_asked_again_with_what_is_expected(tmp_path: Path) -> None:
    path = tmp_path / "cell.yaml"
    asked, ask = answering("robot", "sim", "-3", "x", "7", "0.6 0.4", "0.4", *[""] * 9)
    new_workcell(NewWorkcellOptions(path), ask)
    written = read_workcell_file(path)
    assert (written.arm, written.cell) == (SimulatedEntry(), 7)
    assert "'robot' will not do (expected franka or sim)" in asked[1]
    assert "'-3' will not do (expected 0 to 1e+06)" in asked[3]
    assert "expected the lower one first" in asked[6]


def test_nothing_that_is_there_is_written_over(tmp_path: Path) -> None:
    path = tmp_path / "cell.yaml"
    path.write_text("mine")
    with pytest.raises(BaggieError, match="is there already"):
        new_workcell(NewWorkcellOptions(path), answering()[1])
    assert path.read_text() == "mine"


def test_nobody_there_is_said_and_nothing_written(tmp_path: Path) -> None:
    with pytest.raises(BaggieError, match="nobody answers"):
        new_workcell(NewWorkcellOptions(tmp_path / "cell.yaml"), answering("sim")[1])
    assert not (tmp_path / "cell.yaml").exists()
