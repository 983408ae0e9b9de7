"""Which episodes teach and which measure, for policies of tasks that take several attempts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from baggie.data.annotation import did_its_task
from baggie.learning.split import Split, check_alike, shares
from baggie.types import Attempt

RULE = (
    "episodes that did their whole task, by attempt id: the first train, the next measure; of them what succeeded, and "
    "what earned something where most steps did"
)
_MOST = 0.5
"""So large a share of the steps that earned something means that every step is to."""


def split_episodes(attempts: Sequence[Attempt], train: int | None = None, val: int | None = None) -> Split:
    """By `RULE`; `train` and `val` count episodes, and none is in both. An attempt of no episode is one by itself.

    Four fifths and one fifth, at most 200 and 50, where it is not said how many.

    Where rewards were recorded, an episode did its task when they add up to 1. Raises `DataError` when there are too
    few, or they are from different cells or cameras.
    """
    episodes: dict[tuple[str, int], list[Attempt]] = {}
    for attempt in attempts:
        alone = attempt.episode is None
        key = ("attempt", attempt.attempt_id) if alone else ("episode", attempt.episode or 0)
        kept = replace(attempt, before=replace(attempt.before, depth=None))
        episodes.setdefault(key, []).append(kept)
    teaching = [chosen for episode in episodes.values() if (chosen := demonstration(episode))]
    train, val = shares(len(teaching), train, val, ("episodes", "that did their task"))
    first, next_ones = (
        [attempt for episode in part for attempt in episode]
        for part in (teaching[:train], teaching[train : train + val])
    )
    check_alike([*first, *next_ones])
    return Split(first, next_ones)


def demonstration(episode: Sequence[Attempt]) -> list[Attempt]:
    """What of an episode can teach, each with what was seen after it; nothing where the task was not done.

    A step that earned nothing among steps that earn went wrong. Where few earn anything, as where only the last one
    can, all of them may have been needed.
    """
    if not did_its_task(attempt.reward for attempt in episode):
        return []
    worked = [attempt for attempt in with_after(episode) if attempt.outcome.success]
    earned = [attempt for attempt in worked if attempt.reward is None or not attempt.reward <= 0]
    return earned if len(earned) >= _MOST * len(worked) else worked


def with_after(episode: Sequence[Attempt]) -> list[Attempt]:
    """The steps of an episode, each with what was seen after it: its own picture, or the one before the next."""
    following = [*(attempt.before for attempt in episode[1:]), None]
    return [
        attempt if attempt.after else replace(attempt, after=after)
        for attempt, after in zip(episode, following, strict=True)
    ]
