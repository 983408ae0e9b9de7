"""The main job from nothing: collect, look, train, validate, move bags in a closed loop, report.

Run it with `make demo`. Everything it does is a `baggie` command; each is printed before it runs, and the same demo
again goes on where it stopped.
"""

from __future__ import annotations

import shlex
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import tyro
from rich.console import Console


@dataclass(frozen=True)
class Demo:
    """Teach a simulated robot to move bags, and see how well it does."""

    out: Path = Path("demo")
    """Folder of the recording, the run and the report."""
    attempts: int = 130
    """Demonstrations to collect."""
    val: int = 25
    """How many of them to measure on; the policy learns from the others."""
    steps: int = 600
    """Batches to learn from."""
    episodes: int = 20
    """Unseen scenes for each policy."""
    seed: int = 0
    """Of everything."""
    cell: int = 0
    """The simulated workcell."""


def run(demo: Demo) -> int:
    """Run every step; the exit status of the first that fails, else 0."""
    from baggie.cli.main import DONE, main  # noqa: PLC0415 -- worker processes import this file, and need none of it

    console = Console(stderr=True)
    start = time.monotonic()
    data, keypoint, color_mask = demo.out / "recording", demo.out / "keypoint", demo.out / "color-mask"
    report = demo.out / "report.html"
    # A few attempts may fail, and only successful ones are learned from.
    train = max(int(0.9 * demo.attempts) - demo.val, 1)
    closed_loop = f"--episodes {demo.episodes} --seed {demo.seed} --cell {demo.cell} --film 1 --radius-cm 3"
    steps = [
        f"collect --attempts {demo.attempts} --seed {demo.seed} --cell {demo.cell} --out {data}",
        f"inspect {data}",
        f"train --policy keypoint --data {data} --out {keypoint} --train {train} --val {demo.val} "
        f"--steps {demo.steps} --seed {demo.seed}",
        f"validate --policy {keypoint} --data {data} --out {keypoint}/validation",
        f"evaluate --policy {keypoint} {closed_loop} --out {keypoint}/evaluation",
        f"evaluate --policy color-mask --calibration {data} {closed_loop} --out {color_mask}/evaluation",
        f"report {keypoint} {color_mask} --out {report}",
    ]
    for step in steps:
        console.print(f"\n[bold]$ baggie {step}[/bold]", soft_wrap=True, highlight=False)
        status = main(shlex.split(step))
        if status != DONE:
            return status
    minutes = (time.monotonic() - start) / 60
    print(f"\nDone in {minutes:.1f} minutes. Open the report: {report.resolve()}")
    return DONE


if __name__ == "__main__":
    sys.exit(run(tyro.cli(Demo)))
