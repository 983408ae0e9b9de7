"""What every policy is: the colour mask, the published regressor, ours, the oracle."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from baggie.types import Goal, Observation, Plan


@runtime_checkable
class Policy(Protocol):
    """Maps a picture and a goal in it to a plan in robot coordinates. Never sees a robot."""

    name: str

    def plan(self, observation: Observation, goal: Goal) -> Plan:
        """Where to pick and where to place.

        Raises `BaggieError` when it cannot tell: no bag in sight, the goal outside the picture.
        """
        ...
