"""What goes wrong during a night, at random moments of a collection over the robot's protocol, and what comes of it.

    python benchmarks/faults.py --moments 20

Starts `baggie lab` and, for every fault, `baggie collect` in it; lets the fault happen, waits until one more attempt is
recorded, giving the same command again where it ended, and so on; and holds what was recorded against what the lab
knows. Everything is kept below `runs`: the same command goes on where it stopped. Writes docs/results/faults.{json,md}.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from baggie.lab.web import LabControl
from baggie.results import provenance, write_results
from commands import start
from fault_night import Night, read_lines
from rehearsal import MAP, UNCALIBRATED, calibrate

HOST, PORT = "127.0.0.77", 8177
CAMERA_TIMEOUT_S = 12.0
HELD_S = 2.0
"""Of the lab's time, that a bag is carried."""
LONGEST_S = 600.0
DISK = "64m"
SPARE_BYTES = 590_000
"""Less than this is left on a full disk, which is less than an attempt: any of its files may be what does not fit."""


@dataclass(frozen=True)
class Fault:
    """Something that goes wrong; `seconds` where it ends by itself."""

    happen: Callable[[Night, float], None]
    """Gets a random number in [0, 1), too."""
    undo: Callable[[Night], None] = lambda _night: None
    """What a person does before they give the command again."""


def in_the_lab(name: str, seconds: float = 0.0) -> Fault:
    return Fault(lambda night, _share: night.lab.fault(name, seconds=seconds))


def nothing(_night: Night, _share: float) -> None:
    """Does not happen."""


def slip(night: Night, share: float) -> None:
    """Once the hand holds something: at any other moment there is nothing to lose."""
    wait_until(lambda: night.truth.is_held() or night.ended)
    night.lab.fault("slip", after=share * HELD_S)


def fill_disk(night: Night, share: float) -> None:
    free = shutil.disk_usage(night.data).free
    with ballast(night).open("wb") as file:
        os.posix_fallocate(file.fileno(), 0, max(free - int(share * SPARE_BYTES), 1))


def ballast(night: Night) -> Path:
    return night.data.parent / "ballast"


FAULTS = {
    "reflex": in_the_lab("reflex"),
    "refused motion": in_the_lab("refuse"),
    "lost link": in_the_lab("cut-link", 5.0),
    "slipped grasp": Fault(slip),
    "frozen camera": in_the_lab("freeze-camera", 20.0),
    "camera unplugged": in_the_lab("unplug-camera", 8.0),
    "kill -9": Fault(lambda night, _share: night.process.kill()),
    "full disk": Fault(fill_disk, lambda night: ballast(night).unlink(missing_ok=True)),
}


@dataclass(frozen=True)
class Options:
    """Which faults, and how often."""

    moments: int = 20
    """How often each fault happens."""
    faults: tuple[str, ...] = tuple(FAULTS)
    """Names of faults."""
    seed: int = 0
    """Of the moments and of the collections."""
    runs: Path = Path("runs/faults")
    """Where everything is kept."""


def main(options: Options) -> None:
    """Run it all and write the table."""
    if (
        "full disk" in options.faults and os.geteuid() != 0
    ):  # a small disk can be mounted in a namespace of one's own
        os.execvp("unshare", ["unshare", "--map-root-user", "--mount", sys.executable, *sys.argv])
    signal.signal(
        signal.SIGINT, signal.default_int_handler
    )  # or what a shell starts with & would be deaf to Ctrl-C
    options.runs.mkdir(parents=True, exist_ok=True)
    lab_file = options.runs / UNCALIBRATED
    words = ["lab", "--host", HOST, "--camera-port", str(PORT), "--pace", "0", "--out", str(lab_file)]
    process = start(words, stdout=subprocess.PIPE)
    assert process.stdout is not None
    if not process.stdout.readline():
        sys.exit(process.wait())
    lab = LabControl(f"http://{HOST}:{PORT}")
    try:
        workcell = calibrated(options.runs, lab_file, lab)
        rows = [row(name, options, workcell, lab) for name in options.faults]
    finally:
        process.send_signal(signal.SIGINT)
        process.wait()
    notes = (
        "Moments are uniform over the length of an attempt, the slips' over the time that the hand holds something; "
        "the next one comes when an attempt is finished. An attempt is recorded wrongly when a picture does not show "
        "the bag within 3 cm of where it truly was when that was taken, or a success left it more than 10 cm from "
        "where it was let go (the collector itself allows 9 cm). The arm's place is the lab's truth five times a "
        f"second. The full disk is a file system in memory of {DISK[:-1]} MB, mounted for that collection alone "
        "(without root in a user namespace), which another file fills up. Where the collector asked for it before it "
        "ended, the person who gives the command again lays the bag back first."
    )
    title = "What goes wrong during a night"
    for path in write_results(Path("docs/results/faults"), title, rows, provenance([options.seed]), notes):
        print(path)


