"""The experiments of the published system, in the simulator: one command each, and one report.

    python benchmarks/published.py curves
    python benchmarks/published.py virtual-goals
    python benchmarks/published.py printed-card
    python benchmarks/published.py color-mask
    python benchmarks/published.py report

Each goes on where it stopped and writes docs/results/published-NAME.{json,md}; `report` puts all on one page,
RUNS/report.html. They use the runs of benchmarks/policies.py and train what is missing.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import matplotlib as mpl
import numpy as np
import tyro

from commands import failures, rate, read, run, spread

if TYPE_CHECKING:
    from baggie.policies import Policy
    from baggie.types import Attempt

RESULTS = Path("docs/results")
CARD_SEEN = 5
"""Pictures of the card from which its colour is measured."""


@dataclass(frozen=True)
class Options:
    """Run one of the published experiments."""

    experiment: tyro.conf.Positional[
        Literal["curves", "virtual-goals", "printed-card", "color-mask", "report"]
    ]
    """`curves` of training and validation, 200/50, 10,000 steps of batch 1; `virtual-goals` drawn into the picture,
    without fine-tuning; a `printed-card` under other light, after re-annotating the recording with its measured colour,
    outlined and solid; the `color-mask` system with its 45 degree failures counted; `report`: all on one page.
    """
    recording: Path = Path("runs/recordings/cell-15")
    policies: Path = Path("runs/policies/cell-15")
    """Runs of `regression` and `keypoint` on it."""
    runs: Path = Path("runs/published")
    cell: int = 15
    episodes: int = 100
    seed: int = 0


def main(options: Options) -> None:
    """Run it and write its table."""
    experiments = {
        "curves": curves,
        "virtual-goals": virtual_goals,
        "printed-card": printed_card,
        "color-mask": color_mask,
        "report": report,
    }
    experiments[options.experiment](options)


def write(name: str, title: str, rows: list[dict[str, Any]], seeds: list[int], notes: str) -> None:
    """The table of one experiment."""
    from baggie.results import provenance, write_results  # noqa: PLC0415

    write_results(RESULTS / f"published-{name}", title, rows, provenance(seeds), notes)


# --- 1: curves
# ------------------------------------------------------------------------------------------------


def curves(options: Options) -> None:
    """Training and validation curves of the published pick and place networks, and of ours beside them."""
    mpl.use("Agg")
    from matplotlib import pyplot as plt  # noqa: PLC0415

    figure, axes = plt.subplots(1, 2, figsize=(10, 3.8), layout="constrained", sharey=True)
    rows = []
    for axis, policy in zip(axes, ("regression", "keypoint"), strict=True):
        folder = options.policies / policy
        run(
            f"train --policy {policy} --data {options.recording} --out {folder} --train 200 --val 50 --seed 0"
        )
        for what, color in (("pick", "#c0392b"), ("place", "#1e8449")):
            train, val = (scalars(folder, f"{part}/{what}_error_cm") for part in ("train", "val"))
            axis.plot(*smoothed(train), color=color, alpha=0.4, label=f"{what}, training")
            axis.plot(*zip(*val, strict=True), "o-", color=color, ms=3, label=f"{what}, validation")
            last = np.mean([value for _, value in train[-10:]])
            rows.append(
                {
                    "policy": policy,
                    "network": what,
                    "steps": train[-1][0],
                    "training error at the end (cm)": float(last),
                    "validation error at the end (cm)": val[-1][1],
                }
            )
        axis.set(title=policy, xlabel="step", yscale="log")
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("error against the labels (cm)")
    axes[1].legend()
    figure.savefig(RESULTS / "published-curves.png", dpi=130)
    notes = (
        "200 attempts to learn from, 50 to validate on, against the recorded poses. `regression` learns by the "
        "published recipe, one picture a step; `keypoint` by ours, eight a step, from pictures that are warped: its "
        "training errors are on harder pictures than its validation errors.\n\n![curves](published-curves.png)"
    )
    write("curves", "Training and validation curves", rows, [0], notes)


def scalars(folder: Path, name: str) -> list[tuple[int, float]]:
    """(step, value) from the TensorBoard events of a run."""
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator  # noqa: PLC0415

    events = EventAccumulator(str(folder))
    events.Reload()
    return [(event.step, event.value) for event in events.Scalars(name)]


def smoothed(points: list[tuple[int, float]], over: int = 9) -> tuple[list[int], list[float]]:
    """Medians of neighbours: batches of one picture scatter."""
    values = [value for _, value in points]
    middle = [float(np.median(values[max(0, i - over // 2) : i + over // 2 + 1])) for i in range(len(values))]
    return [step for step, _ in points], middle


# --- 2: virtual goals
# ------------------------------------------------------------------------------------------------


def virtual_goals(options: Options) -> None:
    """A bag at random, a green box drawn at random into the picture, pick and place executed."""
    rows = []
    for name, policy in subjects(options):
        # Square goals are what benchmarks/policies.py evaluates, too: one evaluation serves both.
        folders = {
            "virtual": options.policies / name / "evaluation",
            "turned": options.runs / f"{name}-turned",
        }
        for goal, out in folders.items():
            run(f"evaluate --policy {policy} --goal {goal} {closed_loop(options)} --out {out}")
            rows.append(closed_loop_row({"policy": name, "goal": goal}, out))
    notes = "Nothing was fine-tuned. `virtual` goals are square to the workspace, `turned` ones at any angle."
    write("virtual-goals", "Virtual goals", rows, [options.seed], notes)


def subjects(options: Options) -> Iterable[tuple[str, str]]:
    """Name and `--policy` of what is compared; the published regressor where it has been trained."""
    yield "keypoint", str(options.policies / "keypoint")
    yield "color-mask", "color-mask"
    if (options.policies / "regression" / "metrics.json").exists():
        yield "regression", str(options.policies / "regression")


def closed_loop(options: Options) -> str:
    """What all evaluations have in common."""
    return (
        f"--calibration {options.recording} --episodes {options.episodes} --seed {options.seed} "
        f"--cell {options.cell} --film 1"
    )


def closed_loop_row(row: dict[str, Any], out: Path) -> dict[str, Any]:
    """How an evaluation ended."""
    metrics = read(out)
    errors = {
        f"{what} error (cm)": spread(metrics[f"{what}_error_cm"])
        for what in ("pick", "place")
        if f"{what}_error_cm" in metrics
    }
    return {
        **row,
        "within 2 cm": rate(metrics["success"]),
        "median distance (cm)": round(metrics["distance_cm"]["median"], 2),
        "yaw off (deg, median)": round(metrics["yaw_error_deg"]["median"], 1),
        **errors,
        "failures": failures(metrics),
    }


# --- 3: the printed card
# ------------------------------------------------------------------------------------------------


def printed_card(options: Options) -> None:
    """A real green card under other light; its colour measured, the recording re-annotated with it."""
    red, green, blue = card_color(options)
    rows = []
    for style in ("solid", "outline"):
        folder = options.runs / f"painted-{style}"
        run(
            f"train --policy keypoint --goal-input painted --goal-style {style} --goal-color {red} {green} {blue} "
            f"--data {options.recording} --out {folder} --train 200 --val 50 --seed 0"
        )
    shown = {
        "keypoint, card found and given as a region": options.policies / "keypoint",
        "keypoint, trained on solid patches of the card's colour": options.runs / "painted-solid",
        "keypoint, trained on outlined boxes of it": options.runs / "painted-outline",
        "color-mask": "color-mask",
    }
    for name, policy in shown.items():
        out = options.runs / f"card-{name.replace(', ', '-').replace(' ', '-').replace(chr(39), '')}"
        run(f"evaluate --policy {policy} --goal card --scenery light {closed_loop(options)} --out {out}")
        rows.append(closed_loop_row({"policy": name}, out))
    notes = (
        "The card lies on the table under lamps, exposures and colour casts the cell does not have; nothing was "
        f"fine-tuned. Its colour as measured in {CARD_SEEN} pictures, RGB ({red}, {green}, {blue}), is what the "
        "recording was painted with anew. The painted policies see the card by themselves: nothing is drawn, and no "
        "region is given."
    )
    write("printed-card", "A printed card in another light", rows, [options.seed], notes)


def card_color(options: Options) -> tuple[int, int, int]:
    """The card's RGB colour as some pictures in the new light show it."""
    from baggie import seeds  # noqa: PLC0415
    from baggie.collect.machine import random_place  # noqa: PLC0415
    from baggie.vision.goal_card import find_card  # noqa: PLC0415
    from baggie.workcell.simulated import open_simulated  # noqa: PLC0415

    path = options.runs / "card-color.json"
    if path.exists():
        red, green, blue = json.loads(path.read_text())
        return red, green, blue
    cell = open_simulated(options.cell, scenery="light")
    colors = []
    for number in range(CARD_SEEN):
        cell.reset((seeds.CALIBRATION, options.seed, number))
        cell.lay_card(
            random_place(cell.settings.workspace, cell.truth(), seeds.generator(options.seed, number))
        )
        card = find_card(cell.look().color)
        if card is not None:
            colors.append(card.color)
    cell.close()
    red, green, blue = (int(value) for value in np.median(colors, axis=0))
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps([red, green, blue]))
    return red, green, blue


