"""The scripted oracle: a policy that is told the truth. What it misses, no policy can get right."""

from __future__ import annotations

from collections.abc import Callable

from baggie.errors import BaggieError
from baggie.options.choices import ORACLE
from baggie.policies.base import Policy
from baggie.types import Goal, Observation, PickPlace, Plan


class OraclePolicy(Policy):
    """Does what a demonstrator, who knows where everything is, does next. For evaluation in simulation only.

    cell.give_goal(goal)
    policy = OraclePolicy(cell.demonstrate)
    """

    name = ORACLE

    def __init__(self, next_action: Callable[[], PickPlace | None]) -> None:
        """`next_action` is asked at every plan; None when all is done."""
        self.next_action = next_action

    def plan(self, observation: Observation, goal: Goal | None = None) -> Plan:
        """Plan the next pick and place; neither the picture nor the goal in it is looked at.

        Raises `BaggieError` when nothing is left to do.
        """
        action = self.next_action()
        if action is None:
            raise BaggieError("expected something left to do, but the task is done; begin another scene")
        return Plan(action)
