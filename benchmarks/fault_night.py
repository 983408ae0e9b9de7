"""A night of collecting in the virtual lab, and what only the lab knows of it: where bag and arm truly were."""

from __future__ import annotations

import bisect
import hashlib
import json
import signal
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np

from baggie.collect.machine import LANDING_DOUBTED_M
from baggie.data import open_dataset
from baggie.data.files import CALIBRATION_FOLDER, Layout
from baggie.data.summary import inspect_dataset
from baggie.errors import BaggieError
from baggie.geometry import FloatArray
from baggie.lab.web import LabControl
from baggie.policies.baselines import ColorMaskPolicy
from baggie.types import Attempt, Observation
from baggie.workcell.workcell import WorkcellSettings
from commands import start

PERIOD_S = 0.2
"""Between two looks at the truth."""
BLINK_S = 2.0
"""Longer ago is not known."""
SEEN_OFF_M = 0.03
"""A picture shows the bag this near to where it truly was when it was taken, or it is of another moment."""
LANDED_OFF_M = LANDING_DOUBTED_M + 0.01
"""A success left the bag this near to where it was let go: what the collector allows, and its eye's error."""
FIRST_S = 20.0
"""An attempt takes so long, before there is one to measure."""
STRAY_M = 0.01
"""So far the arm may overshoot its limits."""
ATTEMPTS = 1000
"""More than any night has; it is ended by Ctrl-C."""


class Truth:
    """Looks behind the lab's scenes, five times a second, from a thread of its own."""

    def __init__(self, lab: LabControl) -> None:
        self._lab, self._limits = lab, WorkcellSettings().limits
        self._times: list[float] = []
        self._samples: list[dict[str, Any]] = []
        self.outside = 0
        """Samples with the arm outside of its limits."""
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._over.set()
        self._thread.join()

    def __len__(self) -> int:
        return len(self._times)

    def at(self, moment: float) -> FloatArray:
        """Where the bag was then (seconds of the wall clock), `(2,)` metres; NaN where nobody looked."""
        right = min(bisect.bisect(self._times, moment), len(self._times) - 1)
        nearest = min((max(right - 1, 0), right), key=lambda index: abs(self._times[index] - moment))
        if abs(self._times[nearest] - moment) > BLINK_S:
            return np.full(2, np.nan)
        bag = self._samples[nearest]["bag"]
        return np.array([bag["x"], bag["y"]])

    def is_held(self) -> bool:
        """Whether the bag hangs in the air."""
        return bool(self._samples) and self._samples[-1]["bag_lowest_z"] > 0.02

    def _watch(self) -> None:
        while not self._over.wait(PERIOD_S):
            sample = self._lab.truth()
            self._samples.append(sample)
            self._times.append(time.time())
            self.outside += not self._is_inside(**sample["tool"])

    def _is_inside(self, x: float, y: float, z: float) -> bool:
        low = z < self._limits.clearance_z_m
        area = self._limits.workspace if low else self._limits.reach
        return area.contains(x, y, -STRAY_M) and z > self._limits.z_min_m - STRAY_M


