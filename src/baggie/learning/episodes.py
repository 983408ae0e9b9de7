"""Which episodes teach and which measure, for policies of tasks that take several attempts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from baggie.data.annotation import did_its_task
from baggie.errors import DataError
from baggie.learning.split import Split, check_alike
from baggie.types import Attempt

RULE = "episodes that did their whole task, by attempt id: the first train, the next measure; of them what succeeded"


def split_episodes(attempts: Sequence[Attempt], train: int, val: int) -> Split:
    """By `RULE`; `train` and `val` count episodes, and none is in both. An attempt of no episode is one by itself.

    Where rewards were recorded, an episode did its task when they add up to 1. Raises `DataError` when there are too
    few, or they are from different cells or cameras.
    """
    if train < 1 or val < 0:
        raise DataError(f"train must be at least 1 and val at least 0, got {train} and {val}")
    episodes: dict[tuple[str, int], list[Attempt]] = {}
    for attempt in attempts:
        alone = attempt.episode is None
        key = ("attempt", attempt.attempt_id) if alone else ("episode", attempt.episode or 0)
        kept = replace(attempt, before=replace(attempt.before, depth=None), after=None)
        episodes.setdefault(key, []).append(kept)
    teaching = [chosen for episode in episodes.values() if (chosen := _demonstration(episode))]
    if len(teaching) < train + val:
        raise DataError(
            f"training on {train} and measuring on {val} episodes needs {train + val} that did their task, but the "
            f"recording has {len(teaching)}: collect more, or lower --train or --val"
        )
    first, next_ones = (
        [attempt for episode in part for attempt in episode]
        for part in (teaching[:train], teaching[train : train + val])
    )
    check_alike([*first, *next_ones])
    return Split(first, next_ones)


def _demonstration(episode: list[Attempt]) -> list[Attempt]:
    """What of an episode can teach; nothing where the task was not done."""
    if not did_its_task(attempt.reward for attempt in episode):
        return []
    return [attempt for attempt in episode if attempt.outcome.success]
