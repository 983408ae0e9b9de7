"""The report's headline numbers, and the table of all of them."""

from __future__ import annotations

from collections.abc import Sequence

from baggie.evaluation import report_figures as figures
from baggie.evaluation.report_data import Results
from baggie.evaluation.report_values import Content, ms, percent

PUBLISHED = ("as published, real arm", ("7.80 cm", "5.80 cm", "", "", "", ""))
"""Pick and place error of the published system (ResNet-18, 200 training images), for comparison."""
_STATED = "pick and place inside their radius"


def headline_tiles(results: Results, main: str) -> list[Content]:
    """Headline numbers of one policy, each beside those of the others."""
    tiles = []
    for what in ("pick", "place"):
        values = {v.policy: v.metrics[v.reference][f"{what}_error_cm"] for v in results.validations}
        if main in values:
            own = values.pop(main)
            detail = f"median {own['median']:.2f}, worst {own['max']:.2f}"
            beside = [(name, f"{other['mean']:.2f} cm") for name, other in values.items()]
            tiles.append(_tile(f"{what} error, mean", f"{own['mean']:.2f}", "cm", detail, beside))
    conditions = next((e.conditions for e in results.evaluations if e.policy == main), "")
    # Beside it only what was put to the same test; the table of numbers has the rest.
    metrics = {e.policy: e.metrics for e in results.evaluations if e.conditions == conditions}
    if main in metrics:
        own = metrics.pop(main)
        rate, distance = own["success"], own["distance_cm"]
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
        if decision := own.get("decision_ms"):
            tiles.append(
                _tile(
                    "time to decide, median",
                    f"{decision['median']:.0f}",
                    "ms",
                    f"95% under {decision['p95']:.0f} ms",
                    [(name, ms(o["decision_ms"]["median"])) for name, o in others if "decision_ms" in o],
                )
            )
    return tiles


def _tile(what: str, value: str, unit: str, detail: str, beside: list[tuple[str, str]]) -> Content:
    return {"what": what, "value": value, "unit": unit, "detail": detail, "beside": beside}


def numbers(results: Results, policies: Sequence[str]) -> Content:
    """The table of all policies, a row each, without empty columns, and what to say about it."""
    columns = ["pick error", "place error", "success", "bag to goal", "decision", _STATED]
    validations = {v.policy: v for v in results.validations}
    evaluations = {e.policy: e.metrics for e in results.evaluations}
    rows: list[Content] = []
    for number, policy in enumerate(policies):
        cells = [""] * len(columns)
        if policy in validations:
            metrics = validations[policy].metrics
            errors = metrics[validations[policy].reference]
            cells[:2] = [f"{errors[f'{what}_error_cm']['mean']:.2f} cm" for what in ("pick", "place")]
            cells[4] = ms(metrics["decision_ms"]["median"])
            by_reference = metrics.get("confidence", {})
            stated = by_reference.get("labels", {}) | by_reference.get(validations[policy].reference, {})
            cells[5] = " and ".join(percent(rate) for key, rate in stated.items() if key.endswith("_within"))
        if policy in evaluations:
            metrics = evaluations[policy]
            rate = metrics["success"]
            done = round(rate["rate"] * rate["n"])
            cells[2] = f"{done} of {rate['n']} ({100 * rate['low']:.0f} to {100 * rate['high']:.0f}%)"
            cells[3] = f"{metrics['distance_cm']['mean']:.2f} cm"
            if "decision_ms" in metrics:
                cells[4] = ms(metrics["decision_ms"]["median"])
        series, kind = number % len(figures.SERIES) + 1, "" if number else "first"
        rows.append({"name": policy, "series": series, "kind": kind, "cells": cells})
    if validations:
        name, published = PUBLISHED
        rows.append({"name": name, "series": None, "kind": "published", "cells": published})
    references = {v.reference for v in validations.values()}
    against = "the simulator's truth" if references == {"truth"} else "recorded labels"
    radii = sorted({metrics["radius_cm"] for metrics in evaluations.values()})
    about = [f"Errors are means over held-out attempts, against {against}."] if validations else []
    if any(row["cells"][5] for row in rows):
        about.append("A plan states radii; picks and places should be inside theirs nine times of ten.")
    if radii:
        within = " or ".join(f"{radius:g}" for radius in radii)
        about.append(
            f"Success is a bag within {within} cm of its goal (95% Wilson interval); decisions are medians."
        )
    filled = [column for column in range(len(columns)) if any(row["cells"][column] for row in rows)]
    for row in rows:
        row["cells"] = [row["cells"][column] for column in filled]
    return {"columns": [columns[c] for c in filled], "rows": rows, "numbers_about": " ".join(about)}
