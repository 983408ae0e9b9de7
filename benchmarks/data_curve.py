"""How many attempts does it take? `keypoint` trained on 10 to 400 of them.

    python benchmarks/data_curve.py --recording runs/recordings/cell-15 --runs runs/data-curve

Small numbers are tried on several sets of attempts, none of which share one. All are measured on the same 50, which
come after all of them. Writes docs/results/data-curve.{json,md,png}.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import tyro

from baggie.learning.keypoint import KeypointRecipe
from baggie.results import provenance, write_results
from teaching import Lesson, teach_all

COUNTS = (10, 25, 50, 100, 200, 400)
MOST = 400
SETS = 3
RESULTS = Path("docs/results")


@dataclass(frozen=True)
class Options:
    """Train and measure."""

    recording: Path = Path("runs/recordings/cell-15")
    """At least 450 successful attempts."""
    runs: Path = Path("runs/data-curve")


def main(options: Options) -> None:
    """Train what is missing, write table and plot."""
    lessons = {
        (count, number): Lesson(
            f"{count}-set-{number}", options.recording, first=number * count, train=count, val_after=MOST
        )
        for count in COUNTS
        for number in range(min(SETS, MOST // count))
    }
    errors = teach_all(list(lessons.values()), options.runs)
    rows = [row(count, [errors[le.name] for (c, _), le in lessons.items() if c == count]) for count in COUNTS]
    notes = (
        "Errors against the simulator's truth on the same 50 attempts, none of which any training saw; mean over sets "
        "of attempts that share none, in brackets the lowest and the highest mean."
        f" Every training takes {KeypointRecipe.steps} batches of 8."
    )
    write_results(RESULTS / "data-curve", "How many attempts it takes", rows, provenance([0]), notes)
    draw({c: [errors[le.name] for (k, _), le in lessons.items() if k == c] for c in COUNTS})


def row(count: int, sets: list[dict[str, Any]]) -> dict[str, Any]:
    """One number of attempts."""
    result: dict[str, Any] = {"attempts": count, "sets": len(sets)}
    for what in ("pick", "place"):
        means = [float(np.mean(e[f"{what}_cm"])) for e in sets]
        result[f"{what} error (cm)"] = f"{np.mean(means):.2f} ({min(means):.2f} to {max(means):.2f})"
        result[f"worst {what} (cm)"] = round(max(max(e[f"{what}_cm"]) for e in sets), 2)
    return result


def draw(by_count: dict[int, list[dict[str, Any]]]) -> None:
    """The same as a picture."""
    mpl.use("Agg")
    from matplotlib import pyplot as plt  # noqa: PLC0415

    figure, axes = plt.subplots(figsize=(6, 3.6), layout="constrained")
    for what, color in (("pick", "#c0392b"), ("place", "#1e8449")):
        means = [np.mean([np.mean(e[f"{what}_cm"]) for e in sets]) for sets in by_count.values()]
        axes.plot(list(by_count), means, "o-", color=color, label=what)
        for count, sets in by_count.items():
            axes.plot(
                [count] * len(sets), [np.mean(e[f"{what}_cm"]) for e in sets], ".", color=color, alpha=0.5
            )
    axes.set(
        xscale="log",
        xlabel="attempts learned from",
        ylabel="mean error against the truth (cm)",
        ylim=(0, None),
    )
    axes.set_xticks(list(by_count), [str(count) for count in by_count])
    axes.minorticks_off()
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig(RESULTS / "data-curve.png", dpi=130)


if __name__ == "__main__":
    main(tyro.cli(Options))
