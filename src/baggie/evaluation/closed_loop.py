"""`baggie evaluate`: look, plan, move, check, on scenes no policy has seen; how often it ends well."""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
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
from baggie.evaluation.episode import Bench, Episode, run_episode
from baggie.evaluation.log import append_line, read_lines
from baggie.evaluation.metrics import Rate, success_rate, summary
from baggie.evaluation.results import provenance, write_json
from baggie.evaluation.subjects import config_of, fingerprint, open_policy, policy_name
from baggie.policies import ColorMaskPolicy, OraclePolicy
from baggie.policies.color_mask import CONFIG_FILE
from baggie.processes import stream_in_processes
from baggie.seeds import EVALUATION
from baggie.vision.picture_files import read_picture
from baggie.workcell.watch import REFERENCE_FILE, Watch

TASKS = ("bag-place",)
RADII_CM = (1.0, 2.0, 3.0)


@dataclass(frozen=True)
class EvaluateOptions:
    """Run a policy in the closed loop on unseen scenes of the simulator, and measure where the bags end.

    Again with the same words it goes on where it stopped; with more episodes it adds to those it has.

    Example: baggie evaluate --policy runs/keypoint --episodes 100 --out runs/keypoint/evaluation
    """

    policy: str
    """A training run's folder, a Hub id, `color-mask`, or `oracle`, which reads the simulator's truth."""
    out: Path
    """Where metrics.json, episodes.jsonl, pictures and videos go."""
    task: str = "bag-place"
    """What to do. There is one: bag-place."""
    episodes: int = 100
    """How many scenes."""
    seed: int = 0
    """Names the scenes; no seed of `collect` ever gives one of them."""
    cell: int = 0
    """The workcell; a policy belongs to the one it was trained in."""
    radius_cm: float = 2.0
    """A bag this near the middle of its goal is a success."""
    retries: int = 2
    """How often to look again when the gripper noticed that it missed."""
    workers: int | None = None
    """Processes, each with a workcell of its own; as many as there are cores unless given."""
    film: int = 2
    """How many of the first episodes to make a video of."""
    calibration: Path | None = None
    """For `color-mask`: a recording of this cell, whose map to use; by default the cell is calibrated."""

    def check(self) -> None:
        """Raise `BaggieError` for what cannot be evaluated."""
        if self.task not in TASKS:
            raise BaggieError(f"expected a task among {', '.join(TASKS)}, got {self.task!r}")
        for name, least in (("episodes", 1), ("seed", 0), ("cell", 0), ("retries", 0), ("film", 0)):
            if getattr(self, name) < least:
                raise BaggieError(f"expected --{name} of at least {least}, got {getattr(self, name)}")
        if self.workers is not None and self.workers < 1:
            raise BaggieError(f"expected --workers of at least 1, got {self.workers}")
        if self.radius_cm <= 0:
            raise BaggieError(f"expected --radius-cm above 0, got {self.radius_cm}")


OpenBench = Callable[[EvaluateOptions], Bench]
"""Makes a cell and the policy in it; called once in each process, so it must be a function of a module."""


def open_simulated_bench(options: EvaluateOptions) -> Bench:
    """The simulated cell and the policy named; imported late, because MuJoCo takes its time."""
    from baggie.workcell.simulated import open_simulated  # noqa: PLC0415

    cell = open_simulated(options.cell)
    reference = _reference(options)
    cell.watch = Watch(read_picture(reference)) if reference else None
    if options.policy != OraclePolicy.name:
        return Bench(cell, open_policy(options.policy, options.calibration or options.out))
    bench = Bench(cell, OraclePolicy(cell.truth, lambda: bench.goal))
    return bench


def _reference(options: EvaluateOptions) -> Path | None:
    """What the camera saw when the policy's cell was calibrated, if that is known and it is this cell."""
    folder = Path(options.policy)
    if options.policy == ColorMaskPolicy.name:
        folder = (options.calibration or options.out) / CALIBRATION_FOLDER
    elif config_of(options.policy).get("cell", options.cell) != options.cell:
        return None
    return folder / REFERENCE_FILE if (folder / REFERENCE_FILE).exists() else None


def evaluate(options: EvaluateOptions, open_bench: OpenBench = open_simulated_bench) -> dict[str, Any]:
    """Run the episodes that are missing in `options.out`, write `metrics.json` there, and return it.

    The same options give the same episodes, whatever the number of workers and however often interrupted.

    Raises `BaggieError` for an unknown task or policy, or when `out` holds another evaluation;
    `KeyboardInterrupt`, with how to go on as its message, when stopped.
    """
    options.check()
    name = policy_name(options.policy)
    console = Console(stderr=True)
    _warn_of_another_cell(options, console)
    _same_evaluation(options)
    _calibrate_if_needed(options, console)
    log = options.out / "episodes.jsonl"
    episodes = {episode.episode: episode for episode in map(Episode.from_json, read_lines(log))}
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
        **measure([episodes[number] for number in range(options.episodes)], options.radius_cm),
        "provenance": provenance([options.seed]),
    }
    write_json(options.out / "metrics.json", metrics)
    return metrics


def measure(episodes: Sequence[Episode], radius_cm: float) -> dict[str, Any]:
    """`success` within `radius_cm`, `success_within` 1, 2, 3 cm, summaries of errors and times, failures.

    The cause of a failure is what the cell or the policy gave, else `off-goal`.
    """
    distances = [episode.distance_cm for episode in episodes]

    def within(radius: float) -> Rate:
        return success_rate(sum(distance <= radius for distance in distances), len(distances))

    failed = [episode for episode in episodes if episode.distance_cm > radius_cm]
    causes = Counter(episode.failure or "off-goal" for episode in failed)
    return {
        "success": within(radius_cm),
        "radius_cm": radius_cm,
        "success_within": {f"{radius:g}_cm": within(radius) for radius in RADII_CM},
        "distance_cm": summary(distances),
        "yaw_error_deg": summary([episode.yaw_error_deg for episode in episodes]),
        "decision_ms": summary([ms for episode in episodes for ms in episode.decision_ms]),
        "looks": summary([episode.looks for episode in episodes]),
        "failures": dict(causes.most_common()),
    }


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
            retries=options.retries,
            out=options.out / "episodes",
            film=number < options.film,
        )

    return run


def _warn_of_another_cell(options: EvaluateOptions, console: Console) -> None:
    trained_in = config_of(options.policy).get("cell", options.cell)
    if trained_in != options.cell:
        console.print(f"warning: {options.policy} belongs to cell {trained_in}, not to cell {options.cell}")


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


def _same_evaluation(options: EvaluateOptions) -> None:
    """Never mix two evaluations in one folder: the log belongs to one policy and one stream of scenes."""
    path = options.out / "evaluation.json"
    asked = {
        "policy": options.policy,
        "fingerprint": fingerprint(options.policy),
        "task": options.task,
        "seed": options.seed,
        "cell": options.cell,
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
