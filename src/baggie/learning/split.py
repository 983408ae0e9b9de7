"""Split attempts, or whole episodes of several steps, into those that teach and those that measure, by a rule."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from baggie.data.summary import did_its_task, is_demonstration
from baggie.errors import DataError
from baggie.types import Attempt, Observation

RULE = "successful attempts with a goal in the picture, by attempt id: the first train, the next measure"


USUAL_TRAIN, USUAL_VAL = 200, 50
"""So many teach and measure at most where nobody says how many."""
_SHARE = 0.8
"""Of fewer, what teaches."""


def shares(there: int, train: int | None, val: int | None, names: tuple[str, str]) -> tuple[int, int]:
    """How many of `there` demonstrations teach, and how many measure; None where nobody said.

    `names`: what they are and which of them count, for the message. Raises `DataError` where there are too few.
    """
    if (train is not None and train < 1) or (val is not None and val < 0):
        raise DataError(f"train must be at least 1 and val at least 0, got {train} and {val}")
    if train is None and val is None and 1 < there < USUAL_TRAIN + USUAL_VAL:
        train = min(round(_SHARE * there), there - 1)
    teaching = train if train is not None else min(USUAL_TRAIN, max(there - (val or 0), 1))
    measuring = val if val is not None else min(USUAL_VAL, max(there - teaching, 1))
    if there < teaching + measuring:
        raise DataError(
            f"training on {teaching} and measuring on {measuring} {names[0]} needs {teaching + measuring} {names[1]}, "
            f"but the recording has {there}: collect more, or lower --train or --val"
        )
    return teaching, measuring


@dataclass(frozen=True)
class Split:
    """Attempts with the picture before only; all else that is large is left behind."""

    train: list[Attempt]
    val: list[Attempt]
    rule: str = RULE
    """By which they were chosen, in words."""

    @classmethod
    def of(cls, attempts: Sequence[Attempt], train: int | None = None, val: int | None = None) -> Split:
        """Split attempts by `RULE`; four fifths and one fifth, at most 200 and 50, where it is not said how many.

        Raises `DataError` when there are too few attempts, or they are from different cells or cameras.
        """
        most = (USUAL_TRAIN if train is None else train) + (USUAL_VAL if val is None else val)
        chosen: list[Attempt] = []
        succeeded = 0
        for attempt in attempts:
            if len(chosen) >= most:
                break
            succeeded += attempt.outcome.success
            if is_demonstration(attempt):
                chosen.append(replace(attempt, before=Observation(attempt.before.color), after=None))
        if succeeded and not chosen:
            raise DataError(
                f"expected attempts with a goal in a camera's picture, got {succeeded} that succeeded, none with one: "
                "a task whose conditions say where things go is learned by transporter, from height maps"
            )
        teaching, measuring = shares(len(chosen), train, val, ("attempts", "that succeeded"))
        chosen = chosen[: teaching + measuring]
        check_alike(chosen)
        return cls(chosen[:teaching], chosen[teaching:])


def check_alike(attempts: Sequence[Attempt]) -> None:
    """Raise `DataError` when attempts are from different cells or cameras."""
    for what, values in (
        ("cells", {attempt.cell for attempt in attempts}),
        ("picture sizes", {attempt.before.size for attempt in attempts}),
    ):
        if len(values) > 1:
            raise DataError(
                f"a policy belongs to one cell and camera, but the recording mixes {what} "
                f"{sorted(values)}: "
                "collect each into its own folder"
            )


EPISODES_RULE = (
    "episodes that did their whole task, by attempt id: the first train, the next measure; of them what succeeded, and "
    "what earned something where most steps did"
)
_MOST = 0.5
"""So large a share of the steps that earned something means that every step is to."""


def split_episodes(attempts: Sequence[Attempt], train: int | None = None, val: int | None = None) -> Split:
    """Split episodes by `EPISODES_RULE`; `train` and `val` count episodes, and none is in both.

    An attempt of no episode is one by itself.

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
    return Split(first, next_ones, EPISODES_RULE)


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
