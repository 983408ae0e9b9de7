"""The published regressor: a ResNet-18 that turns a picture with the goal painted in it into two numbers.

It is the baseline to beat, kept as published: 7.8 cm off when picking, 5.8 cm when placing.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Self

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from baggie.policies import regression_plan
from baggie.policies.keypoint_plan import GoalInput
from baggie.policies.learned import LearnedPolicy
from baggie.policies.resnet import IMAGENET_MEAN, IMAGENET_STD, ResNet18, Statistics
from baggie.types import DrawnStyle, Goal, Image, Observation, Plan, marked


class Regressor(nn.Module):
    """ResNet-18 to its 1000 logits, then 1000-128-32-2 with ReLU: `(B, 3, 224, 224)` -> `(B, 2)` metres."""

    def __init__(self, statistics: Statistics = "running") -> None:
        super().__init__()
        self.resnet = ResNet18(statistics)
        self.head = nn.Sequential(
            nn.Linear(1000, 128), nn.ReLU(), nn.Linear(128, 32), nn.ReLU(), nn.Linear(32, 2)
        )

    def forward(self, x: Tensor) -> Tensor:
        """Normalised images -> x, y in the robot's base frame."""
        xy: Tensor = self.head(self.resnet(x))
        return xy


class RegressionNet(nn.Module):
    """One network for the pick and one for the place; they share nothing."""

    mean: Tensor
    std: Tensor

    def __init__(self, statistics: Statistics = "running") -> None:
        super().__init__()
        self.statistics: Statistics = statistics
        self.pick = Regressor(statistics)
        self.place = Regressor(statistics)
        self.register_buffer("mean", torch.tensor(IMAGENET_MEAN).view(3, 1, 1), persistent=False)
        self.register_buffer("std", torch.tensor(IMAGENET_STD).view(3, 1, 1), persistent=False)

    def forward(self, images: Tensor) -> Tensor:
        """`(B, 3, 224, 224)` uint8 -> `(B, 2, 2)`: (pick, place) x (x, y), metres."""
        x = (images.float() / 255 - self.mean) / self.std
        return torch.stack([self.pick(x), self.place(x)], dim=1)


class RegressionPolicy(LearnedPolicy):
    """Picks and places at yaw 0: the published network predicts none."""

    name = "regression"
    network: RegressionNet

    def __init__(
        self,
        network: RegressionNet,
        picture_size: tuple[int, int],
        cell: int,
        goal_style: DrawnStyle,
        goal_color: tuple[int, int, int],
    ) -> None:
        """Goals are drawn in the style and colour (RGB) it was trained with, whatever is asked."""
        super().__init__(network, picture_size, cell)
        self.goal_input = GoalInput("painted", goal_style, goal_color)

    def model_config(self) -> dict[str, Any]:
        """How goals are drawn, and what the network normalises by where that is not as published."""
        own = {} if self.network.statistics == "running" else {"statistics": self.network.statistics}
        return {"goal_style": self.goal_input.style, "goal_color": list(self.goal_input.color), **own}

    @classmethod
    def build(cls, model: Mapping[str, Any], picture_size: tuple[int, int], cell: int) -> Self:
        """The policy with an untrained network."""
        drawn = regression_plan.goal_input(model)
        network = RegressionNet(model.get("statistics", "running"))
        return cls(network, picture_size, cell, drawn.style, drawn.color)

    def painted(self, picture: Image, goal: Goal) -> Image:
        """A picture at its trained size and its goal -> `(224, 224, 3)` uint8 with the goal painted in it."""
        return regression_plan.network_input(self.goal_input, picture, goal).transpose(1, 2, 0)

    def plan(self, observation: Observation, goal: Goal | None = None) -> Plan:
        """Pick and place positions; see `regression_plan.plan`, whose errors it raises."""
        return regression_plan.plan(
            self.read,
            self.goal_input,
            self.picture_size,
            observation,
            marked(goal),
            camera_size=self.camera_size,
        )

    def read(self, images: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Run the network; see `regression_plan.Read`."""
        self.network.eval()
        with torch.inference_mode():
            found: Tensor = self.network(torch.from_numpy(images).to(self.device))
        return np.asarray(found.cpu().numpy())
