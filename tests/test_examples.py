"""The ladder of examples: every program runs as it stands and prints what its docstring says, or what to make first.

The others are run where what they need is: `17_lerobot.py` in tests/lerobot, `18_ravens_agent.py` in test_ravens_agent.
"""

from __future__ import annotations

import ast
import os
import re
import runpy
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import baggie
from baggie.calibration.files import MAP_FILE, REFERENCE_FILE
from baggie.data import DatasetWriter
from baggie.learning import train
from baggie.options.training import KeypointTraining
from baggie.pictures import write_picture
from helpers.synthetic import TASK, image_to_robot, make_attempt

ROOT = Path(__file__).parents[1]
LADDER = sorted((ROOT / "examples").glob("[0-9][0-9]_*.py"))
FROM_NOTHING = (
    "01_first_loop",
    "03_own_camera",
    "04_own_arm",
    "05_own_task",
    "06_own_soft_task",
    "16_gymnasium",
    "20_memory",
)
FROM_A_DEMO = (
    "02_own_goal",
    "07_own_policy",
    "08_inspect",
    "09_annotate",
    "10_augment",
    "12_export",
    "14_calibrate",
)
SLOW = ("11_train", "15_several_workcells", "19_lab", "21_report")
AFTER_ANOTHER = "13_plan_without_pytorch"
ELSEWHERE = ("17_lerobot", "18_ravens_agent")
_NUMBER = r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?"
_ATTEMPTS, _SIZE = 24, (640, 360)


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder as `make demo` leaves it, of drawn attempts; they do it in seconds."""
    folder = tmp_path_factory.mktemp("examples")
    recording, rng = folder / "demo" / "recording", np.random.default_rng(0)
    with DatasetWriter(recording, task=TASK, robot_type="drawn") as writer:
        for number in range(_ATTEMPTS):
            failure = "missed-grasp" if number == 3 else None
            writer.append(make_attempt(number, rng, _SIZE, failure=failure, depth=False))
    image_to_robot(_SIZE).save(recording / "calibration" / MAP_FILE)
    reference = make_attempt(_ATTEMPTS, rng, _SIZE).before.color
    write_picture(recording / "calibration" / REFERENCE_FILE, reference)
    train(KeypointTraining(recording, folder / "demo" / "keypoint", train=10, val=10, steps=60, device="cpu"))
    return folder


def titled(program: Path) -> tuple[str, list[str]]:
    """The first line of a program's docstring, and the lines that it says are printed."""
    said = ast.get_docstring(ast.parse(program.read_text())) or ""
    printed = said.rpartition("rints ")[2].partition("\n\n")[2]
    return said.partition("\n")[0], [line[4:] for line in printed.splitlines() if line.startswith("    ")]


def check_printed(name: str, printed: str) -> None:
    """That it is what the docstring says, whatever the numbers are; `...` stands for anything."""
    said = "\n".join(titled(ROOT / "examples" / f"{name}.py")[1])
    parts = re.sub(_NUMBER, "#", said).split("...")
    pattern = ".*".join(re.escape(part) for part in parts)
    came = re.sub(_NUMBER, "#", printed.strip())
    assert re.fullmatch(pattern, came, re.DOTALL), f"{said}\n\ncame as\n\n{printed}"


def run_here(name: str) -> None:
    runpy.run_path(str(ROOT / "examples" / f"{name}.py"), run_name="__main__")


def run_apart(name: str, cwd: Path) -> str:
    """In a process of its own; what it printed."""
    env = {**os.environ, "PYTHONPATH": str(Path(baggie.__file__).parents[1])}
    command = [sys.executable, str(ROOT / "examples" / f"{name}.py")]
    done = subprocess.run(command, cwd=cwd, env=env, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_every_example_is_run_somewhere() -> None:
    run = {*FROM_NOTHING, *FROM_A_DEMO, *SLOW, AFTER_ANOTHER, *ELSEWHERE}
    assert {program.stem for program in LADDER} == run


@pytest.mark.parametrize("program", LADDER, ids=lambda program: program.stem)
def test_every_example_says_what_it_shows_and_prints(program: Path) -> None:
    title, printed = titled(program)
    said = ast.get_docstring(ast.parse(program.read_text())) or ""
    assert re.search(r"^Shows ", said, re.M)
    assert printed, "what it prints, indented by four spaces, at the docstring's end"
    row = f"| [`{program.name}`]({program.name}) | {title.rstrip('.')} |"
    assert row in (ROOT / "examples" / "README.md").read_text()


@pytest.mark.parametrize("name", FROM_NOTHING)
def test_examples_from_nothing(name: str, tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    run_here(name)
    check_printed(name, capsys.readouterr().out)


@pytest.mark.parametrize("name", FROM_A_DEMO)
def test_examples_after_a_demo(name: str, demo: Path, tmp_path, monkeypatch, capsys) -> None:
    (tmp_path / "demo").symlink_to(demo / "demo")
    monkeypatch.chdir(tmp_path)
    run_here(name)
    check_printed(name, capsys.readouterr().out)


def test_an_exported_policy_plans_without_pytorch(demo: Path, tmp_path, monkeypatch) -> None:
    (tmp_path / "demo").symlink_to(demo / "demo")
    monkeypatch.chdir(tmp_path)
    run_here("12_export")
    check_printed(AFTER_ANOTHER, run_apart(AFTER_ANOTHER, tmp_path))
    assert (tmp_path / "runs/examples/plan.png").stat().st_size


@pytest.mark.slow
@pytest.mark.parametrize("name", SLOW)
def test_slow_examples(name: str, demo: Path, tmp_path) -> None:
    if name == "19_lab":
        pytest.importorskip("franky", reason="needs franky-control")
    shutil.copytree(demo / "demo", tmp_path / "demo")
    (
        tmp_path / "demo" / "keypoint" / REFERENCE_FILE
    ).unlink()  # of the drawn camera, not of the simulated one
    check_printed(name, run_apart(name, tmp_path))


@pytest.mark.parametrize("name", [*FROM_A_DEMO, AFTER_ANOTHER, "11_train", "17_lerobot", "21_report"])
def test_what_has_to_be_made_first_is_said_in_one_line(name: str, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit, match=r"^error: no .*make demo") as stopped:
        run_here(name)
    assert "\n" not in str(stopped.value)
    assert not list(tmp_path.iterdir())
