"""The `keypoint` policy: finds bag and goal in the picture, and knows where that is for the robot."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Self

import numpy as np
import torch
from numpy.typing import NDArray

from baggie.policies import keypoint_plan
from baggie.policies.keypoint_net import KeypointNet
from baggie.policies.keypoint_plan import Float32, GoalInput, Reading
from baggie.policies.keypoint_reader import KeypointReader
from baggie.policies.learned import LearnedPolicy
from baggie.policies.view import View
from baggie.types import Goal, Observation, Plan, marked


class KeypointPolicy(LearnedPolicy):
    """One small network for pick and place.

    The goal's region goes in as a fourth channel rather than painted over the picture: a patch over the bag
    would hide what is to be picked, and how the goal is drawn (style, colour) makes no difference.
    """

    name = "keypoint"
    network: KeypointNet

    def __init__(
        self, network: KeypointNet, view: View, cell: int, goal_input: GoalInput | None = None
    ) -> None:
        """`view`: the part of the picture in which its training attempts took place."""
        super().__init__(network, view.picture, cell)
        self.view = view
        self.goal_input = goal_input or GoalInput()

    def model_config(self) -> dict[str, Any]:
        """The network's kind, its view, and how goals get into its input."""
        return {
            "width": self.network.width,
            "backbone": self.network.backbone,
            "view": self.view.config(),
            "goal": self.goal_input.config(),
        }

    @classmethod
    def build(cls, model: Mapping[str, Any], picture_size: tuple[int, int], cell: int) -> Self:
        """The policy with an untrained network."""
        goal_input = GoalInput.of(model["goal"])
        network = KeypointNet(int(model["width"]), goal_input.channels, model["backbone"])
        return cls(network, View.of(model["view"], picture_size), cell, goal_input)

    def plan(self, observation: Observation, goal: Goal | None = None) -> Plan:
        """Where to pick and where to place; see `keypoint_plan.plan`, whose errors it raises."""
        return keypoint_plan.plan(
            self.read, self.view, self.goal_input, observation, marked(goal), camera_size=self.camera_size
        )

    def reader(self) -> KeypointReader:
        """The network with all that is computed from it, in evaluation mode: what is exported."""
        return KeypointReader(self.network, keypoint_plan.to_picture(self.view)).eval()

    def read(self, images: NDArray[np.uint8], near: Float32, corners: Float32) -> Reading:
        """Run the network; see `keypoint_plan.Read`."""
        with torch.inference_mode():
            given = (torch.from_numpy(array).to(self.device) for array in (images, near, corners))
            return Reading(*(part.cpu().numpy() for part in self.reader()(*given)))
