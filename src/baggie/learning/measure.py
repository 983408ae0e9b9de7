"""How far a policy is off on attempts, against their labels and, where it was recorded, the truth."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from baggie.data.annotation import goal_of
from baggie.errors import BaggieError
from baggie.evaluation.metrics import position_error_cm, summary, yaw_error_deg
from baggie.policies.base import Policy
from baggie.types import Attempt, PickPlace


def measure(policy: Policy, attempts: Sequence[Attempt]) -> dict[str, Any]:
    """`labels` and `truth`, each a summary by quantity, and how many attempts were `without_plan`.

    Attempts for which the policy could not tell have no error; where that is all of them, nor are there summaries.
    """
    errors: dict[str, list[dict[str, float]]] = {"labels": [], "truth": []}
    without_plan = 0
    for attempt in attempts:
        try:
            action = policy.plan(attempt.before, goal_of(attempt)).action
        except BaggieError:
            without_plan += 1
            continue
        errors["labels"].append(_errors(action, attempt.outcome.executed))
        if attempt.truth is not None:
            errors["truth"].append(_errors(action, PickPlace(attempt.truth.before, attempt.truth.after)))
    summaries = {
        reference: {key: summary([row[key] for row in rows]) for key in rows[0]}
        for reference, rows in errors.items()
        if rows
    }
    return {**summaries, "without_plan": without_plan}


def _errors(planned: PickPlace, right: PickPlace) -> dict[str, float]:
    return {
        "pick_error_cm": position_error_cm(planned.pick, right.pick),
        "place_error_cm": position_error_cm(planned.place, right.place),
        "pick_yaw_error_deg": yaw_error_deg(planned.pick, right.pick),
        "place_yaw_error_deg": yaw_error_deg(planned.place, right.place),
    }
