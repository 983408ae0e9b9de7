"""What the report says of the closed loop: videos, distances, plans, failures, the worst episodes.

What the report says of tasks with blocks: success, partial credit, failures, and episodes step by step.
"""

from __future__ import annotations

from collections.abc import Sequence

from baggie.evaluation.block_episode import BlockEpisode
from baggie.report import figures
from baggie.report.items import (
    BlockEvaluation,
    Content,
    Evaluation,
    Tried,
    data_uri,
    data_uris,
    figure,
    in_words,
    percent,
)

MAX_EPISODES = 3
"""Shown step by step: those with the least done."""
_ABOUT = (
    "Look, plan, move, until the task is done or its steps are used up; every scene is new. Strict success wants every "
    "block upright and at its height in a slot of its own, still so two seconds later; Ravens' own success knows "
    "neither heights nor what falls later."
)


def blocks(evaluations: Sequence[BlockEvaluation], main: str, colors: figures.Colors) -> Content | None:
    """Every variable of the section; None without an evaluation."""
    if not evaluations:
        return None
    first = next((e for e in evaluations if e.policy == main), evaluations[0])
    rates = {e.policy: [e.metrics["success"], e.metrics["ravens_success"]] for e in evaluations}
    worst = sorted(first.episodes, key=lambda episode: (episode.success, episode.partial_credit))
    return {
        "main": first.policy,
        "tasks": ", ".join(dict.fromkeys(e.task for e in evaluations)),
        "policies": [e.policy for e in evaluations],
        "about": _ABOUT,
        "figures": [
            figure(
                "Success",
                figures.success_bars(rates, ("strict", "Ravens"), colors),
                "Lines are 95% Wilson intervals.",
            ),
            figure(
                "Partial credit",
                figures.credit_histogram({e.policy: e.credits() for e in evaluations}, colors),
                "How much of the task Ravens counts as done at the end of an episode.",
            ),
        ],
        "failures": _counts(evaluations, "failures"),
        "failed_steps": _counts(evaluations, "failed_steps"),
        "episodes": [_episode(first, episode) for episode in worst[:MAX_EPISODES]],
    }


def _counts(evaluations: Sequence[BlockEvaluation], key: str) -> list[Content]:
    causes = dict.fromkeys(cause for e in evaluations for cause in e.metrics[key])
    return [{"cause": c, "counts": [e.metrics[key].get(c, 0) for e in evaluations]} for c in causes]


def _episode(evaluation: BlockEvaluation, episode: BlockEpisode) -> Content:
    """Start, every step with its heat maps, end; without the pictures that are not there."""
    captions = {"before": "start"}
    for number, step in enumerate(episode.steps):
        what = step.failure or f"{100 * step.reward:+.0f}%"
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
    (True, True): "raised to a bag's height with the cell's calibration",
    (False, False): "taken as seen, some millimetres lower than a bag's outline",
    (False, True): "raised to a bag's height where a calibration was at hand, else taken as seen",
}


def videos(evaluations: Sequence[Tried], main: str) -> list[Content]:
    """Two at most, of the policy the report is about where there are any."""
    found = [(e, path) for e in evaluations if e.policy == main for path in e.videos()]
    found = found or [(e, path) for e in evaluations for path in e.videos()]
    shown = []
    for evaluation, path in found[:MAX_VIDEOS]:
        number = int(path.stem.split("-")[1])
        words = [f"{evaluation.policy}, episode {number}", evaluation.ending(number)]
        caption = f"{': '.join(filter(None, words))} (at {evaluation.speed:g} times the real speed)"
        shown.append({"uri": data_uri(path), "caption": caption})
    return shown


def closed_loop(evaluations: Sequence[Evaluation], main: str, colors: figures.Colors) -> Content | None:
    """Every variable of the section; None without an evaluation."""
    if not evaluations:
        return None
    first = next((e for e in evaluations if e.policy == main), evaluations[0])
    radius = first.metrics["radius_cm"]
    about = [
        "Look, plan, move, check. Every scene is new, and the goal at least 20 cm from the bag. The policy looks "
        "again only when the gripper noticed that it missed."
    ]
    causes = dict.fromkeys(cause for e in evaluations for cause in e.metrics["failures"])
    distances = {e.policy: e.distances_cm() for e in evaluations}
    offsets = {e.policy: e.offsets_cm() for e in evaluations}
    about += [
        f"{evaluation.policy} was tried on a real arm ({evaluation.workcell}), where each scene begins where the one "
        "before it ended, and bags are where the camera sees them."
        for evaluation in evaluations
        if evaluation.workcell is not None
    ]
    raised = {e.metrics["card_raised"] for e in evaluations if "card_raised" in e.metrics}
    if raised:
        about.append(f"A real card lies on the table; its corners were {_RAISED[min(raised), max(raised)]}.")
    worst = sorted(first.episodes, key=lambda e: e.distance_cm, reverse=True)[:WORST]
    cases = []
    for episode in worst:
        paths = [first.picture(episode.episode, kind) for kind in ("before", "after")]
        trouble = f" · {episode.message or episode.failure}" if episode.failure else ""
        caption = f"{episode.distance_cm:.1f} cm from the goal{trouble}"
        cases.append({"number": episode.episode, "pictures": data_uris(paths), "caption": caption})
    failures = [
        {"cause": c, "counts": [e.metrics["failures"].get(c, 0) for e in evaluations]} for c in causes
    ]
    totals = [f"{sum(e.metrics['failures'].values())} of {len(e.episodes)}" for e in evaluations]
    return {
        "main": first.policy,
        "policies": list(distances),
        "about": " ".join(about),
        "figures": [
            figure(
                "How near the goal",
                figures.success_curves(distances, colors, radius),
                "Shaded: 95% Wilson intervals. Dashed: what counts as success.",
            ),
            figure(
                "Where the bags came to lie",
                figures.landings(offsets, colors, radius),
                "Around their goals, seen from above; the robot looks up the page.",
            ),
        ],
        "plans": _plans(evaluations),
        "known_by": _known_by({e.workcell is None for e in evaluations}),
        "failures": [*failures, {"cause": "all", "counts": totals}],
        "cases": cases,
    }


def _known_by(simulated: set[bool]) -> str:
    """Who says where bags are: a simulator, the cameras of real workcells, or, each in its own, both."""
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
        rows.append({"name": evaluation.policy, "cells": cells})
    filled = [column for column in range(len(columns)) if any(row["cells"][column] for row in rows)]
    rows = [{**row, "cells": [row["cells"][column] for column in filled]} for row in rows]
    return {"columns": [columns[column] for column in filled], "rows": rows}
