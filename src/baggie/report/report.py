"""`baggie report`: one page, complete in itself, that shows how good a policy is and how it was measured."""

from __future__ import annotations

import json
import re
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from itertools import cycle
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
from baggie.report import figures
from baggie.report.evaluations import WORST, distance_cm, distance_section, task_section, videos
from baggie.report.figures import SERIES
from baggie.report.items import (
    BASELINES,
    Content,
    Evaluation,
    Reported,
    Results,
    Series,
    Training,
    Validation,
    data_uri,
    data_uris,
    duration,
    figure,
    in_numbers,
    percent,
)
from baggie.report.numbers import headline_tiles, labels, numbers
from baggie.results import origin_lines, provenance

_EVENTS = re.compile(r"events\.out\.tfevents\.\d+\..+\.\d+\.\d+")
"""What TensorBoard's writer calls its files: time, machine, process and count."""
GOALS_TITLE, TASKS_TITLE = "Things onto goals", "Things into place"
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


def content(results: Results) -> Content:
    """Every variable of `report.html.j2`."""
    policies = results.labels()
    colors = dict(zip(policies, cycle(SERIES), strict=False))
    main = policies[0]
    sections = {
        "videos": videos(results.evaluations, main),
        "closed_loop": distance_section(results.landed, main, colors),
        "tasks": task_section(results.credited, main, colors),
        "validation": _validation_section(results.validations, main, colors),
        "heat": _heat(results, main),
        "learning": _learning(results.trainings),
        "labels": labels(results.trainings),
    }
    names = {
        "videos": ("video", "Video"),
        "numbers": ("numbers", "Numbers"),
        "closed_loop": ("closed-loop", "Closed loop"),
        "tasks": ("tasks", "Step by step"),
        "validation": ("validation", "Held-out attempts"),
        "heat": ("heat", "Heat maps"),
        "learning": ("learning", "Learning"),
        "labels": ("labels", "Labels"),
        "origin": ("origin", "How it was made"),
    }
    return {
        **sections,
        **numbers(results, policies),
        "tiles": headline_tiles(results, main),
        "title": GOALS_TITLE if results.with_goals or not results.credited else TASKS_TITLE,
        "lead": _lead(results, main),
        "contents": [name for key, name in names.items() if sections.get(key, True)],
        "origins": _origins(results),
        "date": datetime.now(UTC).strftime("%-d %B %Y"),
    }


def _lead(results: Results, main: str) -> str:
    said = []
    for training in results.trainings:
        if training.label == main and "train_s" in training.metrics:
            said.append(f"{main} was trained in {duration(training.metrics['train_s'])}.")
    for evaluation in results.landed:
        if evaluation.label == main:
            done, radius = in_numbers(evaluation.metrics["success"]), evaluation.metrics["radius_cm"]
            who = "It" if said else main
            said.append(f"{who} moved {done} things to within {radius:g} cm of goals new to it.")
    for tried in results.credited:
        if tried.label == main:
            who = "It" if said else main
            said.append(
                f"{who} did {tried.terms.task} in {in_numbers(tried.metrics['success'])} scenes new to it."
            )
    return " ".join(said) or f"Results of {main}."


def _validation_section(
    validations: Sequence[Validation], main: str, colors: figures.Colors
) -> Content | None:
    if not validations:
        return None
    first = next((v for v in validations if v.label == main), validations[0])
    of = "true" if first.reference == "truth" else "recorded"
    vectors = []
    for what in ("pick", "place"):
        true, predicted = first.positions(what)
        # Errors are millimetres in half a metre of workspace: magnify the larger ones to about 5 cm.
        large = float(np.percentile(np.linalg.norm(predicted - true, axis=1), 90))
        magnify = float(np.clip(round(0.05 / max(large, 1e-4)), 1, 50))
        svg = figures.error_vectors(true, predicted, colors[first.label], magnify)
        note = f"From each {of} place (dot) towards the predicted one; arrows are {magnify:g} times too long."
        vectors.append(figure(f"{what.capitalize()} errors over the workspace, {first.label}", svg, note))
    spread = [
        figure(
            f"{what.capitalize()} errors",
            figures.error_distribution({v.label: v.errors_cm(what) for v in validations}, colors),
            "How many attempts have at most this error.",
        )
        for what in ("pick", "place")
    ]
    cases = []
    for item in first.worst[:WORST]:
        uris = data_uris([first.folder / item["picture"]])
        errors = item["errors"].get(first.reference)
        caption = "no plan"
        if errors:
            caption = (
                f"pick off by {errors['pick_error_cm']:.2f} cm, place by {errors['place_error_cm']:.2f} cm"
            )
        cases.append({"number": item["attempt_id"], "picture": uris[0] if uris else "", "caption": caption})
    held_out = first.metrics["held_out"]
    truth = "the simulator's truth" if first.reference == "truth" else "the recorded poses"
    about = f"{held_out['attempts']} attempts, {held_out['which']}; errors against {truth}."
    if counted := first.metrics.get("would_count"):
        picks, places = (percent(counted[what]) for what in ("pick", "place"))
        about += (
            " These are what the demonstrator chose, where other things and slots may be as right: "
            f"{picks} of the picks and {places} of the places would count, within 1 cm and 15 degrees of any of them."
        )
    return {
        "main": first.label,
        "about": about,
        "figures": [*vectors, *spread],
        "cases": cases,
    }


def _heat(results: Results, main: str) -> list[Content]:
    items = []
    for validation in results.validations:
        if validation.label == main:
            for item in validation.worst[:6]:
                if "heat" in item:
                    path = validation.folder / item["heat"]
                    items.append((path, f"attempt {item['attempt_id']}"))
    for evaluation in results.landed:
        if evaluation.label == main:
            worst = sorted(evaluation.episodes, key=distance_cm, reverse=True)[:6]
            items += [(evaluation.picture(e.episode, "heat"), f"episode {e.episode}") for e in worst]
    return [{"uri": data_uri(path), "caption": caption} for path, caption in items if path.exists()]


_CURVES = {"_cm": "errors (cm)", "_deg": "yaw errors (degrees)", "": "loss and its parts"}
"""Training curves that share a chart, by the unit their tags end in."""
_CURVES_ARE = (
    "train: each batch as it was learned from, its pictures mostly changed on purpose, so it is rough and may "
    "stay above; val: attempts that were held out, as they were recorded."
)


def _learning(trainings: Sequence[Training]) -> Content | None:
    charts = []
    for training in trainings:
        groups: dict[str, dict[str, Series]] = {}
        for tag, series in training.scalars.items():
            unit = next(unit for unit in _CURVES if tag.endswith(unit))
            name = tag.removesuffix(unit).removesuffix("_error").replace("/", " ").replace("_", " ")
            groups.setdefault(unit, {})[name] = series
        for unit, title in _CURVES.items():
            if unit in groups:
                charts.append(figure(f"{training.label}: {title}", figures.curves(groups[unit]), ""))
    if not charts:
        return None
    times = [f"{t.label} in {duration(t.metrics['train_s'])}" for t in trainings if "train_s" in t.metrics]
    about = f"Trained {', '.join(times)}." if times else "Curves by step."
    return {"about": f"{about} {_CURVES_ARE}", "figures": charts}


def _origins(results: Results) -> list[Content]:
    origins = []
    kinds = {Training: "Training", Validation: "Validation", Evaluation: "Closed loop"}
    for item in results.items():
        if origin := item.metrics.get("provenance"):
            origins.append({"name": f"{kinds[type(item)]}, {item.label}", "lines": origin_lines(origin)})
    return [*origins, {"name": "This page", "lines": origin_lines(provenance())}]
