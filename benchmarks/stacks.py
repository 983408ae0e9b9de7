"""Towers, pyramids and layers of bags, built by the oracle or by a policy that learned from the robot's own stacks.

    python benchmarks/stacks.py oracle
    python benchmarks/stacks.py keypoint --attempts 300
    python benchmarks/stacks.py color-mask --rows tower-3-one-color

`keypoint` collects `bag-stack` and trains on it first, where that is not done. Each goes on where it stopped and writes
docs/results/stacks-NAME.{json,md}.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import tyro

from commands import rate, read, run

ROWS = {
    "tower-3": ("bag-tower", ""),
    "tower-3-one-color": ("bag-tower", "--one-color"),
    "pyramid-3-2-1": ("bag-pyramid", ""),
    "layers-2x2-2x2-turned": ("bag-layers", ""),
    "tower-3-unseen-bags": ("bag-tower", "--scenery unseen-bag"),
    "tower-3-taken-apart": ("bag-unstack", ""),
    "tower-4": ("bag-tower", "--pattern tower:4"),
    "tower-5": ("bag-tower", "--pattern tower:5"),
    "tower-6": ("bag-tower", "--pattern tower:6"),
}
"""What is built: the task, and what is said beside."""
VAL_SHARE = 0.1


@dataclass(frozen=True)
class Options:
    """Collect, train and evaluate what is missing."""

    policy: tyro.conf.Positional[Literal["oracle", "keypoint", "color-mask"]]
    rows: tuple[str, ...] = tuple(ROWS)
    """Of `ROWS`."""
    attempts: int = 300
    """Of the robot's own, to learn from and to validate on."""
    episodes: int = 100
    cell: int = 0
    seed: int = 13
    """Of the test scenes; none of it was looked at."""
    recording: Path = Path("runs/recordings/stack-0")
    """Collected when it is not there."""
    runs: Path = Path("runs/stacks")
    results: Path = Path("docs/results")
    """Where the table goes."""


def main(options: Options) -> None:
    """Run what is missing and write the table."""
    from baggie.results import provenance, write_results  # noqa: PLC0415 -- workers import this file

    name = options.policy if options.policy != "keypoint" else f"keypoint-{options.attempts}"
    policy = learned(options, name) if options.policy == "keypoint" else options.policy
    rows = [
        {"pattern": row, **evaluated(options, policy, options.runs / name / row, *ROWS[row])}
        for row in options.rows
    ]
    notes = (
        "Success: every bag in a slot of its own and in its layer, at the end and two seconds later, in which nothing "
        "sleeps; in brackets Wilson's 95% interval. Layers from below: the share of episodes in which it is right, and "
        "the median offset of its bags from their slots. Time is that of the wall clock of one process for a scene, "
        "physics, pictures and decisions included; the machine may have done other work besides."
    )
    taught = f", taught by {options.attempts} attempts of its own" if options.policy == "keypoint" else ""
    title = f"Stacks of bags by {options.policy}{taught}"
    write_results(options.results / f"stacks-{name}", title, rows, provenance([options.seed]), notes)


def learned(options: Options, name: str) -> str:
    """The folder of a policy trained on what succeeded of the first attempts of a recording of the robot's own."""
    from baggie.data import open_dataset  # noqa: PLC0415 -- workers import this file
    from baggie.data.summary import is_demonstration  # noqa: PLC0415

    data, folder = options.recording, options.runs / name
    run(f"collect --task bag-stack --attempts {options.attempts} --seed 0 --cell {options.cell} --out {data}")
    recorded = open_dataset(data)
    teach = sum(is_demonstration(recorded[n]) for n in range(options.attempts))
    val = round(VAL_SHARE * teach)
    run(f"train --policy keypoint --data {data} --out {folder} --seed 0 --train {teach - val} --val {val}")
    return str(folder)


def evaluated(options: Options, policy: str, out: Path, task: str, words: str) -> dict[str, Any]:
    """How the episodes of a pattern ended."""
    told = f"--episodes {options.episodes} --seed {options.seed} --cell {options.cell}"
    run(f"evaluate --policy {policy} --task {task} {words} {told} --out {out}")
    metrics = read(out)
    layers = metrics.get("layers", {}).values()  # what is taken apart has none
    return {
        "success": rate(metrics["success"]),
        "partial credit": round(metrics["partial_credit"]["mean"], 3),
        "layers right": ", ".join(f"{100 * layer['success']['rate']:.0f}%" for layer in layers),
        "offset (cm)": ", ".join(f"{layer['offset_cm']['median']:.1f}" for layer in layers),
        "steps": metrics["steps"]["mean"],
        "failures": ", ".join(f"{n} {cause}" for cause, n in metrics["failures"].items()),
        "failed steps": ", ".join(f"{n} {cause}" for cause, n in metrics["failed_steps"].items()),
    }


if __name__ == "__main__":
    main(tyro.cli(Options))
