"""Transporters taught by other demonstrators: ours in another style, and Ravens' own recordings.

    OMP_NUM_THREADS=1 python benchmarks/demonstrators.py simulator [TASK ...]
    OMP_NUM_THREADS=1 python benchmarks/demonstrators.py recordings [NAME ...] --imported FOLDER

`simulator`: tasks with blocks, shown in the style `varied`, the pyramid also in ours; three trainings with each number
of demonstrations, each from demonstrations of its own; 100 unseen scenes each. `recordings`: one whole training on each
imported recording in a folder, and of those with ten episodes that did their task ten more, each without one of them,
whose steps are then planned. Each job is a process; what is there is not done again. Writes
docs/results/demonstrators-NAME.{json,md}, one for each task or recording; what each training on a recording came to is
kept in docs/results/demonstrators-NAME.jsonl, so that a run of hours goes on where it was cut short.
"""

from __future__ import annotations

import contextlib
import json
import multiprocessing
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal, NamedTuple

import tyro

from commands import rate, read, run


class Taught(NamedTuple):
    """What a policy is taught, and what each training has to reach."""

    task: str
    style: str
    demonstrations: int
    asked: int
    """Of a hundred episodes."""

    def recording(self, runs: Path, seed: int) -> Path:
        """Where the demonstrations are."""
        return runs / f"{self.task}-{self.style}-{seed}"


TAUGHT = (
    Taught("block-pyramid", "varied", 1, 95),
    Taught("block-pyramid", "varied", 10, 100),
    Taught("block-insertion", "varied", 1, 90),
    Taught("block-insertion", "varied", 10, 99),
    Taught("place-red-in-green", "varied", 10, 99),
    Taught("align-box-corner", "varied", 10, 99),
    Taught("block-pyramid", "plain", 1, 100),
)
LEFT_OUT = 10
"""Episodes of a recording that did their task, of which each is left out once."""
IN_SIMULATOR = (
    "Each training has a seed and demonstrations of its own. Strict: every thing lies in a slot of its own when the "
    "episode ends, upright and so two seconds later; in brackets Wilson's 95% interval. Partial credit as Ravens "
    "counts. Asked is what each training has to reach. Scenes are the evaluation's own. The last checkpoint by rule. "
    "Times are the wall clock's, with other work beside."
)
ON_RECORDINGS = (
    "Whole: a training on all episodes that did their task, to its end. Left out: as many trainings as there are such "
    "episodes, each without one, whose steps that earned something are planned. A plan counts where it picks a thing "
    "that the rest of its stage still moves, and takes it within 1 cm and 15 degrees of a free slot of that stage, as "
    "the maps tell (docs/evaluating.md). Times are the wall clock's, with other work beside."
)


@dataclass(frozen=True)
class Options:
    """Train and judge what is missing."""

    what: tyro.conf.Positional[Literal["simulator", "recordings"]]
    only: tyro.conf.Positional[tuple[str, ...]] = ()
    """Tasks or recordings; all of them unless given."""
    imported: Path = Path("recordings/ravens")
    """Folder of imported recordings."""
    runs: Path = Path("runs/demonstrators")
    trainings: int = 3
    """With each number of demonstrations."""
    episodes: int = 100
    seed: int = 6
    """Of the test scenes: those of 0 and 5 were looked at while this was built."""
    jobs: int = 2
    """Processes at once."""
    results: Path = Path("docs/results")
    """Where the table goes."""


def main(options: Options) -> None:
    """Do what is missing and write the table."""
    (simulator if options.what == "simulator" else recordings)(options)


def simulator(options: Options) -> None:
    """In our simulator."""
    for task in options.only or dict.fromkeys(taught.task for taught in TAUGHT):
        lessons = [taught for taught in TAUGHT if taught.task == task]
        for style in {taught.style for taught in lessons}:
            most = max(taught.demonstrations for taught in lessons if taught.style == style)
            for seed in range(options.trainings):
                folder = Taught(task, style, most, 0).recording(options.runs, seed)
                collect = f"collect --task {task} --style {style} --seed {seed}"
                run(f"{collect} --attempts {most} --out {folder}")
        wanted = [(options, taught, seed) for taught in lessons for seed in range(options.trainings)]
        write(options, task, f"{task}, taught in other styles", all_of(options, judged, wanted), IN_SIMULATOR)


def judged(options: Options, taught: Taught, seed: int) -> dict[str, Any]:
    """One training, and how its episodes ended."""
    data = taught.recording(options.runs, seed)
    folder = data.with_name(f"{data.name}-of-{taught.demonstrations}")
    with logged(folder):
        learn = f"--train {taught.demonstrations} --val 0 --seed {seed} --device cpu"
        run(f"train --policy transporter --data {data} --out {folder} {learn}")
        scenes = (
            f"--task {taught.task} --episodes {options.episodes} --seed {options.seed} --film 0 --workers 1"
        )
        run(f"evaluate --policy {folder} {scenes} --out {folder / 'evaluation'}")
    metrics = read(folder / "evaluation")
    return {
        "task": taught.task,
        "style": taught.style,
        "demonstrations": taught.demonstrations,
        "training": seed,
        "strict": rate(metrics["success"]),
        "asked (%)": taught.asked,
        "partial credit": round(metrics["partial_credit"]["mean"], 3),
        "trained in (min)": round(read(folder)["train_s"] / 60, 1),
        "failed steps": ", ".join(f"{n} {cause}" for cause, n in metrics["failed_steps"].items()),
    }


