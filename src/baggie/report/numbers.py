"""The report's headline numbers, the table of all of them, and the labels that do not fit what others agree on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from baggie.data import Dataset, open_dataset
from baggie.errors import BaggieError, DataError
from baggie.evaluation.marked_pictures import TRUE, Mark, jpeg, marked
from baggie.evaluation.predictions import RecordedView
from baggie.report.figures import SERIES
from baggie.report.items import (
    Content,
    Evaluation,
    Results,
    Training,
    Validation,
    embedded,
    ms,
    percent,
    with_interval,
)
from baggie.types import Attempt, Goal, Image
from baggie.vision.draw import paint_goal

MAX_PICTURES = 20
"""Of one training, the worst: a page should stay small enough to be mailed."""


def labels(trainings: Sequence[Training]) -> list[Content]:
    """One entry for each training that compared its labels with each other."""
    return [_labels(training) for training in trainings if "labels_fused" in training.metrics]


def _labels(training: Training) -> Content:
    fused, data = training.metrics["labels_fused"], training.config["training"]["data"]
    doubtful, twice = fused["doubtful"], fused["pictures_with_two_opinions"]
    about = ["No picture was labelled twice."]
    if twice:
        about = [
            f"{twice} pictures were labelled twice, by the collector's eye and by the release before. "
            f"The two differ systematically, by {fused['systematic_mm']:.1f} mm; half of that was corrected."
        ]
    if not doubtful:
        about.append("No label is doubtful.")
    pictures = [""] * len(doubtful)
    if doubtful:
        try:
            pictures = _pictures(open_dataset(data), doubtful)
        except DataError:
            about.append(f"There are no pictures of the doubtful ones: their recording {data} is not there.")
    rows = [
        {"attempt": d["attempt_id"], "what": d["what"], "off": f"{d['off_mm']:.1f} mm", "picture": picture}
        for d, picture in zip(doubtful, pictures, strict=True)
    ]
    return {"policy": training.label, "about": " ".join(about), "rows": rows, "pictured": any(pictures)}


def _pictures(dataset: Dataset, doubtful: Sequence[dict[str, Any]]) -> list[str]:
    """As parts of the page; empty for what is not shown."""
    scene = RecordedView.of(dataset)
    index_of = {int(attempt_id): index for index, attempt_id in enumerate(dataset.attempt_ids)}
    shown = []
    for doubt in doubtful[:MAX_PICTURES]:
        try:
            picture = _picture(scene, dataset[index_of[doubt["attempt_id"]]], doubt["what"])
            shown.append(embedded(jpeg(picture), ".jpg"))
        except (KeyError, BaggieError):
            shown.append("")  # the recording is no longer what it was: its other pictures may still help
    return [*shown, *[""] * (len(doubtful) - len(shown))]


def _picture(scene: RecordedView, attempt: Attempt, what: str) -> Image:
    """The bag outlined as it was seen, and where the arm says it was: before for a pick, after for a place."""
    executed = attempt.outcome.executed
    if what == "pick":
        seen, box, pose = attempt.before, attempt.box_before, executed.pick
    else:
        seen, box, pose = attempt.after or attempt.before, attempt.box_after, executed.place
    inside = np.clip(box, 0, np.array(seen.size) - 1)  # a bag may reach out of the picture
    outlined = paint_goal(seen.color, Goal(inside, "outline", TRUE))
    if scene.to_robot is None:
        return scene.region.cut(outlined)
    by_arm = scene.to_robot.to_pixels([pose.xy])[0]
    return marked(outlined, scene.region, [Mark(what, by_arm, box.mean(axis=0))])


_COLUMNS = (
    "pick error",
    "place error",
    "success",
    "Ravens' success",
    "partial credit",
    "distance from the goal",
    "decision",
    "pick and place inside their radius",
)


def headline_tiles(results: Results, main: str) -> list[Content]:
    """Headline numbers of one policy, each beside those of the others."""
    tiles = []
    for what in ("pick", "place"):
        values = {v.label: v.metrics[v.reference][f"{what}_error_cm"] for v in results.validations}
        if main in values:
            own = values.pop(main)
            detail = f"median {own['median']:.2f}, worst {own['max']:.2f}"
            beside = [(name, f"{other['mean']:.2f} cm") for name, other in values.items()]
            tiles.append(_tile(f"{what} error, mean", f"{own['mean']:.2f}", "cm", detail, beside))
    return [*tiles, *_distance_tiles(results, main), *_credit_tiles(results, main)]


def _same_test(evaluations: Sequence[Evaluation], main: str) -> tuple[Evaluation | None, dict[str, Content]]:
    """The evaluation labelled `main`, and beside it the metrics of what was put to the same test, by label.

    The table of numbers has the rest.
    """
    own = next((each for each in evaluations if each.label == main), None)
    if own is None:
        return None, {}
    same = [each for each in evaluations if each.label != main and each.test == own.test]
    return own, {each.label: each.metrics for each in same}


def _distance_tiles(results: Results, main: str) -> list[Content]:
    evaluation, metrics = _same_test(results.landed, main)
    if evaluation is None:
        return []
    own = evaluation.metrics
    distance, others = own["distance_cm"], metrics.items()
    return [
        _success_tile(f"within {own['radius_cm']:g} cm of the goal", "success", own, metrics),
        _tile(
            "distance from the goal, median",
            f"{distance['median']:.2f}",
            "cm",
            f"mean {distance['mean']:.2f}, worst {distance['max']:.2f}",
            [(name, f"{other['distance_cm']['median']:.2f} cm") for name, other in others],
        ),
        *_decision_tile(own, metrics),
    ]


def _credit_tiles(results: Results, main: str) -> list[Content]:
    evaluation, metrics = _same_test(results.credited, main)
    if evaluation is None:
        return []
    own = evaluation.metrics
    done, others = own["partial_credit"], metrics.items()
    return [
        _success_tile(f"{evaluation.terms.task}, strictly done", "success", own, metrics),
        _success_tile("done as Ravens counts", "ravens_success", own, metrics),
        _tile(
            "partial credit, mean",
            f"{100 * done['mean']:.0f}",
            "%",
            f"median {100 * done['median']:.0f}%",
            [(name, f"{100 * other['partial_credit']['mean']:.0f}%") for name, other in others],
        ),
        *_decision_tile(own, metrics),
    ]


def _success_tile(what: str, key: str, own: Content, others: Mapping[str, Content]) -> Content:
    rate = own[key]
    return _tile(
        what,
        f"{100 * rate['rate']:.0f}",
        "%",
        f"95% between {100 * rate['low']:.0f} and {100 * rate['high']:.0f}%, n = {rate['n']}",
        [(name, percent(other[key])) for name, other in others.items()],
    )


def _decision_tile(own: Content, others: Mapping[str, Content]) -> list[Content]:
    """Empty where nothing was decided."""
    if not (decision := own.get("decision_ms")):
        return []
    beside = [(n, ms(o["decision_ms"]["median"])) for n, o in others.items() if "decision_ms" in o]
    median, p95 = f"{decision['median']:.0f}", f"95% under {decision['p95']:.0f} ms"
    return [_tile("time to decide, median", median, "ms", p95, beside)]


def _tile(what: str, value: str, unit: str, detail: str, beside: list[tuple[str, str]]) -> Content:
    return {"what": what, "value": value, "unit": unit, "detail": detail, "beside": beside}


def numbers(results: Results, policies: Sequence[str]) -> Content:
    """The table of all policies, a row each, without empty columns, and what to say about it."""
    cells: dict[str, dict[str, str]] = {policy: {} for policy in policies}
    for validation in results.validations:
        cells[validation.label] |= _of_validation(validation)
    for tried in results.evaluations:
        cells[tried.label] |= _of_evaluation(tried.metrics)
    rows: list[Content] = [
        {
            "name": policy,
            "series": number % len(SERIES) + 1,
            "kind": "" if number else "first",
            "cells": cells[policy],
        }
        for number, policy in enumerate(policies)
    ]
    columns = [column for column in _COLUMNS if any(row["cells"].get(column) for row in rows)]
    for row in rows:
        row["cells"] = [row["cells"].get(column, "") for column in columns]
    return {"columns": columns, "rows": rows, "numbers_about": _about(results, _COLUMNS[-1] in columns)}


def _of_validation(validation: Validation) -> dict[str, str]:
    metrics = validation.metrics
    errors, by_reference = metrics[validation.reference], metrics.get("confidence", {})
    stated = by_reference.get("labels", {}) | by_reference.get(validation.reference, {})
    inside = " and ".join(percent(rate) for key, rate in stated.items() if key.endswith("_within"))
    return {
        "pick error": f"{errors['pick_error_cm']['mean']:.2f} cm",
        "place error": f"{errors['place_error_cm']['mean']:.2f} cm",
        "decision": ms(metrics["decision_ms"]["median"]),
        _COLUMNS[-1]: inside,
    }


def _of_evaluation(metrics: Content) -> dict[str, str]:
    """What an evaluation's metrics have of these."""
    found = {"success": with_interval(metrics["success"])}
    if "ravens_success" in metrics:
        found["Ravens' success"] = with_interval(metrics["ravens_success"])
        found["partial credit"] = f"{100 * metrics['partial_credit']['mean']:.0f}%"
    if "distance_cm" in metrics:
        found["distance from the goal"] = f"{metrics['distance_cm']['mean']:.2f} cm"
    if "decision_ms" in metrics:
        found["decision"] = ms(metrics["decision_ms"]["median"])
    return found


def _about(results: Results, stated: bool) -> str:
    references = {v.reference for v in results.validations}
    against = "the simulator's truth" if references == {"truth"} else "recorded labels"
    about = [f"Errors are means over held-out attempts, against {against}."] if references else []
    if stated:
        about.append("A plan states radii; picks and places should be inside theirs nine times of ten.")
    if radii := sorted({e.metrics["radius_cm"] for e in results.landed}):
        within = " or ".join(f"{radius:g}" for radius in radii)
        about.append(f"With a goal in the picture, success is an object within {within} cm of it.")
    if results.credited:
        of_others = " of other tasks" if results.landed else ""
        about.append(f"Success{of_others} is strict; partial credit is a mean of what Ravens rewards.")
    if results.evaluations:
        about.append("Intervals are Wilson's, of 95%; decisions are medians.")
    return " ".join(about)
