"""What the report says of the closed loop: how far from their goals objects ended, or how much of a task was done."""

from __future__ import annotations

import math
from collections.abc import Sequence

from baggie.evaluation.log import Episode
from baggie.report import figures
from baggie.report.items import (
    Content,
    Evaluation,
    data_uri,
    data_uris,
    figure,
    in_numbers,
    in_words,
    percent,
)

MAX_EPISODES = 3
"""Shown step by step: those with the least done."""
_ABOUT = (
    "Look, plan, move, until the task is done or its steps are used up; every scene is new. Strict success wants all "
    "as the task asks (a block upright and at its height in a slot of its own), still so two seconds later; Ravens' "
    "own success knows neither heights nor what falls later."
)


def task_section(evaluations: Sequence[Evaluation], main: str, colors: figures.Colors) -> Content | None:
    """Every variable of the section; None without an evaluation."""
    if not evaluations:
        return None
    first = next((e for e in evaluations if e.label == main), evaluations[0])
    rates = {e.label: [e.metrics["success"], e.metrics["ravens_success"]] for e in evaluations}
    worst = sorted(first.episodes, key=_credit)
    return {
        "main": first.label,
        "tasks": ", ".join(dict.fromkeys(e.terms.task for e in evaluations)),
        "policies": [e.label for e in evaluations],
        "about": _ABOUT,
        "figures": [
            figure(
                "Success",
                figures.success_bars(rates, ("strict", "Ravens"), colors),
                "Lines are 95% Wilson intervals.",
            ),
            figure(
                "Partial credit",
                figures.credit_histogram({e.label: _credits(e) for e in evaluations}, colors),
                "How much of the task Ravens counts as done at the end of an episode.",
            ),
        ],
        "layers": _layers(evaluations),
        "failures": _counts(evaluations, "failures"),
        "failed_steps": _counts(evaluations, "failed_steps"),
        "episodes": [_episode(first, episode) for episode in worst[:MAX_EPISODES]],
    }


def _credit(episode: Episode) -> tuple[bool, float]:
    return (episode.credit.success, episode.credit.partial_credit) if episode.credit else (False, 0.0)


def _credits(evaluation: Evaluation) -> list[float]:
    """Partial credit of every episode, in [0, 1] but for rounding."""
    return [credit.partial_credit for credit in evaluation.credits()]


def _counts(evaluations: Sequence[Evaluation], key: str) -> list[Content]:
    causes = dict.fromkeys(cause for e in evaluations for cause in e.metrics[key])
    return [{"cause": c, "counts": [e.metrics[key].get(c, 0) for e in evaluations]} for c in causes]


def _layers(evaluations: Sequence[Evaluation]) -> list[Content]:
    """How often each layer of stacked bags was right at the end, and how far its bags were off their slots."""
    of_all = [evaluation.metrics.get("layers", {}) for evaluation in evaluations]
    layers = dict.fromkeys(layer for layers in of_all for layer in layers)
    return [
        {"cause": layer, "counts": [_layer(of_one.get(layer)) for of_one in of_all]}
        for layer in sorted(layers, key=int)
    ]


def _layer(metrics: Content | None) -> str:
    if metrics is None:
        return ""
    off = metrics.get("offset_cm")
    return in_numbers(metrics["success"]) + (f", {off['median']:.1f} cm" if off else "")


def _episode(evaluation: Evaluation, episode: Episode) -> Content:
    """Start, every step with its heat maps, end; without the pictures that are not there."""
    captions = {"before": "start"}
    for number, step in enumerate(episode.steps):
        what = step.failure or f"{100 * (step.reward or 0.0):+.0f}%"
        captions[f"step-{number:02d}"] = f"step {number + 1}: {what}"
    captions["after"] = "end"
    pictures = [(evaluation.picture(episode.episode, kind), words) for kind, words in captions.items()]
    return {
        "number": episode.episode,
        "caption": in_words(episode),
        "pictures": [
            {"uri": data_uri(path), "caption": caption} for path, caption in pictures if path.exists()
        ],
    }


WORST = 10
MAX_VIDEOS = 2
_RAISED = {
    (True, True): "raised to the object's height with the cell's calibration",
    (False, False): "taken as seen, some millimetres lower than the object's outline",
    (False, True): "raised to the object's height where a calibration was at hand, else taken as seen",
}


