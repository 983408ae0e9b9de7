"""The whole way of a real cell, over the robot's own network protocol, in the virtual lab.

    python benchmarks/rehearsal.py --policy runs/policies/cell-15/keypoint --cell 15
    python benchmarks/rehearsal.py --learn --size 640x480 --attempts 160 --out runs/night-640x480 --results \
        docs/results/night-640x480

Doctor, calibration, an unattended collection, and a policy: one that was trained on simulated data and never saw this
connection, or with `--learn` one that learned from what was collected here. Goes on where it stopped and writes
RESULTS.{json,md}.
"""

from __future__ import annotations

import json
import shlex
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro

from baggie.data import open_dataset
from baggie.geometry import PlanarPose
from baggie.lab.web import LabControl
from baggie.options.values import USUAL_TASK
from baggie.results import provenance, write_json, write_results
from baggie.workcell.workcell_file import read_workcell_file
from commands import rate, start

UNCALIBRATED, MAP = "lab.yaml", "image-to-robot.yaml"
"""The workcell file before the first step, and what that makes."""
RECORDING, POLICY = "recording", "keypoint"
_AWAY = PlanarPose(0.5, 0.8, 0.0)
"""Off the table: nothing may lie on it while the hand carries a marker over it."""


@dataclass(frozen=True)
class Options:
    """Rehearse."""

    policy: Path = Path("runs/policies/cell-15/keypoint")
    """Trained in the simulated cell, on a recording of its own."""
    learn: bool = False
    """Train on what is collected here, and measure and report that, in place of taking `policy`."""
    cell: int = 15
    size: str = "1280x720"
    """Of the camera's pictures, pixels."""
    attempts: int = 20
    """To collect."""
    episodes: int = 20
    seed: int = 0
    out: Path = Path("runs/rehearsal")
    results: Path = Path("docs/results/rehearsal")
    host: str = "127.0.3.1"
    camera_port: int = 8193
    """Always the same: a calibration is of the camera at one address, and the next start goes on with it."""


def main(options: Options) -> None:
    """Every step in the order of a first day; the table of what came of it. Fails where a step does."""
    options.out.mkdir(parents=True, exist_ok=True)
    with lab(options) as (file, control):
        rows = [
            step(options, "baggie calibrate image-to-robot", lambda: calibrate(file, control)),
            step(options, "baggie doctor --move yes", lambda: doctor(file, control)),
            step(options, "baggie collect", lambda: collect(file, control, options)),
        ]
        if options.learn:
            rows += [
                step(options, "baggie train", lambda: train(file, options)),
                step(options, "baggie validate", lambda: validate(file)),
            ]
        rows.append(step(options, "baggie evaluate", lambda: evaluate(file, options)))
        if options.learn:
            rows.append(step(options, "baggie report", lambda: report(file)))
    learned = "what was collected here" if options.learn else "a recording of the simulated cell"
    notes = (
        "Everything went over Franka's control protocol (TCP and UDP) and the camera's network stream to `baggie lab`, "
        f"which simulates cell {options.cell} behind them with pictures of {options.size}; nobody helped. The policy "
        f"learned from {learned}. Errors of the closed loop are against where the lab's camera sees the bag, by the "
        "map calibrated in the first step; how far they are from the truth, and why, is in landing.md. The lab ran as "
        "fast as it could; times are the wall clock's."
    )
    write_results(options.results, "A rehearsal in the virtual lab", rows, provenance([options.seed]), notes)


@contextmanager
def lab(options: Options, task: str = USUAL_TASK) -> Iterator[tuple[Path, LabControl]]:
    """A lab in a process of its own: its workcell file, which names the calibration to come, and its control."""
    file, printed = options.out / "cell.yaml", options.out / UNCALIBRATED
    address = f"--host {options.host} --camera-port {options.camera_port}"
    words = (
        f"lab --task {task} --cell {options.cell} --size {options.size} {address} --pace 0 --out {printed}"
    )
    process = start(words.split(), stdout=subprocess.PIPE)
    assert process.stdout is not None
    try:
        process.stdout.readline()  # it is up once it says so
        camera = read_workcell_file(printed).camera
        assert camera is not None
        assert camera.source is not None
        file.write_text(printed.read_text() + f"calibrations:\n  image_to_robot: {MAP}\n")
        yield file, LabControl(camera.source)
    finally:
        process.terminate()
        process.wait()


