"""One turn of the loop: a plan from a picture, carried out, and what went wrong by whose account."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Protocol

from baggie.errors import BaggieError, LimitError, ReachError, UnsureError
from baggie.types import Goal, Observation, Outcome, Plan


class MovingCell(Protocol):
    """A workcell that does what is planned."""

    def carry_out(self, plan: Plan) -> Outcome:
        """Pick and place; raises `UnsureError`, `LimitError` and `ReachError`."""
        ...


@dataclass(frozen=True)
class Turn:
    """What a policy wanted and what became of it."""

    plan: Plan | None
    """None where it could not tell."""
    outcome: Outcome | None
    """None where nothing was moved, or what was picked up was put back."""
    failure: str
    """`no-plan`, `unsure`, `out-of-reach`, or what the outcome says; empty when nothing went wrong."""
    message: str
    decision_ms: float
    """Wall clock of the plan."""

    @property
    def gave_up(self) -> bool:
        """Whether nothing was tried: by another look at the same scene nothing changes."""
        return self.failure in ("no-plan", "unsure")


class Planner(Protocol):
    """A policy, or a memory that asks one."""

    def plan(self, observation: Observation, goal: Goal | None = None) -> Plan:
        """Where to pick and where to place."""
        ...


def take_turn(policy: Planner, cell: MovingCell, seen: Observation, goal: Goal | None = None) -> Turn:
    """Plan from what was seen, and move."""
    clock = time.perf_counter()
    try:
        plan = policy.plan(seen, goal)
    except BaggieError as error:
        return Turn(None, None, "no-plan", str(error), 1000 * (time.perf_counter() - clock))
    decision_ms = 1000 * (time.perf_counter() - clock)
    try:
        outcome = cell.carry_out(plan)
    except UnsureError as error:
        return Turn(plan, None, "unsure", str(error), decision_ms)
    except (LimitError, ReachError) as error:
        return Turn(plan, None, "out-of-reach", str(error), decision_ms)
    return Turn(plan, outcome, outcome.failure or "", "", decision_ms)
