"""A robot and a camera that nobody here wrote, by the documented commands: from their contracts to a report.

    python benchmarks/foreign_cell.py

The simulator is PyBullet, in an environment of its own (.venv-pybullet, made where it is missing), behind a socket:
examples/pybullet_cell. What comes of it is judged by its own truth. Goes on where it stopped, and writes
RESULTS.{json,md}.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import tyro

import baggie
from baggie.cameras.camera import check_camera
from baggie.commissioning.doctor import examine
from baggie.data import open_dataset
from baggie.errors import BaggieError
from baggie.evaluation.log import read_episodes
from baggie.options.commissioning import DoctorOptions
from baggie.options.values import HAND_MARKER
from baggie.pictures import read_picture, write_picture
from baggie.results import provenance, write_json, write_results
from baggie.robot.contract import check_arm
from baggie.vision.targets import ArucoMarker, Target, parse_target
from commands import ENDS_WITH_US, rate
from rehearsal import answer

sys.path.append(str(Path(__file__).parents[1] / "examples" / "pybullet_cell"))

from pybullet_devices import Link

ROOT = Path(__file__).parents[1]
EXAMPLE, ENVIRONMENT = ROOT / "examples" / "pybullet_cell", ROOT / ".venv-pybullet"
PLAIN, MAP = "plain.yaml", "image-to-robot.yaml"
"""The workcell file before it is calibrated, and what that makes."""
PLATE_M, AHEAD_M = 0.08, 0.13
"""The plate with the printed marker, and how far it is ahead of the fingertips: what `calibrate` takes for granted."""
CUBE_M = 0.065
AWAY = (0.5, 1.2)
"""Beside the table."""
SAME_PLACE_M = 0.03
"""The camera sees a cube no further than this from where it is."""


@dataclass(frozen=True)
class Options:
    """Measure."""

    attempts: int = 40
    """To collect."""
    episodes: int = 10
    steps: int | None = None
    """Of the training; its default unless given."""
    seed: int = 0
    out: Path = Path("runs/foreign-cell")
    results: Path = Path("docs/results/foreign-cell")
    media: Path = Path("docs/media/foreign-cell.jpg")


def main(options: Options) -> None:
    """The table of what came of every step. Fails where one does."""
    figures = whole_way(options)
    rows = [
        {"step": "check_arm, check_camera" if name == "contracts" else f"baggie {name}", **came["row"]}
        for name, came in figures.items()
    ]
    notes = (
        "The Panda of PyBullet, a slanted camera of 640 x 480 and a hard red cube of 65 mm, in a process and an "
        "environment of their own; Baggie knows of them what stands in examples/pybullet_cell. All steps are "
        "as documented; what a person does (the marker into the hand, the cube under it, away and back) was asked of "
        "the simulator, and nobody helped otherwise. The truth is the simulator's own: where the cube is, "
        "and the greatest force that the hand, or the cube in it, pressed on the table with. Distances are the median, "
        "in brackets the worst."
    )
    for path in write_results(options.results, "A foreign cell", rows, provenance([options.seed]), notes):
        print(path)
    marked = read_picture(options.out / Path(MAP).stem / "007.png")
    planned = read_picture(options.out / "evaluation" / "episodes" / "episode-0000-before.jpg")
    height = len(marked)
    scaled = cv2.resize(planned, (round(planned.shape[1] * height / len(planned)), height))
    write_picture(options.media, np.hstack([marked, scaled]))


def whole_way(options: Options) -> dict[str, dict[str, Any]]:
    """What came of each step, by its name: a `row` for people, and figures. One that was done before is as it was."""
    options.out.mkdir(parents=True, exist_ok=True)
    came = {}
    with simulator(options.out) as (file, link):
        way = Way(options, file, link)
        for name, do in way.steps.items():
            kept = options.out / f"step-{name.split()[0]}.json"
            if not kept.exists():
                print(f"$ {name}", file=sys.stderr)
                link.ask("truth")  # what it tells next is of this step alone
                figures = do()
                write_json(kept, {"pressed_n": link.ask("truth")["pressed_n"], **figures})
            came[name] = json.loads(kept.read_text())
    return came


def python_with_pybullet() -> Path:
    """The interpreter of the simulator's environment, which is made where it is missing or stale.

    Raises `BaggieError` in one line where it cannot be.
    """
    python, stamp = ENVIRONMENT / "bin" / "python", ENVIRONMENT / ".installed"
    wanted = (EXAMPLE / "requirements.txt").read_text()
    if not stamp.exists() or stamp.read_text() != wanted:
        pip = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *wanted.split()]
        for command in ([sys.executable, "-m", "venv", "--clear", ENVIRONMENT], pip):
            done = subprocess.run(command, check=False, capture_output=True, text=True)
            if done.returncode:
                said = done.stderr.strip().splitlines() or ["no reason given"]
                why = next((line for line in reversed(said) if "error" in line.lower()), said[-1])
                raise BaggieError(f"{' and '.join(wanted.split())} cannot be installed here: {why}")
        stamp.write_text(wanted)
    return python


@contextmanager
def simulator(folder: Path) -> Iterator[tuple[Path, Link]]:
    """The simulator in a process of its own: the workcell file, beside its devices, and a line to ask for the truth."""
    words = [*ENDS_WITH_US, str(python_with_pybullet()), str(EXAMPLE / "simulator.py"), "--port", "0"]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    assert process.stdout is not None
    try:
        ready = next((line for line in process.stdout if line.startswith("ready")), None)
        if ready is None:
            raise BaggieError("the simulator ended before it was ready; start it by hand to see why")
        port = int(ready.split()[-1])
        written = (EXAMPLE / "cell.yaml").read_text().replace("8765", str(port))
        (folder / PLAIN).write_text(written)
        (folder / "cell.yaml").write_text(f"{written}calibrations: {{image_to_robot: {MAP}}}\n")
        shutil.copy(EXAMPLE / "pybullet_devices.py", folder)
        yield folder / "cell.yaml", Link(port, BaggieError)
    finally:
        process.terminate()
        process.wait()


@dataclass
class Way:
    """From the contracts to the report."""

    options: Options
    file: Path
    link: Link

    @property
    def steps(self) -> dict[str, Callable[[], dict[str, Any]]]:
        """In the order of docs/own-arm.md."""
        return {
            "contracts": self.contracts,
            "workcell show": self.show,
            "calibrate image-to-robot": self.calibrate,
            "doctor": self.doctor,
            "collect": self.collect,
            "train": self.train,
            "evaluate": self.evaluate,
            "report": self.report,
        }

    def contracts(self) -> dict[str, Any]:
        """`check_arm` and `check_camera`, in Python."""
        self.clear()
        cell = baggie.open_workcell(self.file.with_name(PLAIN))
        try:
            check_camera(cell.camera)
            area = cell.arm.limits.workspace
            self.link.ask(
                "lay_cube", x=(area.x_min + area.x_max) / 2, y=(area.y_min + area.y_max) / 2, yaw=0.0
            )
            found = check_arm(cell.arm, firm_height_m=CUBE_M)
            cell.arm.park()
        finally:
            cell.close()
        return {"row": {"came of it": f"arm and camera keep them; {found[0]}"}, "found": found}

    def show(self) -> dict[str, Any]:
        """What follows from the object and the gripper."""
        handling = answer(f"workcell show {self.file}")["handling"]
        chosen = {name: entry["value"] for name, entry in handling.items() if entry["source"] != "default"}
        words = ", ".join(f"{name} {value:g}" for name, value in chosen.items())
        return {"row": {"came of it": f"{words} follow from cube, hand and arm"}, "handling": chosen}

    def calibrate(self) -> dict[str, Any]:
        """The marker's plate into the hand, the table clear, and over the workspace."""
        self.clear()
        self.hold_plate()
        out = self.file.with_name(MAP)
        plain = self.file.with_name(PLAIN)
        found = answer(f"calibrate image-to-robot --workcell {plain} --prepared --out {out}")
        self.link.ask("take_plate")
        words = f"{found['points']} points, {found['leave_one_out_mm']:.2f} mm left out"
        return {"row": {"came of it": words}, "leave_one_out_mm": found["leave_one_out_mm"]}

    def doctor(self) -> dict[str, Any]:
        """Everything it checks, moving included, with somebody who lays and holds what it asks for."""
        self.clear()
        options = DoctorOptions(str(self.file), move="yes")
        findings = [asdict(finding) for finding in examine(options, helper=Helper(self))]
        well = sum(finding["verdict"] == "ok" for finding in findings)
        return {"row": {"came of it": f"{well} of {len(findings)} checks ok"}, "findings": findings}

    def collect(self) -> dict[str, Any]:
        """Unattended."""
        self.link.ask("lay_cube", x=0.47, y=0.08, yaw=0.4)
        out = self.file.with_name("recording")
        words = f"--attempts {self.options.attempts} --seed {self.options.seed} --out {out}"
        found = answer(f"collect --workcell {self.file} {words}")
        truth = self.link.ask("truth")
        attempts = list(open_dataset(out))
        good = [attempt for attempt in attempts if attempt.outcome.success]
        times = np.array([seen["time"] for seen in truth["pictures"]])
        landed, gripped = [], []
        for attempt in good:
            before, after = (
                truth["pictures"][int(np.abs(times - seen.time).argmin())]
                for seen in (attempt.before, attempt.after)
            )
            executed = attempt.outcome.executed
            gripped.append(100 * off_m(before, executed.pick.xy))
            landed.append(100 * off_m(after, executed.place.xy))
        return {
            "row": {
                "came of it": f"{found['succeeded']} of {found['attempts']} attempts succeeded",
                "by its truth": f"gripped {spread(gripped)} cm off, landed {spread(landed)} cm off, at most "
                f"{truth['pressed_n']:.0f} N",
            },
            "succeeded": found["succeeded"],
            "attempts": found["attempts"],
            "failed": found.get("failed", {}),
            "gripped_cm": gripped,
            "landed_cm": landed,
            "pressed_n": truth["pressed_n"],
        }

    def train(self) -> dict[str, Any]:
        """Four fifths to learn from, a fifth to measure on, as it does by itself."""
        steps = "" if self.options.steps is None else f"--steps {self.options.steps}"
        data, run = self.file.with_name("recording"), self.file.with_name("keypoint")
        answer(f"train --policy keypoint --data {data} --out {run} --seed {self.options.seed} {steps}")
        found = answer(f"validate --policy {run} --data {data} --out {run / 'validation'}")["labels"]
        picks, places = (spread_of(found[name]) for name in ("pick_error_cm", "place_error_cm"))
        words = f"held out: picks {picks} cm off, places {places}"
        return {"row": {"came of it": words}, "held_out": found}

    def evaluate(self) -> dict[str, Any]:
        """To goals in the picture; judged by the truth."""
        out, policy = self.file.with_name("evaluation"), self.file.with_name("keypoint")
        words = f"--episodes {self.options.episodes} --seed {self.options.seed} --out {out}"
        found = answer(f"evaluate --policy {policy} --workcell {self.file} {words}")
        truth = self.link.ask("truth")
        landings = [each.landing for each in read_episodes(out).values() if each.landing is not None]
        ended = rests(truth["pictures"], [landing.final for landing in landings])
        away = [100 * off_m(end, landing.goal) for end, landing in zip(ended, landings, strict=True)]
        within = sum(distance <= found["radius_cm"] for distance in away)
        return {
            "row": {
                "came of it": f"{rate(found['success'])} within 2 cm, {spread_of(found['distance_cm'])} cm",
                "by its truth": f"{within} of {len(away)}, {spread(away)} cm, at most {truth['pressed_n']:.0f} N",
            },
            "distance_cm": away,
            "pressed_n": truth["pressed_n"],
            "robot": found["robot"],
        }

    def report(self) -> dict[str, Any]:
        """One page."""
        page = self.file.with_name("report.html")
        answer(f"report {self.file.with_name('keypoint')} {self.file.with_name('evaluation')} --out {page}")
        return {"row": {"came of it": "one page"}, "page": str(page)}

    def clear(self) -> None:
        """The cube away."""
        self.link.ask("lay_cube", x=AWAY[0], y=AWAY[1], yaw=0.0)

    def hold_plate(self) -> None:
        """Into the hand."""
        printed = self.file.with_name("marker.png")
        cv2.imwrite(str(printed), printed_marker())
        self.link.ask("hold_plate", picture=str(printed.resolve()), side=PLATE_M, ahead=AHEAD_M)


