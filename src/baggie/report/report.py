"""`baggie report`: one page, complete in itself, that shows how good a policy is and how it was measured."""

from __future__ import annotations

import json
import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from baggie.errors import BaggieError, DataError
from baggie.evaluation.log import read_episodes
from baggie.evaluation.terms import Terms
from baggie.files import only_ours, read_yaml, write_text
from baggie.options.evaluating import EvaluateOptions, ReportOptions
from baggie.options.values import USUAL_TASK
from baggie.report.items import BASELINES, Evaluation, Reported, Results, Series, Training, Validation
from baggie.report.sections import content

_EVENTS = re.compile(r"events\.out\.tfevents\.\d+\..+\.\d+\.\d+")
"""What TensorBoard's writer calls its files: time, machine, process and count."""
Found = TypeVar("Found", Training, Validation, Evaluation)
Value = TypeVar("Value")


def gather(folders: Sequence[Path]) -> Results:
    """Read the results in these folders and below them.

    Raises `BaggieError` when a folder is missing or holds none, or when two runs go by one name; `DataError` when a
    file of theirs is broken.
    """
    for folder in folders:
        if not folder.is_dir():
            raise BaggieError(
                f"expected a folder of results, {folder} is none; run train, validate or evaluate first"
            )
    trainings = _read(folders, "config.yaml", _training)
    validations = _read(folders, "predictions.json", _validation)
    evaluations = _read(folders, "*episodes.jsonl", _evaluation)
    _check_told_apart(trainings)
    _check_told_apart(validations)
    found = Results(trainings, validations, evaluations)
    if not found.items():
        names = ", ".join(map(str, folders))
        raise BaggieError(
            f"found nothing to report in {names}; expected folders that train, validate or evaluate wrote"
        )
    return labelled(found)


def labelled(results: Results) -> Results:
    """The same results, each with a label that tells it from what else is on the page.

    A policy is as many rows as it has runs, and as there are terms it was tried on and radii that count. Its first
    workcell, a simulated one where there is one, goes without saying, as do the usual task and radius, and those that
    are the only ones on the page.
    """
    runs = {(item.policy, item.run) for item in results.items()}
    several = {policy for policy, count in Counter(policy for policy, _ in runs).items() if count > 1}
    said_tasks = _said((each.terms.task for each in results.evaluations), USUAL_TASK)
    said_radii = _said((each.radius_cm for each in results.landed), EvaluateOptions.radius_cm)
    tried_on: dict[tuple[str, str], set[str]] = defaultdict(set)
    for each in results.evaluations:
        tried_on[each.policy, each.run].add(each.terms.task)

    def named(item: Reported, tasks: set[str]) -> str:
        """The policy, with its run where there are several, and the task where it is about one that has to be said."""
        run = f"{item.policy} ({item.run})" if item.policy in several else item.policy
        return ", ".join([run, *(tasks & said_tasks)]) if len(tasks) == 1 else run

    def of_runs(items: Sequence[Found]) -> list[Found]:
        return [replace(item, label=named(item, tried_on[item.policy, item.run])) for item in items]

    first: dict[str, str] = {}
    evaluations = []
    for each in sorted(results.evaluations, key=lambda each: each.terms.workcell is not None):
        within = f"within {each.radius_cm:g} cm" if each.radius_cm in said_radii else ""
        label = ", ".join(filter(None, [named(each, {each.terms.task}), each.terms.harder, within]))
        place = first.setdefault(label, each.terms.place)
        label = label if each.terms.place == place else f"{label}, {each.terms.place}"
        evaluations.append(replace(each, label=label))
    return Results(of_runs(results.trainings), of_runs(results.validations), evaluations)


def _said(values: Iterable[Value], usual: Value) -> set[Value]:
    """Those that a label has to say: all but the usual one, where there are several."""
    found = set(values)
    return found - {usual} if len(found) > 1 else set()


def _check_told_apart(items: Sequence[Training | Validation]) -> None:
    """What was trained and what was tested are put together by policy and run: each may be there once."""
    seen: dict[tuple[str, str], Path] = {}
    for item in items:
        other = seen.setdefault((item.policy, item.run), item.folder)
        if other != item.folder:
            raise BaggieError(
                f"expected every run of {item.policy} to have a name of its own, {other} and {item.folder} are both of "
                f"a run called {item.run}; report one of them, or rename its folder before it is tested"
            )


def _read(folders: Sequence[Path], marker: str, read: Callable[[Path], Found | None]) -> list[Found]:
    places = sorted({path.parent for folder in folders for path in folder.resolve().rglob(marker)})
    found = []
    for place in places:
        try:
            item = read(place)
        except (OSError, DataError, ValueError, KeyError, TypeError) as error:
            raise DataError(f"cannot read the results in {place}: {error!r}; make them again") from error
        if item is not None:
            found.append(item)
    return sorted(found, key=lambda item: (item.policy in BASELINES, item.policy, item.run))


def _training(folder: Path) -> Training | None:
    if (metrics := _finished(folder)) is None:  # or somebody else's config.yaml
        return None
    config = read_yaml(folder / "config.yaml")
    policy = str(config["policy"])
    return Training(folder, policy, folder.name, metrics, policy, config, _scalars(folder))


def _scalars(folder: Path) -> dict[str, Series]:
    """What a training logged, by tag. One that went on logs again what came after its last save: that counts."""
    points: dict[str, dict[int, float]] = {}
    events = folder.glob("*tfevents*")
    for path in sorted(only_ours(folder, events, lambda path: bool(_EVENTS.fullmatch(path.name)))):
        logged = EventAccumulator(str(path), size_guidance={"scalars": 0}).Reload()
        for tag in logged.Tags()["scalars"]:
            later = {point.step: point.value for point in logged.Scalars(tag)}
            earlier = points.get(tag, {})
            points[tag] = {step: earlier[step] for step in earlier if step < min(later)} | later
    return {
        tag: (np.array(list(values), float), np.array(list(values.values()), float))
        for tag, values in points.items()
    }


def _validation(folder: Path) -> Validation:
    content, metrics = _json(folder / "predictions.json"), _json(folder / "metrics.json")
    policy, run = metrics["policy"], metrics["run"]
    return Validation(folder, policy, run, metrics, policy, content["predictions"], content["worst"])


def _evaluation(folder: Path) -> Evaluation | None:
    metrics = _finished(folder)
    if metrics is None:
        return None
    logged = read_episodes(folder)
    # More may be logged by now than the metrics are of.
    episodes = [logged[number] for number in sorted(logged) if number < metrics["success"]["n"]]
    policy, run = metrics["policy"], metrics["run"]
    return Evaluation(folder, policy, run, metrics, policy, Terms.from_metrics(metrics), episodes)


def _finished(folder: Path) -> dict[str, Any] | None:
    """The metrics; None while it is still running."""
    path = folder / "metrics.json"
    return _json(path) if path.exists() else None


def _json(path: Path) -> Any:
    return json.loads(path.read_text())


def report(options: ReportOptions) -> Path:
    """Write the page and return its path.

    Raises `BaggieError` when the folders hold no results, `DataError` when results are broken.
    """
    loader = PackageLoader("baggie.report", ".")
    page = Environment(loader=loader, autoescape=True, undefined=StrictUndefined).get_template(
        "report.html.j2"
    )
    variables = content(gather(options.runs))
    if options.title is not None:
        variables["title"] = options.title
    write_text(options.out, page.render(variables))
    return options.out
