"""Towers of three bags in the virtual lab, over the robot's own network protocol, from its camera's stream alone.

    python benchmarks/lab_tower.py --policy runs/stacks/keypoint-300

The policy was taught in the simulated cell of the same number, by the robot's own attempts there
(`benchmarks/stacks.py keypoint`), and has never seen this connection. The lab's truth is asked at the end only, by what
judges. Goes on where it stopped and writes RESULTS.{json,md}.
"""

from __future__ import annotations

import sys
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import tyro

import baggie
from baggie.errors import BaggieError, LimitError, ReachError, UnsureError
from baggie.evaluation.builder import build
from baggie.evaluation.log import append_line, read_lines
from baggie.geometry import PlanarPose
from baggie.lab.lab import draw_scene
from baggie.lab.web import LabControl
from baggie.metrics import success_rate
from baggie.policies import Policy
from baggie.registry import TASKS
from baggie.results import provenance, write_results
from baggie.sim.cell import draw_cell
from baggie.tasks.conditions import all_hold, strict_success
from baggie.tasks.stacked import Stacked
from baggie.workcell.workcell import Workcell
from commands import rate
from rehearsal import Options as Rehearsal
from rehearsal import calibrate, lab, step

TASK = "bag-tower"
TOWERS = "towers.jsonl"
"""What came of each tower, in the folder of the run."""


@dataclass(frozen=True)
class Options:
    """Build."""

    policy: Path
    """Taught in the simulated cell."""
    towers: int = 10
    cell: int = 0
    seed: int = 600
    """Of the first tower's scene; each other one's is the next. None of those from 600 on was looked at."""
    out: Path = Path("runs/lab-tower")
    results: Path = Path("docs/results/stacks-lab")
    host: str = "127.0.3.3"
    camera_port: int = 8195


def main(options: Options) -> None:
    """Calibrate, build what is missing, and write the table."""
    log, seeds = options.out / TOWERS, range(options.seed, options.seed + options.towers)
    options.out.mkdir(parents=True, exist_ok=True)
    terms = {"policy": str(options.policy), "cell": options.cell}
    for kept in read_lines(log):
        if {name: kept[name] for name in terms} != terms:
            sys.exit(f"expected towers by {terms} in {log}, got one by {kept['policy']}; give another --out")
    words = Rehearsal(cell=options.cell, out=options.out, host=options.host, camera_port=options.camera_port)
    with lab(words, TASK) as (file, control):
        step(words, "baggie calibrate image-to-robot", lambda: calibrate(file, control))
        cell, policy = baggie.open_workcell(file), baggie.load_policy(options.policy)
        try:
            for seed in seeds:
                if all(kept["seed"] != seed for kept in read_lines(log)):
                    append_line(
                        log, terms | {"seed": seed} | tower(control, cell, policy, options.cell, seed)
                    )
        finally:
            cell.close()
    row = summary([kept for kept in read_lines(log) if kept["seed"] in seeds])
    notes = (
        "Everything went over Franka's control protocol (TCP and UDP) and the camera's network stream to "
        f"`baggie lab --task {TASK}`, which simulates cell {options.cell} behind them; the arm says that it feels 5 N, "
        "so heights are counted by layer. The map from the picture to the robot was calibrated over the same "
        "connection. The policy learned from the robot's own attempts in the simulated cell of this number. Success: "
        "every bag in its layer, at the end and two seconds of the lab's time later, by the lab's truth; in brackets "
        "Wilson's 95% interval. Layers from below: the share of towers in which it is right, and the median offset of "
        "its bags from their slots. The lab ran as fast as it could; minutes are the wall clock's."
    )
    write_results(options.results, "Towers of three in the virtual lab", [row], provenance(seeds), notes)


def tower(control: LabControl, cell: Workcell, policy: Policy, number: int, seed: int) -> dict[str, Any]:
    """Build the tower of a scene in the lab's cell of a number; what came of it, by the lab's truth."""
    began = time.perf_counter()
    control.reset(seed)
    _, scene = draw_scene(TASKS[TASK], draw_cell(number), seed)
    (stacked,) = scene.conditions
    assert isinstance(stacked, Stacked)
    slots: list[int] = []
    failed: list[str] = []
    cause = message = ""
    try:
        for done in build(cell, policy, stacked.pattern, PlanarPose(0.0, 0.0)):
            slots.append(done.slot)
            failed += [done.outcome.failure] if done.outcome.failure else []
            print(f"tower {seed}: slot {done.slot + 1} {done.outcome.failure or 'laid'}", file=sys.stderr)
            if len(slots) == TASKS[TASK].max_steps:
                cause = "steps used up"
                break
    except BaggieError as error:
        cause, message = cause_of(error), str(error)
    stood = all_hold(scene.conditions, control.state())
    success = strict_success(scene.conditions, control)
    if not success and not cause:
        cause = "fell" if stood else "not as believed"
    off = [None if m is None else 100 * m for m in stacked.offsets_m(control.state())]
    print(f"tower {seed}: {'stands' if success else cause} {message}", file=sys.stderr)
    return {
        "success": success,
        "cause": "" if success else cause,
        "message": message,
        "offsets_cm": [[off[slot] for slot in layer] for layer in stacked.pattern.layers],
        "slots": slots,
        "failed": failed,
        "minutes": (time.perf_counter() - began) / 60,
    }


def cause_of(error: BaggieError) -> str:
    """What ended a tower, in the words of an evaluation."""
    if isinstance(error, UnsureError):
        return "unsure"
    return "out-of-reach" if isinstance(error, (LimitError, ReachError)) else "no-plan"


def summary(towers: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The row of a table of these towers."""
    by_layer = list(zip(*(each["offsets_cm"] for each in towers), strict=True))
    right = [np.mean([None not in layer for layer in of]) for of in by_layer]
    off = [[cm for cm in chain(*of) if cm is not None] for of in by_layer]
    causes = Counter(each["cause"] for each in towers if not each["success"])
    failed = Counter(chain(*(each["failed"] for each in towers)))
    return {
        "pattern": "tower-3",
        "success": rate(success_rate(sum(each["success"] for each in towers), len(towers))),
        "layers right": ", ".join(f"{100 * share:.0f}%" for share in right),
        "offset (cm)": ", ".join(f"{np.median(cm):.1f}" if cm else "none" for cm in off),
        "steps": float(np.mean([len(each["slots"]) for each in towers])),
        "failures": ", ".join(f"{n} {cause}" for cause, n in causes.items()),
        "failed steps": ", ".join(f"{n} {cause}" for cause, n in failed.items()),
        "minutes a tower": float(np.mean([each["minutes"] for each in towers])),
    }


if __name__ == "__main__":
    main(tyro.cli(Options))
