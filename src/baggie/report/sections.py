"""What the report says, section by section, as plain values for the template."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from itertools import cycle

import numpy as np

from baggie.report import figures
from baggie.report.evaluations import WORST, distance_cm, distance_section, task_section, videos
from baggie.report.figures import SERIES
from baggie.report.items import (
    Content,
    Evaluation,
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

GOALS_TITLE, TASKS_TITLE = "Things onto goals", "Things into place"


def content(results: Results) -> Content:
    """Every variable of `report.html.j2`."""
    policies = results.labels()
    colors = dict(zip(policies, cycle(SERIES), strict=False))
    main = policies[0]
    sections = {
        "videos": videos(results.evaluations, main),
        "closed_loop": distance_section(results.landed, main, colors),
        "tasks": task_section(results.credited, main, colors),
        "validation": _validation(results.validations, main, colors),
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


def _validation(validations: Sequence[Validation], main: str, colors: figures.Colors) -> Content | None:
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
