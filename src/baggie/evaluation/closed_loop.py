"""`baggie evaluate`: look, plan, move, check, on scenes no policy has seen; how often it ends well."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import torch
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from baggie.collect.calibrate import calibrate_into
from baggie.data.layout import CALIBRATION_FOLDER
from baggie.errors import BaggieError
from baggie.evaluation.bench import Bench
from baggie.evaluation.card_map import card_map
from baggie.evaluation.closed_loop_metrics import measure
from baggie.evaluation.episode import Episode, read_episodes, run_episode
from baggie.evaluation.log import append_line
from baggie.evaluation.options import EvaluateOptions
from baggie.evaluation.results import provenance, write_json
from baggie.evaluation.subjects import config_of, fingerprint, in_its_cell, policy_name
from baggie.policies import ColorMaskPolicy
from baggie.policies.color_mask import CONFIG_FILE
from baggie.processes import stream_in_processes
from baggie.seeds import EVALUATION

__all__ = ["EvaluateOptions", "OpenBench", "evaluate", "open_simulated_bench"]

OpenBench = Callable[[EvaluateOptions], Bench]
"""Makes a cell and the policy in it; called once in each process, so it must be a function of a module."""


def open_simulated_bench(options: EvaluateOptions) -> Bench:
    """The simulated cell and the policy named; imported late, because MuJoCo takes its time."""
    from baggie.evaluation.simulated_bench import open_bench  # noqa: PLC0415

    return open_bench(options)


def evaluate(options: EvaluateOptions, open_bench: OpenBench = open_simulated_bench) -> dict[str, Any]:
    """Run the episodes that are missing in `options.out`, write `metrics.json` there, and return it.

    The same options give the same episodes, whatever the number of workers and however often interrupted.

    Raises `BaggieError` for an unknown task, scenery, goal or policy, or when `out` holds another evaluation;
    `KeyboardInterrupt`, with how to go on as its message, when stopped.
    """
    options.check()
    name = policy_name(options.policy)
    console = Console(stderr=True)
    _warn_of_another_cell(options, console)
    raised = _card_raised(options, console)
    _same_evaluation(options, raised)
    if open_bench is open_simulated_bench:
        _calibrate_if_needed(options, console)
    log = options.out / "episodes.jsonl"
    episodes = {episode.episode: episode for episode in read_episodes(log)}
    missing = [number for number in range(options.episodes) if number not in episodes]
    try:
        for episode in _run(options, open_bench, missing, console):
            append_line(log, episode.to_json())
            episodes[episode.episode] = episode
    except KeyboardInterrupt:
        done = f"{len(episodes)} of {options.episodes} episodes are done"
        raise KeyboardInterrupt(f"interrupted: {done}; the same command again goes on from there") from None
    metrics = {
        "policy": name,
        "run": Path(options.policy).name,
        "task": options.task,
        "cell": options.cell,
        "scenery": options.scenery,
        "goal": options.goal,
        **({"card_raised": raised} if options.goal == "card" else {}),
        **measure([episodes[number] for number in range(options.episodes)], options.radius_cm),
        "provenance": provenance([options.seed]),
    }
    write_json(options.out / "metrics.json", metrics)
    return metrics


def _run(
    options: EvaluateOptions, open_bench: OpenBench, missing: Sequence[int], console: Console
) -> Iterator[Episode]:
    columns = (BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[note]}"), TimeRemainingColumn())
    with Progress(TextColumn("evaluating"), *columns, console=console) as progress:
        done = options.episodes - len(missing)
        bar = progress.add_task("", total=options.episodes, completed=done, note="")
        worker = partial(_open_worker, options, open_bench)
        for episode in stream_in_processes(worker, missing, options.workers or os.cpu_count() or 1):
            yield episode
            progress.update(bar, advance=1, note=f"last {episode.distance_cm:.1f} cm from its goal")


def _open_worker(options: EvaluateOptions, open_bench: OpenBench) -> Callable[[int], Iterable[Episode]]:
    # Sums in another order would give other plans: results must not depend on how many work beside.
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    bench = open_bench(options)

    def run(number: int) -> Iterable[Episode]:
        yield run_episode(
            bench,
            number,
            (EVALUATION, options.seed),
            goal_kind=options.goal,
            retries=options.retries,
            out=options.out / "episodes",
            film=number < options.film,
        )

    return run


def _warn_of_another_cell(options: EvaluateOptions, console: Console) -> None:
    if not in_its_cell(options.policy, options.cell):
        trained_in = config_of(options.policy)["cell"]
        console.print(f"warning: {options.policy} belongs to cell {trained_in}, not to cell {options.cell}")


def _card_raised(options: EvaluateOptions, console: Console) -> bool:
    """Whether a map of the cell is, or will be, known that raises a card's corners to the bag's height."""
    if options.goal != "card":
        return False
    will_be = options.policy == ColorMaskPolicy.name and options.calibration is None
    if will_be or card_map(options) is not None:
        return True
    console.print(
        "warning: no calibration of this cell tells how much lower a card lies than a bag's middle; its corners are "
        "taken as seen, some millimetres off at the picture's edge; give --calibration a recording of the cell"
    )
    return False


def _calibrate_if_needed(options: EvaluateOptions, console: Console) -> None:
    """Calibrate the cell for `color-mask`, once for all processes, unless a calibration is given."""
    folder = options.out / CALIBRATION_FOLDER
    if options.policy != ColorMaskPolicy.name or options.calibration or (folder / CONFIG_FILE).exists():
        return
    from baggie.workcell.simulated import open_simulated  # noqa: PLC0415

    with (
        console.status("calibrating the picture to the robot"),
        closing(open_simulated(options.cell)) as cell,
    ):
        calibrate_into(folder, cell, options.seed)


def _same_evaluation(options: EvaluateOptions, raised: bool) -> None:
    """Never mix two evaluations in one folder: the log belongs to one policy and one stream of scenes."""
    path = options.out / "evaluation.json"
    asked = {
        "policy": options.policy,
        "fingerprint": fingerprint(options.policy),
        "task": options.task,
        "seed": options.seed,
        "cell": options.cell,
        "scenery": options.scenery,
        "goal": options.goal,
        "card_raised": raised,
        "retries": options.retries,
    }
    if not path.exists():
        write_json(path, asked)
        return
    found = json.loads(path.read_text())
    for key, value in asked.items():
        if found.get(key) != value:
            raise BaggieError(
                f"{options.out} holds an evaluation with {key} {found.get(key)}, not {value}; "
                "give another --out, or remove it to start again"
            )