def calibrated(runs: Path, lab_file: Path, lab: LabControl) -> Path:
    """A workcell file with the map from the picture to the robot, made once as docs/lab.md says."""
    made, workcell = runs / MAP, runs / "cell.yaml"
    if not made.exists():
        calibrate(workcell, lab)
    text = lab_file.read_text().replace("timeout_s: 20", f"timeout_s: {CAMERA_TIMEOUT_S:g}")
    workcell.write_text(f"{text}calibrations: {{image_to_robot: {made.name}}}\n")
    return workcell


def row(name: str, options: Options, workcell: Path, lab: LabControl) -> dict[str, Any]:
    """One fault's row of the table; as it is kept, or measured now, from where it stopped."""
    folder = options.runs / name.replace(" ", "-")
    kept, disk = folder / f"row-{options.moments}.json", folder / "disk"
    if kept.exists():
        return dict(json.loads(kept.read_text()))
    disk.mkdir(parents=True, exist_ok=True)
    if name == "full disk" and not disk.is_mount():
        subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={DISK}", "none", str(disk)], check=True)
    if not (disk / "data").exists():
        (folder / "moments.jsonl").unlink(missing_ok=True)
        (folder / "attempts.jsonl").unlink(missing_ok=True)
    lab.fault("heal")
    number = list(FAULTS).index(name)
    lab.reset(seed=number)
    night = Night(folder, disk / "data", workcell, lab, options.seed)
    calm = replace(FAULTS[name], happen=nothing)
    suffer(night, calm, 0.0, 0.0)  # first it has to be at work
    moments = read_lines(folder / "moments.jsonl")
    for moment in range(len(moments), options.moments):
        share, detail = np.random.default_rng((options.seed, number, moment)).random(2)
        moments.append(suffer(night, FAULTS[name], share, detail))
        with (folder / "moments.jsonl").open("a") as file:
            file.write(json.dumps(moments[-1]) + "\n")
        print(f"{name} {moment + 1}/{options.moments}: {moments[-1]}", file=sys.stderr, flush=True)
    suffer(night, calm, 0.0, 0.0)  # the last one may still have been ahead
    interrupted = night.interrupt()
    ended = [line for moment in moments for line in moment["endings"]]
    recording = night.check()
    result = {
        "fault": name,
        "injected": len(moments),
        "went on by itself": sum(not moment["endings"] for moment in moments),
        "ended in one line, or was killed, and went on": sum(
            bool(moment["endings"]) and moment["went_on"] for moment in moments
        ),
        "did not go on": sum(not moment["went_on"] for moment in moments),
        "ended otherwise": sum(line.startswith("exit status") for line in ended) + (not interrupted),
        "attempts finished": recording["attempts"],
        "of them successes": recording["succeeded"],
        "numbered without a gap": recording["without a gap"],
        "lost": recording["lost"],
        "recorded wrongly": sum(bool(verdict["wrong"]) for verdict in night.judged),
        "unreadable": recording["unreadable"],
        "bag laid back": sum(moment["laid_back"] for moment in moments),
        "arm outside its limits": f"{night.truth.outside} of {len(night.truth)} looks",
    }
    if disk.is_mount():
        subprocess.run(["umount", str(disk)], check=True)
    kept.write_text(json.dumps(result))
    return result


def suffer(night: Night, fault: Fault, share: float, detail: float) -> dict[str, Any]:
    """Let one fault happen, and see to it that one more attempt is finished; what that took."""
    endings: list[str] = []
    laid_back = 0

    def go_on(until: Callable[[], bool]) -> None:
        nonlocal laid_back
        while not until():
            if night.ended:
                endings.append(night.ending())
                fault.undo(night)
                if "put it back" in endings[-1] or "put the object" in endings[-1]:
                    laid_back += 1
                    night.lab.reset(seed=len(night.judged))
                night.begin()
            time.sleep(0.2)

    at = time.monotonic() + share * night.usual_s
    go_on(lambda: time.monotonic() > at)
    finished, began = night.poll(), time.monotonic()
    fault.happen(night, detail)
    go_on(lambda: night.poll() > finished or time.monotonic() - began > LONGEST_S)
    return {
        "endings": endings,
        "laid_back": laid_back,
        "went_on": night.poll() > finished,
        "took_s": time.monotonic() - began,
    }


def wait_until(met: Callable[[], bool], longest_s: float = LONGEST_S) -> None:
    deadline = time.monotonic() + longest_s
    while not met() and time.monotonic() < deadline:
        time.sleep(0.1)


if __name__ == "__main__":
    main(tyro.cli(Options))
