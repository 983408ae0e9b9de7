"""What every policy is: the colour mask, the published regressor, ours, the oracle."""

from __future__ import annotations

from abc import ABC, abstractmethod
from pathlib import Path

from baggie.types import Goal, Observation, Plan


class Policy(ABC):
    """Maps a picture and a goal in it to a plan in robot coordinates. Never sees a robot.

    policy = Policy.from_pretrained("runs/keypoint")
    plan = policy.plan(observation, goal)
    """

    name: str

    @abstractmethod
    def plan(self, observation: Observation, goal: Goal | None = None) -> Plan:
        """Where to pick and where to place. Without a goal: what comes next in the task the policy has learned.

        Raises `BaggieError` when it cannot tell: no bag in sight, the goal outside the picture or missing.
        """

    @classmethod
    def from_pretrained(cls, source: str | Path, device: str = "cpu") -> Policy:
        """The policy saved in the folder of a training run, or under a Hub id `owner/name`, of whatever kind it is.

        `device` is PyTorch's name for where to compute. Raises `DataError` when there is none, or one of its files is
        missing or damaged.
        """
        from baggie.policies import load_policy  # noqa: PLC0415 -- the kinds of policies import this file

        return load_policy(source, device)