class Helper:
    """Does in the simulator what the doctor asks a person at the terminal for."""

    def __init__(self, way: Way) -> None:
        self._way, self.clock = way, time.monotonic

    def hold(self, target: Target | None, words: str) -> None:
        """The plate, whatever it is to be."""
        self._way.hold_plate()

    def lay_firm(self, heights_m: tuple[float, float], words: str) -> float | None:
        """The cube, under the hand."""
        tool = self._way.link.ask("pose")
        self._way.link.ask("lay_cube", x=tool["x"], y=tool["y"], yaw=0.0)
        return CUBE_M

    def confirm(self, question: str) -> bool | None:
        """Nobody looks."""
        return None

    def put_away(self) -> None:
        """Cube and plate."""
        self._way.link.ask("take_plate")
        self._way.clear()


def printed_marker() -> np.ndarray:
    """`(H, W)` uint8: what `baggie print-target hand-marker` prints, cut out with a white rim."""
    marker = parse_target(HAND_MARKER)
    assert isinstance(marker, ArucoMarker)
    side = 480
    drawn = cv2.aruco.generateImageMarker(
        cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, marker.dictionary)), marker.number, side
    )
    rim = round(side * (PLATE_M / marker.size_m - 1) / 2)
    return np.asarray(cv2.copyMakeBorder(drawn, rim, rim, rim, rim, cv2.BORDER_CONSTANT, value=255))


def off_m(truth: Mapping[str, float], xy: Sequence[float]) -> float:
    """From where the cube is to a place."""
    return float(np.hypot(truth["x"] - xy[0], truth["y"] - xy[1]))


def rests(
    pictures: Sequence[Mapping[str, float]], seen: Sequence[Sequence[float]]
) -> list[Mapping[str, float]]:
    """Where the cube was in the pictures in which it was `seen`, one after the other, there, more or less."""
    found, rest = [], iter(pictures)
    for pose in seen:
        found.append(next(picture for picture in rest if off_m(picture, pose) < SAME_PLACE_M))
    return found


def spread(values: Sequence[float]) -> str:
    """Median and worst."""
    return f"{np.median(values):.2f} ({np.max(values):.2f})"


def spread_of(summary: Mapping[str, float]) -> str:
    """Likewise."""
    return f"{summary['median']:.2f} ({summary['max']:.2f})"


if __name__ == "__main__":
    main(tyro.cli(Options))