def recordings(options: Options) -> None:
    """On what was recorded elsewhere."""
    from baggie import open_dataset  # noqa: PLC0415 -- workers import this file
    from baggie.data.summary import did_its_task  # noqa: PLC0415

    names = sorted(path.name for path in options.imported.iterdir() if (path / "meta").is_dir())
    for name in options.only or names:
        folder = options.imported / name
        dataset = open_dataset(folder)
        numbers, rewards = dataset.episodes, dataset.numbers()["reward"]
        episodes = [each for each in sorted(set(numbers.tolist())) if did_its_task(rewards[numbers == each])]
        left_out = [None, *(episodes if len(episodes) == LEFT_OUT else ())]
        kept = options.results / f"demonstrators-{name}.jsonl"
        known = {row["left out"] for row in lines(kept)}
        missing = [episode for episode in left_out if episode not in known]
        all_of(options, planned, [(options, folder, episode) for episode in missing], partial(keep, kept))
        rows = {row["left out"]: row | {"commit": row["commit"][:7]} for row in lines(kept)}
        table = [rows[None] | {"left out": "nothing"}]
        if left_out[1:]:
            table.append(summed([rows[episode] for episode in left_out[1:]]))
        write(options, name, f"Taught by Ravens' demonstrator: {name}", table, ON_RECORDINGS)


def lines(path: Path) -> list[dict[str, Any]]:
    """What each training on a recording came to, as far as it is known."""
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def keep(path: Path, row: dict[str, Any]) -> None:
    """Add what a training came to, and of which commit it is."""
    from baggie.results import provenance  # noqa: PLC0415 -- workers import this file

    origin = provenance()
    with path.open("a") as file:
        file.write(json.dumps(row | {"commit": origin["commit"], "date": origin["date"]}) + "\n")


def planned(options: Options, recording: Path, left_out: int | None) -> dict[str, Any]:
    """One training, without one episode or with all; and which of its plans for that episode count."""
    from baggie import open_dataset  # noqa: PLC0415 -- workers import this file
    from baggie.learning import TransporterTraining, train  # noqa: PLC0415

    attempts = list(open_dataset(recording))
    beside = [attempt for attempt in attempts if attempt.episode != left_out]
    folder = options.runs / f"{recording.name}-{'whole' if left_out is None else f'without-{left_out}'}"
    chosen = TransporterTraining(
        data=recording, out=folder, device="cpu",
        val=0 if left_out is None else 1,
    )  # fmt: skip
    with logged(folder):
        metrics = train(chosen, beside + [attempt for attempt in attempts if attempt.episode == left_out])
        row: dict[str, Any] = {
            "recording": recording.name,
            "left out": left_out,
            "trained in (min)": round(metrics["train_s"] / 60, 1),
        }
        if left_out is not None:
            run(f"validate --policy {folder} --data {recording} --out {folder / 'validation'}")
            found = read(folder / "validation")
            row |= found.get("would_count", {})  # nothing where the maps tell of none of its steps
    return row


def summed(parts: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """The trainings of one recording as one row."""
    from baggie.metrics import success_rate  # noqa: PLC0415 -- workers import this file

    row: dict[str, Any] = {"recording": parts[0]["recording"], "left out": f"each of {len(parts)}"}
    for name in ("pick", "place", "both"):
        told = [part[name] for part in parts if name in part]
        right = sum(round(each["rate"] * each["n"]) for each in told)
        if told:
            row[f"{name} counts"] = rate(success_rate(right, sum(each["n"] for each in told)))
    minutes = [part["trained in (min)"] for part in parts]
    row |= {"trained in (min)": round(sum(minutes) / len(minutes), 1)}
    return row | {"commit": ", ".join(sorted({part["commit"] for part in parts}))}


def all_of(
    options: Options,
    do: Callable[..., dict[str, Any]],
    jobs: Sequence[tuple[Any, ...]],
    keep: Callable[[dict[str, Any]], None] = lambda _row: None,
) -> list[dict[str, Any]]:
    """What each of the jobs found, in their order; it is kept as soon as it is known."""
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(options.jobs, context) as pool:
        futures = [pool.submit(do, *job) for job in jobs]
        for done, future in enumerate(as_completed(futures), 1):
            keep(future.result())
            print(f"{done} of {len(jobs)}: {future.result()}", file=sys.stderr, flush=True)
    return [future.result() for future in futures]


@contextlib.contextmanager
def logged(folder: Path) -> Iterator[None]:
    """What is printed meanwhile goes to a file beside a folder: there are several jobs and one terminal."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    with (
        folder.with_suffix(".log").open("a") as log,
        contextlib.redirect_stderr(log),
        contextlib.redirect_stdout(log),
    ):
        yield


def write(options: Options, name: str, title: str, rows: list[dict[str, Any]], notes: str) -> None:
    """The table."""
    from baggie.results import provenance, write_results  # noqa: PLC0415 -- workers import this file

    write_results(options.results / f"demonstrators-{name}", title, rows, provenance([options.seed]), notes)


if __name__ == "__main__":
    if os.environ.get("OMP_NUM_THREADS") != "1":
        sys.exit("expected OMP_NUM_THREADS=1, as jobs share the cores; set it")
    main(tyro.cli(Options))
