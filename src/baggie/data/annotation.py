"""Goals for recorded attempts: where the bag came to rest is where it had been meant to go."""

from __future__ import annotations

import numpy as np

from baggie.errors import BaggieError, DataError
from baggie.types import Attempt, Goal, GoalStyle
from baggie.vision.draw import check_goal


def goal_of(attempt: Attempt, style: GoalStyle = "solid", color: tuple[int, int, int] = (0, 200, 0)) -> Goal:
    """The bag's box in the picture after, as the goal in the picture before.

    Hindsight relabelling: whatever the attempt was meant to do, it shows how to reach where the bag lies now.
    Nothing is painted here; `baggie.vision.draw.paint_goal` does that when a picture is read, so that one
    recording serves every style and colour, the printed card's in today's light too (`vision.goal_card.measure_color`).
    Raises `DataError` when the bag was not found in the picture after, `BaggieError` for the style `card`: none lies in
    a recorded picture, so that nothing at all would show the goal.
    """
    if style == "card":
        raise BaggieError(
            "expected the style outline or solid for a recorded goal, got card: none lies in the pictures; "
            "give the card's colour and let it be painted"
        )
    if not np.isfinite(attempt.box_after).all():
        raise DataError(
            f"attempt {attempt.attempt_id} has no goal: the bag was not found in its picture after"
        )
    return Goal(np.asarray(attempt.box_after, float), style, color)


def is_demonstration(attempt: Attempt) -> bool:
    """Whether an attempt can teach: it succeeded, and its goal lies wholly in the picture before."""
    if not attempt.outcome.success:
        return False
    try:
        check_goal(goal_of(attempt), attempt.before.size)
    except BaggieError:
        return False
    return True