def videos(evaluations: Sequence[Evaluation], main: str) -> list[Content]:
    """Two at most, of the policy the report is about where there are any."""
    found = [(e, path) for e in evaluations if e.label == main for path in e.videos()]
    found = found or [(e, path) for e in evaluations for path in e.videos()]
    shown = []
    for evaluation, path in found[:MAX_VIDEOS]:
        number = int(path.stem.split("-")[1])
        words = [f"{evaluation.label}, episode {number}", evaluation.ending(number)]
        caption = f"{': '.join(filter(None, words))} (at {evaluation.speed:g} times the real speed)"
        shown.append({"uri": data_uri(path), "caption": caption})
    return shown


def distance_section(evaluations: Sequence[Evaluation], main: str, colors: figures.Colors) -> Content | None:
    """Every variable of the section; None without an evaluation."""
    if not evaluations:
        return None
    first = next((e for e in evaluations if e.label == main), evaluations[0])
    radius = first.metrics["radius_cm"]
    about = [
        "Look, plan, move, check. Every scene is new, and the goal at least 20 cm from the object. The policy looks "
        "again only when the gripper noticed that it missed."
    ]
    causes = dict.fromkeys(cause for e in evaluations for cause in e.metrics["failures"])
    ended = {e.label: e.distances_cm() for e in evaluations}
    offsets = {e.label: e.offsets_cm() for e in evaluations}
    about += [
        f"{evaluation.label} was tried on a real arm ({evaluation.terms.workcell}), where each scene begins where the "
        "one before it ended, and things are where the camera sees them."
        for evaluation in evaluations
        if evaluation.terms.workcell is not None
    ]
    raised = {e.metrics["card_raised"] for e in evaluations if "card_raised" in e.metrics}
    if raised:
        about.append(f"A real card lies on the table; its corners were {_RAISED[min(raised), max(raised)]}.")
    worst = sorted(first.episodes, key=distance_cm, reverse=True)[:WORST]
    cases = []
    for episode in worst:
        paths = [first.picture(episode.episode, kind) for kind in ("before", "after")]
        trouble = f" · {episode.message or episode.failure}" if episode.failure else ""
        caption = f"{distance_cm(episode):.1f} cm from the goal{trouble}"
        cases.append({"number": episode.episode, "pictures": data_uris(paths), "caption": caption})
    failures = [
        {"cause": c, "counts": [e.metrics["failures"].get(c, 0) for e in evaluations]} for c in causes
    ]
    totals = [f"{sum(e.metrics['failures'].values())} of {len(e.episodes)}" for e in evaluations]
    return {
        "main": first.label,
        "policies": list(ended),
        "about": " ".join(about),
        "figures": [
            figure(
                "How near the goal",
                figures.success_curves(ended, colors, radius),
                "Shaded: 95% Wilson intervals. Dashed: what counts as success.",
            ),
            figure(
                "Where things came to lie",
                figures.landings(offsets, colors, radius),
                "Around their goals, seen from above; the robot looks up the page.",
            ),
        ],
        "plans": _plans(evaluations),
        "known_by": _known_by({e.terms.workcell is None for e in evaluations}),
        "failures": [*failures, {"cause": "all", "counts": totals}],
        "cases": cases,
    }


def distance_cm(episode: Episode) -> float:
    """How far from its goal an episode's object ended; infinitely far where there is no goal in the picture."""
    return math.inf if episode.landing is None else episode.landing.distance_cm


def _known_by(simulated: set[bool]) -> str:
    """Who says where things are: a simulator, the cameras of real workcells, or, each in its own, both."""
    names = {True: "the truth", False: "what the camera saw"}
    return " or ".join(names[kind] for kind in sorted(simulated, reverse=True))


def _plans(evaluations: Sequence[Evaluation]) -> Content:
    """How good plans were and how true to the radii they state, a row for each evaluation; no empty columns."""
    columns = ["pick error", "place error", "picks inside radius", "places inside radius", "asked for help"]
    rows = []
    for evaluation in evaluations:
        metrics = evaluation.metrics
        stated, helped = metrics.get("confidence", {}), metrics["asked_for_help"]
        errors = [metrics.get(f"{what}_error_cm") for what in ("pick", "place")]
        rates = [stated.get(f"{what}_within") for what in ("pick", "place")]
        cells = [
            *(f"{error['mean']:.2f} cm" if error else "" for error in errors),
            *(f"{percent(rate)} of {rate['n']}" if rate else "" for rate in rates),
            f"{round(helped['rate'] * helped['n'])} of {helped['n']}" if helped["rate"] else "",
        ]
        rows.append({"name": evaluation.label, "cells": cells})
    filled = [column for column in range(len(columns)) if any(row["cells"][column] for row in rows)]
    rows = [{**row, "cells": [row["cells"][column] for column in filled]} for row in rows]
    return {"columns": [columns[column] for column in filled], "rows": rows}