# --- 4: the colour mask
# ------------------------------------------------------------------------------------------------


def color_mask(options: Options) -> None:
    """The colour-mask system's angles: how often it takes a bag that lies otherwise for one at 45 degrees."""
    from baggie.collect.machine import FALSE_45_RAD  # noqa: PLC0415

    rows = []
    for name, readings in angle_readings(options).items():
        read, true = (np.array(column) for column in zip(*readings, strict=True))
        off = np.abs((read - true + math.pi / 4) % (math.pi / 2) - math.pi / 4)
        said_45 = np.abs(np.abs(read) - math.pi / 4) < FALSE_45_RAD
        was_45 = (
            np.abs(np.abs((true + math.pi / 4) % (math.pi / 2) - math.pi / 4) - math.pi / 4) < FALSE_45_RAD
        )
        rows.append(
            {
                "policy": name,
                "pictures": len(read),
                "read as 45 degrees": int(said_45.sum()),
                "of these false (more than 10 degrees off)": int((said_45 & (off > math.radians(10))).sum()),
                "truly at 45 degrees": int(was_45.sum()),
                "more than 10 degrees off": int((off > math.radians(10)).sum()),
                "median error (deg)": round(math.degrees(float(np.median(off))), 1),
            }
        )
    notes = (
        "Angles of the bag modulo a quarter turn, against the truth, in the pictures before the attempts of all "
        "recordings beside this one; `keypoint` only in those after the first 250 successful attempts of its own cell, "
        "which it did not learn from. The rectangle of least area around a dented bag may as well stand on its tip: "
        "the collector grips square when it reads 45 degrees, once."
    )
    write("color-mask", "The colour mask and its 45 degrees", rows, [options.seed], notes)


