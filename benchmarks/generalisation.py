"""Bags, tables, lamps and clutter that nobody collected with: where a learned policy beats the colour mask.

    python benchmarks/generalisation.py --recordings runs/recordings --runs runs/generalisation

Trains `keypoint` on a plain and a varied recording of one cell, and runs both, and the colour mask, in every scenery.
Goes on where it stopped. Writes docs/results/generalisation.{json,md}.
"""

from __future__ import annotations

import json
import shlex
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro

SCENERIES = ("plain", "light", "varied", "unseen", "two-bags")


@dataclass(frozen=True)
class Options:
    """Train and evaluate."""

    recordings: Path = Path("runs/recordings")
    """Holds `cell-N`, and `varied-N` collected with --scenery varied."""
    runs: Path = Path("runs/generalisation")
    cell: int = 0
    episodes: int = 50
    """In every scenery."""
    seed: int = 1
    """Of the scenes."""


def main(options: Options) -> int:
    """Run what is missing and write the table; the exit status of the first step that fails, else 0."""
    from baggie.cli import DONE  # noqa: PLC0415 -- worker processes import this file
    from baggie.cli import main as baggie  # noqa: PLC0415
    from baggie.evaluation.results import provenance, write_results  # noqa: PLC0415

    subjects = {
        "keypoint, plain recording": options.recordings / f"cell-{options.cell}",
        "keypoint, varied recording": options.recordings / f"varied-{options.cell}",
        "color-mask, told every bag's colour": None,
    }
    rows = []
    for name, recording in subjects.items():
        run = options.runs / name.replace(", ", "-").replace(" ", "-").replace("'", "")
        commands = []
        if recording is not None:
            commands.append(
                f"train --policy keypoint --data {recording} --out {run} --train 200 --val 50 --seed 0"
            )
        for scenery in SCENERIES:
            policy = (
                str(run)
                if recording is not None
                else f"color-mask --calibration {options.recordings / f'cell-{options.cell}'}"
            )
            commands.append(
                f"evaluate --policy {policy} --scenery {scenery} --goal virtual --episodes {options.episodes} "
                f"--seed {options.seed} --cell {options.cell} --film 0 --out {run}/{scenery}"
            )
        for command in commands:
            print(f"$ baggie {command}", file=sys.stderr)
            status = baggie(shlex.split(command))
            if status != DONE:
                return status
        rows += [row(name, scenery, run / scenery) for scenery in SCENERIES]
    notes = (
        "`src/baggie/sim/variety.py` says what each scenery draws from; `unseen` shares no colour, size or shape of "
        "bag with what was collected. Errors of plans against the simulator's truth, mean (worst), in cm. With two "
        "bags the policy is told a pixel on the one to be moved. The colour mask knows the colour of each bag, which a "
        "learned policy does not."
    )
    write_results(
        Path("docs/results/generalisation"),
        "Bags, tables, lamps and clutter that nobody collected with",
        rows,
        provenance([options.seed]),
        notes,
    )
    return 0


def row(name: str, scenery: str, folder: Path) -> dict[str, Any]:
    """One policy in one scenery."""
    metrics = json.loads((folder / "metrics.json").read_text())
    success, stated = metrics["success"], metrics.get("confidence", {})

    def spread(what: str) -> str:
        return f"{metrics[what]['mean']:.2f} ({metrics[what]['max']:.2f})"

    return {
        "policy": name,
        "scenery": scenery,
        "within 2 cm": f"{100 * success['rate']:.0f}% of {success['n']} "
        f"({100 * success['low']:.0f} to {100 * success['high']:.0f})",
        "median distance (cm)": round(metrics["distance_cm"]["median"], 2),
        "pick error": spread("pick_error_cm"),
        "place error": spread("place_error_cm"),
        "asked for help": round(metrics["asked_for_help"]["rate"] * success["n"]),
        "picks in radius": f"{100 * stated['pick_within']['rate']:.0f}%" if "pick_within" in stated else "",
        "places in radius": f"{100 * stated['place_within']['rate']:.0f}%"
        if "place_within" in stated
        else "",
        "failures": ", ".join(f"{n} {cause}" for cause, n in metrics["failures"].items()),
    }


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Options)))
