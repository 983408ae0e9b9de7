"""The closed loop with blocks: tasks of several steps, scored as Ravens does and strictly."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any

from baggie.evaluation.block_bench import BlockBench, open_block_bench
from baggie.evaluation.block_episode import BlockEpisode, run_block_episode
from baggie.evaluation.kind import Kind
from baggie.evaluation.metrics import success_rate, summary
from baggie.evaluation.options import EvaluateOptions
from baggie.seeds import EVALUATION


def _run(bench: BlockBench, number: int, options: EvaluateOptions) -> BlockEpisode:
    out, film = options.out / "episodes", number < options.film
    return run_block_episode(bench, number, (EVALUATION, options.seed), out=out, film=film)


def _measure(episodes: Sequence[BlockEpisode], _options: EvaluateOptions) -> dict[str, Any]:
    """`success` strictly and as Ravens counts, `partial_credit`, steps, times, and failures by their cause."""
    count, steps = len(episodes), [step for episode in episodes for step in episode.steps]
    return {
        "success": success_rate(sum(episode.success for episode in episodes), count),
        "ravens_success": success_rate(sum(episode.ravens_success for episode in episodes), count),
        "partial_credit": summary([episode.partial_credit for episode in episodes]),
        "steps": summary([len(episode.steps) for episode in episodes]),
        "decision_ms": summary([step.decision_ms for step in steps]),
        "failures": _counted(episode.failure for episode in episodes),
        "failed_steps": _counted(step.failure for step in steps),
    }


def _counted(causes: Iterable[str]) -> dict[str, int]:
    """How often each came, the most frequent first; no cause is no failure."""
    return dict(Counter(cause for cause in causes if cause).most_common())


def _note(episode: BlockEpisode) -> str:
    return f"last got {100 * episode.partial_credit:.0f}% done"


BLOCKS = Kind(
    log="block-episodes.jsonl",
    episode=BlockEpisode,
    open_bench=open_block_bench,
    run=_run,
    measure=_measure,
    note=_note,
)
