"""How far a policy is off on attempts, against their labels and, where it was recorded, the truth."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from typing import Any

from baggie.data.summary import shown_goal
from baggie.errors import BaggieError
from baggie.learning.demonstrations import carried_in
from baggie.metrics import action_errors, references, summary, symmetry_of
from baggie.policies.base import Policy
from baggie.types import Attempt


def measure(policy: Policy, attempts: Sequence[Attempt], symmetry: int | None = None) -> dict[str, Any]:
    """`labels` and `truth`, each a summary by quantity, and how many attempts were `without_plan`.

    `symmetry`: how often a turn what is moved looks the same, as each attempt says unless given; yaws are compared
    modulo that part of a turn. Of a thing that the maps before and after tell, a place is off by as much as its middle
    comes to lie off, wherever it is held.
    Attempts for which the policy could not tell have no error; where that is all of them, nor are there summaries.
    """
    errors: defaultdict[str, list[dict[str, float]]] = defaultdict(list)
    without_plan = 0
    for attempt in attempts:
        try:
            action = policy.plan(attempt.before, shown_goal(attempt)).action
        except BaggieError:
            without_plan += 1
            continue
        same = symmetry_of(attempt) if symmetry is None else symmetry
        thing, grid = carried_in(attempt), attempt.before.grid
        stands = None if thing is None or grid is None else thing.stood_at(action.pick, grid)
        for reference, right in references(attempt).items():
            errors[reference].append(action_errors(action, right, same, stands))
    summaries = {
        reference: {key: summary([row[key] for row in rows]) for key in rows[0]}
        for reference, rows in errors.items()
    }
    return {**summaries, "without_plan": without_plan}
