"""The scripted oracle: a policy that is told the truth. What it misses, no policy can get right."""

from __future__ import annotations

from collections.abc import Callable

from baggie.geometry import PlanarPose
from baggie.policies.base import Policy
from baggie.types import Goal, Observation, PickPlace, Plan


class OraclePolicy(Policy):
    """Picks the bag where it truly is and places it at the goal's true pose. For evaluation in simulation
    only.
    """

    name = "oracle"

    def __init__(self, bag_pose: Callable[[], PlanarPose], goal_pose: Callable[[], PlanarPose]) -> None:
        """Both are asked at every plan: poses now, in the robot's base frame."""
        self.bag_pose = bag_pose
        self.goal_pose = goal_pose

    def plan(self, observation: Observation, goal: Goal | None = None) -> Plan:
        """The true poses; neither the picture nor the goal in it is looked at."""
        return Plan(PickPlace(self.bag_pose(), self.goal_pose()))
