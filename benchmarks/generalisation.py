"""Bags, tables, lamps and clutter that nobody collected with: where a learned policy beats the colour mask.

    python benchmarks/generalisation.py --recordings runs/recordings --runs runs/generalisation

Trains `keypoint` on a plain and a varied recording of one cell, and runs both, and the colour mask, in every scenery.
The varied one is taught for longer and with more new looks, as there is more to learn.
Goes on where it stopped. Writes docs/results/generalisation.{json,md}.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro

from commands import failures, rate, read, run, spread

SCENERIES = ("plain", "light", "varied", "unseen-bag", "unseen", "two-bags")


@dataclass(frozen=True)
class Options:
    """Train and evaluate."""

    recordings: Path = Path("runs/recordings")
    """Holds `cell-N`, and `varied-N` collected with --scenery varied."""
    runs: Path = Path("runs/generalisation")
    cell: int = 16
    episodes: int = 50
    """In every scenery."""
    seed: int = 1
    """Of the scenes."""


def main(options: Options) -> None:
    """Run what is missing and write the table."""
    from baggie.results import provenance, write_results  # noqa: PLC0415 -- workers import this file

    subjects = {
        "keypoint, plain recording": options.recordings / f"cell-{options.cell}",
        "keypoint, varied recording": options.recordings / f"varied-{options.cell}",
        "color-mask, told every bag's colour": None,
    }
    rows = []
    for name, recording in subjects.items():
        folder = options.runs / name.replace(", ", "-").replace(" ", "-").replace("'", "")
        policy = f"color-mask --calibration {options.recordings / f'cell-{options.cell}'}"
        if recording is not None:
            policy = str(folder)
            more = "--steps 2000 --new-looks 0.6" if recording.name.startswith("varied-") else ""
            run(
                f"train --policy keypoint --data {recording} --out {folder} --train 200 --val 50 --seed 0 {more}"
            )
        for scenery in SCENERIES:
            run(
                f"evaluate --policy {policy} --scenery {scenery} --goal virtual --episodes {options.episodes} "
                f"--seed {options.seed} --cell {options.cell} --film 0 --out {folder}/{scenery}"
            )
            rows.append(row(name, scenery, read(folder / scenery)))
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


def row(name: str, scenery: str, metrics: dict[str, Any]) -> dict[str, Any]:
    """One policy in one scenery."""
    success, stated = metrics["success"], metrics.get("confidence", {})

    def inside(what: str) -> str:
        return f"{100 * stated[what]['rate']:.0f}%" if what in stated else ""

    return {
        "policy": name,
        "scenery": scenery,
        "within 2 cm": rate(success),
        "median distance (cm)": round(metrics["distance_cm"]["median"], 2),
        "pick error": spread(metrics["pick_error_cm"]),
        "place error": spread(metrics["place_error_cm"]),
        "asked for help": round(metrics["asked_for_help"]["rate"] * success["n"]),
        "picks in radius": inside("pick_within"),
        "places in radius": inside("place_within"),
        "failures": failures(metrics),
    }


if __name__ == "__main__":
    main(tyro.cli(Options))