def angle_readings(options: Options) -> dict[str, list[tuple[float, float]]]:
    """(read, true) yaws by policy, of every cell with a recording."""
    import baggie  # noqa: PLC0415
    from baggie.data.files import CALIBRATION_FOLDER  # noqa: PLC0415
    from baggie.policies import ColorMaskPolicy  # noqa: PLC0415

    found: dict[str, list[tuple[float, float]]] = {"color-mask": [], "keypoint": []}
    for recording in sorted(options.recording.parent.glob("cell-*")):
        attempts = baggie.open_dataset(recording).successful()
        mask = ColorMaskPolicy.load(recording / CALIBRATION_FOLDER)
        found["color-mask"] += yaws(mask, attempts)
        keypoint = baggie.load_policy(options.policies.parent / recording.name / "keypoint")
        found["keypoint"] += yaws(keypoint, attempts[250:])
    return found


def yaws(policy: Policy, attempts: Sequence[Attempt]) -> list[tuple[float, float]]:
    """(read, true) of the bag before each attempt."""
    from baggie.data.summary import goal_of  # noqa: PLC0415

    return [
        (policy.plan(attempt.before, goal_of(attempt)).action.pick.yaw, attempt.truth.before.yaw)
        for attempt in attempts
        if attempt.truth is not None
    ]


# --- all of it on one page
# ------------------------------------------------------------------------------------------------


def report(options: Options) -> None:
    """One page with every run and evaluation of these experiments."""
    run(f"report {options.policies} {options.runs} --out {options.runs / 'report.html'}")


if __name__ == "__main__":
    main(tyro.cli(Options))
