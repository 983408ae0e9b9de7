"""MuJoCo as pip leaves it when 4 replaces 3: what needs no simulator works, the rest says in one line what to do."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import sysconfig
from importlib.metadata import version
from pathlib import Path

import mujoco
import pytest

import baggie
from baggie.errors import BaggieError
from baggie.policies.baselines import ColorMaskPolicy
from baggie.sim.bag import Bag
from baggie.sim.cell import draw_cell
from baggie.sim.scene import arm_spec, build_model
from helpers.recorded_bags import SIZE, record
from helpers.synthetic import RED, image_to_robot

SOURCE = Path(baggie.__file__).parents[1]
RUN = """
import contextlib, io, json, sys
from baggie.cli.main import main

told = []
for arguments in json.loads(sys.argv[1]):
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            status = main(arguments)
        except SystemExit as stopped:
            status = stopped.code
    told.append([status, err.getvalue()])
print(json.dumps(told))
"""
QUICK = [
    ["--help"],
    ["collect", "--help"],
    ["calibrate", "hand-eye", "--help"],
    ["inspect", "recording"],
    ["workcell", "show", "cell.yaml"],
    ["print-target", "board", "--out", "board.pdf"],
]
LEARNING = [
    ["train", "--data", "recording", "--out", "run", "--steps", "2", "--train", "4", "--val", "2"],
    ["validate", "--policy", "color-mask", "--data", "recording", "--last", "4", "--out", "run/validation"],
    ["report", "run", "--out", "report.html"],
]
SIMULATING = [
    ["collect", "--attempts", "1", "--out", "collected"],
    ["lab"],
    ["evaluate", "--policy", "oracle", "--task", "block-pyramid", "--episodes", "1", "--out", "blocks"],
]
EVALUATING = ["evaluate", "--policy", "oracle", "--episodes", "1", "--out", "evaluated"]


def told_by(
    python: Path | str, commands: list[list[str]], folder: Path, first: Path
) -> list[tuple[int, str]]:
    """Exit status and error output of commands run in a folder, with the packages in `first` before all others."""
    if not (folder / "recording").exists():
        record(folder / "recording")
        ColorMaskPolicy(image_to_robot(SIZE), RED).save(folder / "recording" / "calibration")
    (folder / "cell.yaml").write_text("arm: {kind: franka, host: 172.16.0.2}\ncamera: {source: '0'}\n")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, (first, SOURCE)))}
    done = subprocess.run(
        [python, "-c", RUN, json.dumps(commands)],
        cwd=folder, env=environment, stdout=subprocess.PIPE, text=True, check=True,
    )  # fmt: skip
    return [(status, said) for status, said in json.loads(done.stdout)]


def expect_one_line(told: list[tuple[int, str]]) -> None:
    for status, said in told:
        assert status == 1
        assert "Traceback" not in said
        (line,) = [line for line in said.splitlines() if line.startswith("error:")]
        assert "MuJoCo here is not whole" in line
        assert "an environment of its own" in line
        assert "pip install --force-reinstall --no-deps mujoco mujoco-core mujoco-studio" in line


def test_without_mujoco_whatever_needs_no_simulator_works(tmp_path: Path) -> None:
    ruined = tmp_path / "packages" / "mujoco"
    ruined.mkdir(parents=True)
    (ruined / "__init__.py").write_text(
        "raise ImportError(\"core bindings\\n('mujoco-core') are missing\")\n"
    )
    told = told_by(sys.executable, QUICK + SIMULATING, tmp_path, ruined.parent)
    assert [status for status, _ in told[: len(QUICK)]] == [0] * len(QUICK), told
    expect_one_line(told[len(QUICK) :])


def test_an_older_mujoco_is_told_by_its_version(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mujoco, "__version__", "3.17.0")
    for model in (arm_spec, lambda: build_model(draw_cell(0), [Bag()])):
        with pytest.raises(
            BaggieError, match=r"MuJoCo 4 is needed, and 3\.17\.0 is installed here.* of its own"
        ):
            model()


@pytest.mark.slow
def test_after_pip_has_upgraded_mujoco_from_3_to_4(tmp_path: Path) -> None:
    subprocess.run([sys.executable, "-m", "venv", tmp_path / "venv"], check=True)
    python = tmp_path / "venv" / "bin" / "python"

    def install(*words: str) -> None:
        subprocess.run([python, "-m", "pip", "install", "--quiet", *words], check=True)

    ours = [f"{name}=={version(name)}" for name in ("mujoco", "mujoco-core", "mujoco-studio")]
    install("mujoco<4")
    install(ours[0])
    # Everything else is as it is here.
    here = Path(sysconfig.get_path("purelib"))
    there = Path(sysconfig.get_path("purelib", vars={"base": str(tmp_path / "venv")}))
    present = {path.name for path in there.iterdir()}
    for path in here.iterdir():
        if path.name not in present and not path.name.startswith(("mujoco", "__pycache__")):
            (there / path.name).symlink_to(path)
    told = told_by(python, [*QUICK, *LEARNING, *SIMULATING, EVALUATING], tmp_path, SOURCE)
    works = len(QUICK + LEARNING)
    assert [status for status, _ in told[:works]] == [0] * works, told
    expect_one_line(told[works:])
    install("--force-reinstall", "--no-deps", *ours)
    assert [status for status, _ in told_by(python, [SIMULATING[-1], EVALUATING], tmp_path, SOURCE)] == [0, 0]
