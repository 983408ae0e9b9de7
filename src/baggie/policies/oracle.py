"""The scripted oracle: a policy that is told the truth. What it misses, no policy can get right."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from baggie.errors import BaggieError
from baggie.geometry import PlanarPose, wrap_angle
from baggie.options.values import ORACLE
from baggie.policies.base import Policy
from baggie.types import Goal, Observation, PickPlace, Plan


class OraclePolicy(Policy):
    """Picks the bag where it truly is and places it at the goal's true pose. For evaluation in simulation
    only.
    """

    name = ORACLE

    def __init__(
        self,
        bag_pose: Callable[[], PlanarPose],
        goal_pose: Callable[[], PlanarPose],
        symmetry: Callable[[], int] = lambda: 4,
    ) -> None:
        """All are asked at every plan: poses now, in the robot's base frame, and how often a turn the bag looks the
        same, 0 for at any angle.
        """
        self.bag_pose = bag_pose
        self.goal_pose = goal_pose
        self.symmetry = symmetry

    def plan(self, observation: Observation, goal: Goal | None = None) -> Plan:
        """The true poses; neither the picture nor the goal in it is looked at.

        Of the yaws that look the same those that turn the wrist least: others may be out of its reach.
        """
        bag, end, symmetry = self.bag_pose(), self.goal_pose(), self.symmetry()
        turn = 2 * math.pi / symmetry if symmetry else 0.0
        pick_yaw = wrap_angle(bag.yaw, turn) if turn else 0.0
        place_yaw = pick_yaw + (wrap_angle(end.yaw - pick_yaw, turn) if turn else 0.0)
        return Plan(PickPlace(replace(bag, yaw=pick_yaw), replace(end, yaw=place_yaw)))


class DemonstratorPolicy(Policy):
    """Does what a demonstrator, who knows where everything is, does next. For evaluation in simulation only."""

    name = OraclePolicy.name

    def __init__(self, next_action: Callable[[], PickPlace | None]) -> None:
        """`next_action` is asked at every plan; None when all is done."""
        self.next_action = next_action

    def plan(self, observation: Observation, goal: Goal | None = None) -> Plan:
        """The next pick and place; the picture is not looked at. Raises `BaggieError` when nothing is left to do."""
        action = self.next_action()
        if action is None:
            raise BaggieError("expected something left to do, but the task is done; begin another scene")
        return Plan(action)
