"""What demonstrators of both styles do with the block tasks: picks, steps, and how many do their whole task.

    OMP_NUM_THREADS=1 python benchmarks/demonstration_style.py

Scenes and whims are those of `baggie collect --style STYLE --seed 0`, without pictures. How far picks are from the
middle is from where a thing's frame is, of the L where its legs cross; of what was held. Writes
docs/results/demonstration-style.{json,md}.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, field
from typing import Any, get_args

import numpy as np

from baggie.errors import LimitError, ReachError
from baggie.options.values import CollectedStyle
from baggie.registry import TASKS
from baggie.seeds import COLLECTION, STYLE, generator
from baggie.tasks.conditions import Score, strict_success
from baggie.workcell.simulated import SimulatedWorkcell, open_simulated
from commands import write_and_show

SEED = 0


@dataclass
class Shown:
    """What came of one demonstration."""

    strict: bool = False
    steps: int = 0
    earned: int = 0
    """Steps that earned something."""
    missed: int = 0
    """Steps in which nothing was held to the end."""
    off_mm: list[float] = field(default_factory=list)
    """Of each pick that held, from the middle of what it held."""


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--demonstrations", type=int, default=100, help="of each task, in each style")
    number = parser.parse_args().demonstrations
    rows = []
    for task in TASKS.names():
        cell = open_simulated(0, task, pictures=False)
        for style in get_args(CollectedStyle):
            rows.append(
                {"task": task, "style": style, **summed([demonstrate(cell, k, style) for k in range(number)])}
            )
            print(rows[-1], flush=True)
    notes = (
        "Strict: every thing is upright in a slot of its own when the demonstration ends, and still so two seconds "
        "later. Distances are between a pick and the frame of what it held. Missed are also the steps that go down on "
        "the bare table on purpose."
    )
    write_and_show("demonstration-style", "Demonstrations in both styles", rows, notes)


def demonstrate(cell: SimulatedWorkcell, number: int, style: str) -> Shown:
    """Demonstration `number` of a recording in this style."""
    cell.reset((COLLECTION, SEED, number))
    shown, score = Shown(), Score(cell.scene.conditions)
    for step in range(cell.task.max_steps):
        action = cell.demonstrate(generator(STYLE, SEED, number, step) if style == "varied" else None)
        if action is None:
            break
        cell.arm.park()
        before = cell.world.poses()
        shown.steps += 1
        try:
            outcome = cell.execute(action)
        except (LimitError, ReachError):
            break
        shown.earned += score.count(cell.state()) > 0.0
        shown.missed += not outcome.success
        moved = [
            name for name in cell.world.movable if np.abs(cell.world.pose(name) - before[name]).max() > 0.02
        ]
        if outcome.success and moved:
            off = {float(np.hypot(*(before[name][:2, 3] - action.pick.xy))) for name in moved}
            shown.off_mm.append(1000 * min(off))
    shown.strict = strict_success(cell.scene.conditions, cell)
    return shown


def summed(shown: list[Shown]) -> dict[str, Any]:
    """What many demonstrations say together."""
    off = np.concatenate([each.off_mm for each in shown])
    steps = np.array([each.steps for each in shown])
    return {
        "strict": f"{sum(each.strict for each in shown)} of {len(shown)}",
        "steps": round(float(steps.mean()), 2),
        "most steps": int(steps.max()),
        "steps that earned nothing": int(sum(each.steps - each.earned for each in shown)),
        "missed": sum(each.missed for each in shown),
        "pick from the middle, median (mm)": round(float(np.median(off)), 1),
        "most (mm)": round(float(off.max()), 1),
    }


if __name__ == "__main__":
    main()
