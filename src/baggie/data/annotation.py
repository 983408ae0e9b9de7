"""Goals for recorded attempts: where the bag came to rest is where it had been meant to go."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from baggie.errors import BaggieError, DataError
from baggie.types import Attempt, Goal
from baggie.vision.draw import check_goal

_DONE = 1 - 1e-6


def goal_of(attempt: Attempt) -> Goal:
    """The bag's box in the picture after, as the goal in the picture before.

    Hindsight relabelling: whatever the attempt was meant to do, it shows how to reach where the bag lies now.
    Nothing is painted here; `baggie.vision.draw.paint_goal` does that when a picture is read, so that one
    recording serves every style and colour, the printed card's in today's light too (`vision.goal_card.measure_color`).
    Raises `DataError` when the bag was not found in the picture after.
    """
    if not np.isfinite(attempt.box_after).all():
        raise DataError(
            f"attempt {attempt.attempt_id} has no goal: the bag was not found in its picture after"
        )
    return Goal(np.asarray(attempt.box_after, float))


def shown_goal(attempt: Attempt) -> Goal | None:
    """Where the object came to rest, as the goal in the picture before; None for a task without a marked goal."""
    return goal_of(attempt) if np.isfinite(attempt.box_after).all() else None


def is_demonstration(attempt: Attempt) -> bool:
    """Whether an attempt can teach: it succeeded, and its goal lies wholly in the picture before."""
    if not attempt.outcome.success:
        return False
    try:
        check_goal(goal_of(attempt), attempt.before.size)
    except BaggieError:
        return False
    return True


def did_its_task(rewards: Iterable[float | None]) -> bool:
    """Whether an episode with these rewards did its task: they add up to 1, or nobody counted (None or NaN)."""
    counted = [reward for reward in rewards if reward is not None and not math.isnan(reward)]
    return not counted or sum(counted) >= _DONE