class Night:
    """`baggie collect` in the lab, begun again with the same words as often as somebody says so."""

    def __init__(self, folder: Path, data: Path, workcell: Path, lab: LabControl, seed: int) -> None:
        self.data, self.lab = data, lab
        self._log, self._judged_file = folder / "collect.log", folder / "attempts.jsonl"
        self._words = f"collect --workers 1 --attempts {ATTEMPTS} --seed {seed}".split()
        self._words += ["--workcell", str(workcell), "--out", str(data)]
        self.judged = read_lines(self._judged_file)
        """What is known of each attempt that was seen to be finished."""
        self.truth = Truth(lab)
        self.begin()

    def begin(self) -> None:
        """The same command (again)."""
        self._log_start = self._log.stat().st_size if self._log.exists() else 0
        with self._log.open("a") as log:
            self.process = start(self._words, stdout=log, stderr=log)

    @property
    def usual_s(self) -> float:
        """How long an attempt takes."""
        return float(np.median([verdict["seconds"] for verdict in self.judged] or [FIRST_S]))

    @property
    def ended(self) -> bool:
        return self.process.poll() is not None

    def ending(self) -> str:
        """How it ended: its one line, `killed`, or all that it said where that was more than it should."""
        said = self._log.read_bytes()[self._log_start :].decode(errors="replace")
        lines = [line for line in said.splitlines() if line.startswith("error:")]
        if self.process.returncode == -signal.SIGKILL:
            return "killed"
        if self.process.returncode == 1 and len(lines) == 1 and "Traceback" not in said:
            return lines[0]
        return f"exit status {self.process.returncode}: {said}"

    def interrupt(self) -> bool:
        """Ctrl-C; whether it ended as it promises."""
        self.process.send_signal(signal.SIGINT)
        self.truth.close()
        return self.process.wait(60) == 130

    def poll(self) -> int:
        """How many attempts there are; whatever is new is judged."""
        info = self.data / "meta" / "info.json"
        count = int(json.loads(info.read_text())["total_episodes"]) if info.exists() else 0
        if count > len(self.judged) and len(self.truth):
            try:
                dataset = open_dataset(self.data)
                fresh = [self._judge(dataset[index]) for index in range(len(self.judged), len(dataset))]
            except BaggieError:  # it is being written, or was cut off; at the latest the end will tell
                return len(self.judged)
            with self._judged_file.open("a") as file:
                file.writelines(json.dumps(verdict) + "\n" for verdict in fresh)
            self.judged += fresh
        return len(self.judged)

    def check(self) -> dict[str, Any]:
        """What became of the recording."""
        found: dict[str, Any] = {"attempts": len(self.judged), "succeeded": 0, "lost": 0, "unreadable": 0}
        try:
            inspect_dataset(self.data)
            dataset = open_dataset(self.data)
            ids = [attempt.attempt_id for attempt in dataset]  # decodes every picture
            found["succeeded"] = sum(verdict["success"] for verdict in self.judged)
            found["without a gap"] = ids == list(range(len(ids)))
        except (BaggieError, OSError):
            return found | {"unreadable": 1, "without a gap": False}
        found["lost"] = sum(self._digest(verdict["id"]) != verdict["digest"] for verdict in self.judged)
        return found

    def _digest(self, attempt_id: int) -> str | None:
        path = Layout(self.data).attempt(attempt_id)
        return hashlib.sha256(path.read_bytes()).hexdigest() if path.exists() else None

    def _judge(self, attempt: Attempt) -> dict[str, Any]:
        assert attempt.after is not None
        off = {
            "before": self._off_m(attempt.before, attempt.box_before),
            "after": self._off_m(attempt.after, attempt.box_after),
        }
        wrong = [f"the picture {name} is of another moment" for name, m in off.items() if m > SEEN_OFF_M]
        landed = float(np.linalg.norm(self.truth.at(attempt.after.time) - attempt.outcome.executed.place.xy))
        if attempt.outcome.success and landed > LANDED_OFF_M:
            wrong.append("no success")
        return {
            "id": attempt.attempt_id,
            "digest": self._digest(attempt.attempt_id),
            "success": attempt.outcome.success,
            "failure": attempt.outcome.failure,
            "off_m": off,
            "seconds": attempt.after.time - attempt.before.time,
            "landed_m": landed,
            "wrong": wrong,
        }

    def _off_m(self, picture: Observation, box: FloatArray | None) -> float:
        """From where the picture shows the bag to where it was; infinite if it shows none where it lay."""
        truth = self.truth.at(picture.time)
        if box is None or np.isnan(box).any():
            return np.inf if WorkcellSettings().workspace.contains(*truth) else 0.0
        to_robot = ColorMaskPolicy.load(self.data / CALIBRATION_FOLDER).image_to_robot
        scale = to_robot.camera.width / picture.size[0]
        center = (box.mean(axis=0) + 0.5) * scale - 0.5
        return float(np.linalg.norm(to_robot.to_robot(center)[0] - truth))


def read_lines(path: Path) -> list[dict[str, Any]]:
    """A file with one JSON object a line; a last one that was cut off does not count."""
    whole = path.read_text().split("\n")[:-1] if path.exists() else []
    return [json.loads(line) for line in whole]
