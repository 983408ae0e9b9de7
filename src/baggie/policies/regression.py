"""The published regressor: a ResNet-18 that turns a picture with the goal painted in it into two numbers.

It is the baseline to beat, kept as published: 7.8 cm off when picking, 5.8 cm when placing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Self

import cv2
import numpy as np
import torch
from torch import Tensor, nn

from baggie.geometry import PlanarPose
from baggie.policies.as_trained import as_trained
from baggie.policies.learned import LearnedPolicy
from baggie.policies.resnet import IMAGENET_MEAN, IMAGENET_STD, ResNet18
from baggie.types import Goal, GoalStyle, Image, Observation, PickPlace, Plan
from baggie.vision.draw import paint_goal

SIDE = 224
"""The network's input is this many pixels wide and high, whatever the shape of the picture."""


class Regressor(nn.Module):
    """ResNet-18 to its 1000 logits, then 1000-128-32-2 with ReLU: `(B, 3, 224, 224)` -> `(B, 2)` metres."""

    def __init__(self) -> None:
        super().__init__()
        self.resnet = ResNet18()
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

    def __init__(self) -> None:
        super().__init__()
        self.pick = Regressor()
        self.place = Regressor()
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
        goal_style: GoalStyle,
        goal_color: tuple[int, int, int],
    ) -> None:
        """Goals are drawn in the style and colour (RGB) it was trained with, whatever is asked."""
        super().__init__(network, picture_size, cell)
        self.goal_style = goal_style
        self.goal_color = goal_color

    def model_config(self) -> dict[str, Any]:
        """Nothing but how goals are drawn."""
        return {"goal_style": self.goal_style, "goal_color": list(self.goal_color)}

    @classmethod
    def build(cls, model: Mapping[str, Any], picture_size: tuple[int, int], cell: int) -> Self:
        """The policy with an untrained network."""
        red, green, blue = (int(value) for value in model["goal_color"])
        return cls(RegressionNet(), picture_size, cell, model["goal_style"], (red, green, blue))

    def painted(self, picture: Image, goal: Goal) -> Image:
        """A picture at its trained size and its goal -> the network's input `(224, 224, 3)` uint8."""
        small = np.asarray(cv2.resize(picture, (SIDE, SIDE), interpolation=cv2.INTER_AREA), np.uint8)
        height, width = picture.shape[:2]
        if goal.style != "card":  # which lies there already
            goal = replace(goal, style=self.goal_style, color=self.goal_color)
        return paint_goal(small, goal.scaled(SIDE / width, SIDE / height))

    def plan(self, observation: Observation, goal: Goal) -> Plan:
        """Pick and place positions; yaw 0 and confidence 1, as it has no word on either."""
        image = self.painted(*as_trained(observation, goal, self.picture_size))
        batch = torch.from_numpy(image.transpose(2, 0, 1).copy()).unsqueeze(0).to(self.device)
        self.network.eval()
        with torch.inference_mode():
            pick, place = self.network(batch)[0].cpu().double().numpy()
        return Plan(PickPlace(PlanarPose(*map(float, pick)), PlanarPose(*map(float, place))))
