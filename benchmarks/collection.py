"""An unattended collection that is killed at random moments: what is on disk at the end, and how fast it came.

    python benchmarks/collection.py --out runs/recording

Starts `baggie collect`, sends it SIGKILL `kills` times at random moments, lets the last start finish, and checks that
every attempt is readable exactly once. Writes docs/results/collection.{json,md}.
"""

from __future__ import annotations

import json
import random
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

import baggie
from baggie.results import provenance, write_results

RESULTS = Path("docs/results")


@dataclass(frozen=True)
class Options:
    """Collect, kill, resume, check."""

    out: Path = Path("runs/recording")
    """Folder of the recording."""
    attempts: int = 300
    """How many attempts there are to be."""
    seed: int = 0
    """Of the collection and of the moments of the kills."""
    cell: int = 0
    """The simulated workcell."""
    kills: int = 3
    """How often to kill the collector."""


def command(options: Options) -> list[str]:
    """The command line of the collection."""
    words = f"collect --attempts {options.attempts} --seed {options.seed} --cell {options.cell} --out {options.out}"
    return [sys.executable, "-m", "baggie", *words.split(), "--json"]


def recorded(out: Path) -> int:
    """How many attempts are on disk, by the file that is written last."""
    info = out / "meta" / "info.json"
    return int(json.loads(info.read_text())["total_episodes"]) if info.exists() else 0


def main(options: Options) -> None:
    """Run it all and write the table."""
    moments = sorted(random.Random(options.seed).sample(range(5, options.attempts - 5), options.kills))
    for moment in moments:
        process = subprocess.Popen(command(options), stdout=subprocess.DEVNULL)
        while recorded(options.out) < moment and process.poll() is None:
            time.sleep(0.05)
        time.sleep(random.Random(moment).random())  # anywhere within an attempt
        process.send_signal(signal.SIGKILL)
        process.wait()
        print(f"killed with {recorded(options.out)} attempts on disk", file=sys.stderr)
    before, start = recorded(options.out), time.monotonic()
    done = subprocess.run(command(options), stdout=subprocess.PIPE, text=True, check=True)
    minutes = (time.monotonic() - start) / 60
    summary = json.loads(done.stdout)

    dataset = baggie.open_dataset(options.out)
    ids = [attempt.attempt_id for attempt in dataset]  # decodes every picture
    numbers = dataset.successful().numbers()
    executed, truth_before, truth_after = (numbers[k] for k in ("executed", "truth_before", "truth_after"))
    row = {
        "attempts": len(ids),
        "each exactly once": ids == list(range(options.attempts)),
        "killed": options.kills,
        "succeeded": summary["succeeded"],
        "grasped, after retries (%)": 100 * (1 - summary["failed"].get("missed-grasp", 0) / len(ids)),
        "failed": json.dumps(summary["failed"]),
        "attempts a minute, collecting": summary["attempts_per_minute"],
        "attempts a minute, start-up included": (len(ids) - before) / minutes,
        "pick to bag's centre (mm)": 1000 * _mean_distance(executed[:, :2], truth_before[:, :2]),
        "release to bag's centre (mm)": 1000 * _mean_distance(executed[:, 3:5], truth_after[:, :2]),
    }
    notes = (
        "The rates are of the last start, after the last kill. Distances are means over successful attempts."
    )
    for path in write_results(
        RESULTS / "collection",
        "An unattended collection, killed and resumed",
        [row],
        provenance([options.seed]),
        notes,
    ):
        print(path)


def _mean_distance(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.linalg.norm(a - b, axis=1).mean())


if __name__ == "__main__":
    main(tyro.cli(Options))