def step(options: Options, name: str, do: Callable[[], str]) -> dict[str, Any]:
    """What came of one step and how long it took; as kept, where it was done before."""
    kept = options.out / f"{name.split()[1]}.json"
    if not kept.exists():
        print(f"$ {name}", file=sys.stderr)
        began = time.perf_counter()
        came = do()
        write_json(
            kept, {"step": name, "came of it": came, "minutes": round((time.perf_counter() - began) / 60, 1)}
        )
    return dict(json.loads(kept.read_text()))


def calibrate(file: Path, control: LabControl) -> str:
    """The marker's plate into the hand, the table clear, and over the workspace."""
    control.show_paddle(True)
    control.lay_aside(_AWAY)
    marker = "--marker color:217,13,191 --marker-in-hand 0.09 0 0"
    plain, out = file.with_name(UNCALIBRATED), file.with_name(MAP)
    found = answer(f"calibrate image-to-robot --workcell {plain} --prepared {marker} --out {out}")
    control.show_paddle(False)
    return f"{found['points']} points, {found['leave_one_out_mm']:.2f} mm left out"


def doctor(file: Path, control: LabControl) -> str:
    """Everything it checks, moving included."""
    control.lay_aside(_AWAY)
    findings = answer(f"doctor {file} --move yes --lab {control.address}")["findings"]
    return f"{sum(finding['verdict'] == 'ok' for finding in findings)} of {len(findings)} checks ok"


def collect(file: Path, control: LabControl, options: Options) -> str:
    """Unattended; it goes on with what is there."""
    control.reset(options.seed)
    out = file.with_name(RECORDING)
    there = len(open_dataset(out)) if out.exists() else 0
    found = answer(
        f"collect --workcell {file} --workers 1 --attempts {options.attempts} --seed {options.seed} --out {out}"
    )
    rate_per_minute = f"{found['attempts_per_minute']:.1f} a minute"
    before = f", {there} of them before" if there else ""
    return f"{found['succeeded']} of {found['attempts']} attempts succeeded{before}, {rate_per_minute}"


def train(file: Path, options: Options) -> str:
    """The policy, on what was collected."""
    words = f"--data {file.with_name(RECORDING)} --seed {options.seed} --out {file.with_name(POLICY)}"
    found = answer(f"train --policy keypoint {words}")
    return f"{found['steps']} steps"


def validate(file: Path) -> str:
    """The policy, on attempts that it did not learn from."""
    run = file.with_name(POLICY)
    found = answer(f"validate --policy {run} --data {file.with_name(RECORDING)} --out {run / 'validation'}")
    errors = found["labels"]
    means = f"{errors['pick_error_cm']['mean']:.2f} cm, place {errors['place_error_cm']['mean']:.2f} cm in the mean"
    return f"pick {means}, of {found['held_out']['attempts']} attempts"


def evaluate(file: Path, options: Options) -> str:
    """The policy moves bags to goals marked in the picture."""
    policy = file.with_name(POLICY) if options.learn else options.policy
    out = policy / "evaluation" if options.learn else file.with_name("evaluation")
    words = f"--episodes {options.episodes} --seed {options.seed} --out {out}"
    found = answer(f"evaluate --policy {policy} --workcell {file} {words}")
    return f"{rate(found['success'])} within 2 cm, median {found['distance_cm']['median']:.2f} cm"


def report(file: Path) -> str:
    """All of it on one page."""
    page = file.with_name("report.html")
    answer(f"report {file.with_name(POLICY)} --out {page}")
    return f"a page of {page.stat().st_size / 1e6:.1f} MB"


def answer(command: str) -> Mapping[str, Any]:
    """What a `baggie` command says as JSON; ends everything where it fails."""
    process = start([*shlex.split(command), "--json"], stdin=subprocess.DEVNULL, stdout=subprocess.PIPE)
    said, _ = process.communicate()
    if process.returncode:
        sys.exit(process.returncode)
    return dict(json.loads(said))


if __name__ == "__main__":
    main(tyro.cli(Options))
