"""What the report says, section by section, as plain values for the template."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from datetime import UTC, datetime
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np

from baggie.evaluation import report_figures as figures
from baggie.evaluation.report_data import Evaluation, Results, Series, Training, Validation
from baggie.evaluation.results import origin_lines, provenance

WORST = 10
MAX_VIDEOS = 2
PUBLISHED = ("as published, real arm", ("7.80 cm", "5.80 cm", "", "", ""))
"""Pick and place error of the published system (ResNet-18, 200 training images), for comparison."""

_MIME = {".jpg": "image/jpeg", ".png": "image/png", ".mp4": "video/mp4"}
Content = dict[str, Any]


def content(results: Results) -> Content:
    """Every variable of `report.html.j2` but the title."""
    policies = results.policies()
    colors = dict(zip(policies, cycle(figures.SERIES), strict=False))
    main = policies[0]
    sections = {
        "videos": _videos(results.evaluations, main),
        "closed_loop": _closed_loop(results.evaluations, main, colors),
        "validation": _validation(results.validations, main, colors),
        "heat": _heat(results, main),
        "learning": _learning(results.trainings),
    }
    names = {
        "videos": ("video", "Video"),
        "numbers": ("numbers", "Numbers"),
        "closed_loop": ("closed-loop", "Closed loop"),
        "validation": ("validation", "Held-out attempts"),
        "heat": ("heat", "Heat maps"),
        "learning": ("learning", "Learning"),
        "origin": ("origin", "How it was made"),
    }
    return {
        **sections,
        **_numbers(results, policies),
        "tiles": _tiles(results, main),
        "lead": _lead(results, main),
        "contents": [name for key, name in names.items() if sections.get(key, True)],
        "origins": _origins(results),
        "date": datetime.now(UTC).strftime("%-d %B %Y"),
    }


def _lead(results: Results, main: str) -> str:
    said = []
    for training in results.trainings:
        if training.policy == main and "train_s" in training.metrics:
            said.append(f"{main} was trained in {_duration(training.metrics['train_s'])}.")
    for evaluation in results.evaluations:
        if evaluation.policy == main:
            rate = evaluation.metrics["success"]
            done = round(rate["rate"] * rate["n"])
            radius = evaluation.metrics["radius_cm"]
            who = "It" if said else main
            said.append(f"{who} moved {done} of {rate['n']} bags to within {radius:g} cm of goals new to it.")
    return " ".join(said) or f"Results of {main}."


def _tiles(results: Results, main: str) -> list[Content]:
    """Headline numbers of one policy, each beside those of the others."""
    tiles = []
    for what in ("pick", "place"):
        values = {v.policy: v.metrics[v.reference][f"{what}_error_cm"] for v in results.validations}
        if main in values:
            own = values.pop(main)
            detail = f"median {own['median']:.2f}, worst {own['max']:.2f}"
            beside = [(name, f"{other['mean']:.2f} cm") for name, other in values.items()]
            tiles.append(_tile(f"{what} error, mean", f"{own['mean']:.2f}", "cm", detail, beside))
    metrics = {e.policy: e.metrics for e in results.evaluations}
    if main in metrics:
        own = metrics.pop(main)
        rate, distance, decision = own["success"], own["distance_cm"], own["decision_ms"]
        others = metrics.items()
        tiles.append(
            _tile(
                f"bags within {own['radius_cm']:g} cm",
                f"{100 * rate['rate']:.0f}",
                "%",
                f"95% between {100 * rate['low']:.0f} and {100 * rate['high']:.0f}%, n = {rate['n']}",
                [(name, f"{100 * other['success']['rate']:.0f}%") for name, other in others],
            )
        )
        tiles.append(
            _tile(
                "bag to goal, median",
                f"{distance['median']:.2f}",
                "cm",
                f"mean {distance['mean']:.2f}, worst {distance['max']:.2f}",
                [(name, f"{other['distance_cm']['median']:.2f} cm") for name, other in others],
            )
        )
        tiles.append(
            _tile(
                "time to decide, median",
                f"{decision['median']:.0f}",
                "ms",
                f"95% under {decision['p95']:.0f} ms",
                [(name, _ms(other["decision_ms"]["median"])) for name, other in others],
            )
        )
    return tiles


def _tile(what: str, value: str, unit: str, detail: str, beside: list[tuple[str, str]]) -> Content:
    return {"what": what, "value": value, "unit": unit, "detail": detail, "beside": beside}


def _numbers(results: Results, policies: Sequence[str]) -> Content:
    columns = ["pick error", "place error", "success", "bag to goal", "decision"]
    validations = {v.policy: v for v in results.validations}
    evaluations = {e.policy: e.metrics for e in results.evaluations}
    rows: list[Content] = []
    for number, policy in enumerate(policies):
        cells = [""] * len(columns)
        if policy in validations:
            metrics = validations[policy].metrics
            errors = metrics[validations[policy].reference]
            cells[:2] = [f"{errors[f'{what}_error_cm']['mean']:.2f} cm" for what in ("pick", "place")]
            cells[4] = _ms(metrics["decision_ms"]["median"])
        if policy in evaluations:
            metrics = evaluations[policy]
            rate = metrics["success"]
            done = round(rate["rate"] * rate["n"])
            cells[2] = f"{done} of {rate['n']} ({100 * rate['low']:.0f} to {100 * rate['high']:.0f}%)"
            cells[3] = f"{metrics['distance_cm']['mean']:.2f} cm"
            cells[4] = _ms(metrics["decision_ms"]["median"])
        series, kind = number % len(figures.SERIES) + 1, "" if number else "first"
        rows.append({"name": policy, "series": series, "kind": kind, "cells": cells})
    if validations:
        name, published = PUBLISHED
        rows.append({"name": name, "series": None, "kind": "published", "cells": published})
    references = {v.reference for v in validations.values()}
    against = "the simulator's truth" if references == {"truth"} else "recorded labels"
    radii = sorted({metrics["radius_cm"] for metrics in evaluations.values()})
    about = [f"Errors are means over held-out attempts, against {against}."] if validations else []
    if radii:
        within = " or ".join(f"{radius:g}" for radius in radii)
        about.append(
            f"Success is a bag within {within} cm of its goal (95% Wilson interval); decisions are medians."
        )
    filled = [column for column in range(len(columns)) if any(row["cells"][column] for row in rows)]
    for row in rows:
        row["cells"] = [row["cells"][column] for column in filled]
    return {"columns": [columns[c] for c in filled], "rows": rows, "numbers_about": " ".join(about)}


def _videos(evaluations: Sequence[Evaluation], main: str) -> list[Content]:
    found = [(e, path) for e in evaluations if e.policy == main for path in e.videos()]
    found = found or [(e, path) for e in evaluations for path in e.videos()]
    videos = []
    for evaluation, path in found[:MAX_VIDEOS]:
        number = int(path.stem.split("-")[1])
        distance = next((e.distance_cm for e in evaluation.episodes if e.episode == number), None)
        end = "" if distance is None else f": ends {distance:.1f} cm from the goal"
        videos.append({"uri": _data_uri(path), "caption": f"{evaluation.policy}, episode {number}{end}"})
    return videos


def _closed_loop(evaluations: Sequence[Evaluation], main: str, colors: figures.Colors) -> Content | None:
    if not evaluations:
        return None
    first = next((e for e in evaluations if e.policy == main), evaluations[0])
    radius = first.metrics["radius_cm"]
    causes = dict.fromkeys(cause for e in evaluations for cause in e.metrics["failures"])
    distances = {e.policy: e.distances_cm() for e in evaluations}
    offsets = {e.policy: e.offsets_cm() for e in evaluations}
    worst = sorted(first.episodes, key=lambda e: e.distance_cm, reverse=True)[:WORST]
    cases = []
    for episode in worst:
        paths = [first.picture(episode, kind) for kind in ("before", "after")]
        trouble = f" · {episode.message or episode.failure}" if episode.failure else ""
        caption = f"{episode.distance_cm:.1f} cm from the goal{trouble}"
        cases.append({"number": episode.episode, "pictures": _data_uris(paths), "caption": caption})
    failures = [
        {"cause": c, "counts": [e.metrics["failures"].get(c, 0) for e in evaluations]} for c in causes
    ]
    totals = [f"{sum(e.metrics['failures'].values())} of {len(e.episodes)}" for e in evaluations]
    return {
        "main": first.policy,
        "policies": list(distances),
        "about": "Look, plan, move, check. Every scene is new, and the goal at least 20 cm from the bag. "
        "The policy looks again only when the gripper noticed that it missed.",
        "figures": [
            _figure(
                "How near the goal",
                figures.success_curves(distances, colors, radius),
                "Shaded: 95% Wilson intervals. Dashed: what counts as success.",
            ),
            _figure(
                "Where the bags came to lie",
                figures.landings(offsets, colors, radius),
                "Around their goals, seen from above; the robot looks up the page.",
            ),
        ],
        "failures": [*failures, {"cause": "all", "counts": totals}],
        "cases": cases,
    }


def _validation(validations: Sequence[Validation], main: str, colors: figures.Colors) -> Content | None:
    if not validations:
        return None
    first = next((v for v in validations if v.policy == main), validations[0])
    vectors = []
    for what in ("pick", "place"):
        true, predicted = first.positions(what)
        # Errors are millimetres in half a metre of workspace: magnify the larger ones to about 5 cm.
        large = float(np.percentile(np.linalg.norm(predicted - true, axis=1), 90))
        magnify = float(np.clip(round(0.05 / max(large, 1e-4)), 1, 50))
        svg = figures.error_vectors(true, predicted, colors[first.policy], magnify)
        note = f"From each true place (dot) towards the predicted one; arrows are {magnify:g} times too long."
        vectors.append(_figure(f"{what.capitalize()} errors over the workspace, {first.policy}", svg, note))
    spread = [
        _figure(
            f"{what.capitalize()} errors",
            figures.error_distribution({v.policy: v.errors_cm(what) for v in validations}, colors),
            "How many attempts have at most this error.",
        )
        for what in ("pick", "place")
    ]
    cases = []
    for item in first.worst[:WORST]:
        uris = _data_uris([first.folder / item["picture"]])
        errors = item["errors"].get(first.reference)
        caption = "no plan"
        if errors:
            caption = (
                f"pick off by {errors['pick_error_cm']:.2f} cm, place by {errors['place_error_cm']:.2f} cm"
            )
        cases.append({"number": item["attempt_id"], "picture": uris[0] if uris else "", "caption": caption})
    held_out = first.metrics["held_out"]
    truth = "the simulator's truth" if first.reference == "truth" else "the recorded poses"
    return {
        "main": first.policy,
        "about": f"{held_out['attempts']} attempts, {held_out['which']}; errors against {truth}.",
        "figures": [*vectors, *spread],
        "cases": cases,
    }


def _heat(results: Results, main: str) -> list[Content]:
    items = []
    for validation in results.validations:
        if validation.policy == main:
            for item in validation.worst[:6]:
                if "heat" in item:
                    path = validation.folder / item["heat"]
                    items.append((path, f"attempt {item['attempt_id']}"))
    for evaluation in results.evaluations:
        if evaluation.policy == main:
            worst = sorted(evaluation.episodes, key=lambda e: e.distance_cm, reverse=True)[:6]
            items += [(evaluation.picture(e, "heat"), f"episode {e.episode}") for e in worst]
    return [{"uri": _data_uri(path), "caption": caption} for path, caption in items if path.exists()]


_CURVES = {"_cm": "errors (cm)", "_deg": "yaw errors (degrees)", "": "loss and its parts"}
"""Training curves that share a chart, by the unit their tags end in."""


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
                charts.append(_figure(f"{training.policy}: {title}", figures.curves(groups[unit]), ""))
    if not charts:
        return None
    times = [f"{t.policy} in {_duration(t.metrics['train_s'])}" for t in trainings if "train_s" in t.metrics]
    return {"about": f"Trained {', '.join(times)}." if times else "Curves by step.", "figures": charts}


def _origins(results: Results) -> list[Content]:
    origins = []
    kinds = {Training: "Training", Validation: "Validation", Evaluation: "Closed loop"}
    for item in results.items():
        if origin := item.metrics.get("provenance"):
            origins.append({"name": f"{kinds[type(item)]}, {item.policy}", "lines": origin_lines(origin)})
    return [*origins, {"name": "This page", "lines": origin_lines(provenance())}]


def _figure(title: str, svg: str, note: str) -> Content:
    return {"title": title, "svg": svg, "note": note}


def _ms(milliseconds: float) -> str:
    return "below 1 ms" if milliseconds < 1 else f"{milliseconds:.0f} ms"


def _duration(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.1f} minutes"


def _data_uris(paths: Sequence[Path]) -> list[str]:
    return [_data_uri(path) for path in paths if path.exists()]


def _data_uri(path: Path) -> str:
    return f"data:{_MIME[path.suffix]};base64,{base64.b64encode(path.read_bytes()).decode()}"
