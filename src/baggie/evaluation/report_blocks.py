"""What the report says of tasks with blocks: success, partial credit, failures, and episodes step by step."""

from __future__ import annotations

from collections.abc import Sequence

from baggie.evaluation import report_figures as figures
from baggie.evaluation.block_episode import BlockEpisode
from baggie.evaluation.report_items import BlockEvaluation, in_words
from baggie.evaluation.report_values import Content, data_uri, figure

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
