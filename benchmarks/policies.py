"""Every policy on one recording: trained, validated, run in the closed loop, and put side by side.

    python benchmarks/policies.py --data runs/recording --runs runs

`regression` takes an hour on two cores. Goes on where it stopped. Writes docs/results/policies.{json,md}, and the
table of the README.
"""

from __future__ import annotations

import json
import shlex
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro

RESULTS = Path("docs/results")
README = Path("README.md")
START, END = "<!-- results: written by benchmarks/policies.py -->", "<!-- end of results -->"
PUBLISHED = {
    "policy": "published: ResNet-18 on a real Franka (Baggie Boogie)",
    "pick error (cm)": "7.8",
    "place error (cm)": "5.8",
    "trained in": "2 x 10,000 steps",
    "bag within 2 cm of the goal": '"with certain errors"',
}


@dataclass(frozen=True)
class Options:
    """Measure the policies."""

    data: Path = Path("runs/recording")
    """A recording of at least 250 successful attempts."""
    runs: Path = Path("runs")
    """Where the training runs go."""
    cell: int = 0
    """The cell it was recorded in."""
    seed: int = 0
    """Of training and of the scenes."""
    episodes: int = 100
    """Closed-loop episodes for each."""
    policies: tuple[str, ...] = ("keypoint", "color-mask", "regression")
    """Which."""
    closed_loop: tuple[str, ...] = ("keypoint", "color-mask", "regression")
    """Which of them to run in the closed loop."""


def main(options: Options) -> int:
    """Run what is missing and write the table; the exit status of the first step that fails, else 0."""
    from baggie.cli import DONE  # noqa: PLC0415 -- worker processes import this file
    from baggie.cli import main as baggie  # noqa: PLC0415
    from baggie.evaluation.results import provenance, write_results  # noqa: PLC0415

    for policy in options.policies:
        for step in steps(options, policy):
            print(f"$ baggie {step}", file=sys.stderr)
            status = baggie(shlex.split(step))
            if status != DONE:
                return status
    rows = [row(options.runs / policy, policy) for policy in options.policies]
    notes = (
        "Errors are against the simulator's truth on the 50 held-out attempts (mean, in brackets the worst), after "
        "training on 200. The closed loop runs on scenes that no collection can produce; in brackets Wilson's 95% "
        "interval. The published figures are errors on real pictures, against the poses the arm was at."
    )
    write_results(
        RESULTS / "policies",
        "Policies on one recording",
        [*rows, PUBLISHED],
        provenance([options.seed]),
        notes,
    )
    write_readme([*rows, PUBLISHED], notes)
    return 0


def steps(options: Options, policy: str) -> list[str]:
    """The commands that measure one policy."""
    run = options.runs / policy
    trained = policy != "color-mask"
    name = str(run) if trained else policy
    train = f"train --policy {policy} --data {options.data} --out {run} --train 200 --val 50 --seed {options.seed}"
    calibration = "" if trained else f"--calibration {options.data}"
    evaluate = (
        f"evaluate --policy {name} {calibration} --episodes {options.episodes} --seed {options.seed} "
        f"--cell {options.cell} --out {run}/evaluation"
    )
    return [
        *([train] if trained else []),
        f"validate --policy {name} --data {options.data} --out {run}/validation",
        *([evaluate] if policy in options.closed_loop else []),
    ]


def row(run: Path, policy: str) -> dict[str, Any]:
    """One line of the table."""
    validation = json.loads((run / "validation" / "metrics.json").read_text())
    evaluated, training = run / "evaluation" / "metrics.json", run / "metrics.json"
    seconds = json.loads(training.read_text())["train_s"] if training.exists() else None
    truth = validation["truth"]
    return {
        "policy": policy,
        "pick error (cm)": spread(truth["pick_error_cm"]),
        "place error (cm)": spread(truth["place_error_cm"]),
        "trained in": "not trained" if seconds is None else f"{seconds / 60:.1f} min",
        "decision (ms)": round(validation["decision_ms"]["median"], 1),
        **(closed_loop(json.loads(evaluated.read_text())) if evaluated.exists() else {}),
    }


def closed_loop(metrics: dict[str, Any]) -> dict[str, str]:
    """How the bags ended."""
    success, distance = metrics["success"], metrics["distance_cm"]
    return {
        "bag within 2 cm of the goal": f"{100 * success['rate']:.0f}% of {success['n']} "
        f"({100 * success['low']:.0f} to {100 * success['high']:.0f})",
        "final distance (cm)": f"{distance['median']:.2f} median, {distance['max']:.1f} worst",
    }


def spread(summary: dict[str, float]) -> str:
    """Mean and worst."""
    return f"{summary['mean']:.2f} ({summary['max']:.2f})"


def write_readme(rows: list[dict[str, Any]], notes: str) -> None:
    """Put the table into the README, between its two marks."""
    text = README.read_text()
    before, rest = text.split(START)
    _, after = rest.split(END)
    columns = list(rows[0])
    lines = [columns, ["---"] * len(columns), *([str(row.get(c, "")) for c in columns] for row in rows)]
    table = "\n".join("| " + " | ".join(line) + " |" for line in lines)
    README.write_text(f"{before}{START}\n\n{table}\n\n{notes}\n\n{END}{after}")


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Options)))
