"""How the `keypoint` policy is taught: warped pictures, exchanged goals, labels in robot coordinates."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import ClassVar

import cv2
import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F
from torch.optim import AdamW, Optimizer

from baggie.data.annotation import goal_of
from baggie.data.augmentation import random_light, random_warp
from baggie.geometry import FloatArray, apply_homography
from baggie.learning.recipe import Batch
from baggie.policies import phase
from baggie.policies.keypoint import CELLS_TO_INPUT, KeypointPolicy, network_input
from baggie.policies.keypoint_net import KeypointNet, Keypoints
from baggie.policies.soft_argmax import gaussians
from baggie.policies.view import View
from baggie.types import Attempt

_BATCH = 8
_RATE = 3e-3
_MAP_RATE = 1e-4
"""The map starts from a least-squares fit and only follows."""
_WARM_UP = 0.06
"""Of the training."""
_ROUND_CM = 0.5
"""Errors below this count squared: labels are no better."""
_SPREAD_CELLS = 1.5
_HEAT_WEIGHT = 0.2
_YAW_WEIGHT = 1.0


class KeypointRecipe:
    """Calibration-free augmentation: with f the point found in a warped picture A·I and g the map, g(A⁻¹
    f(A·I)) = label.

    Two more things make 200 attempts go far. Any attempt's goal, with its release pose, can be the goal in
    any other's picture: 40,000 combinations, none to be learned by heart. And g is first fitted by least
    squares to goals and release poses, so that the network has only to learn to see.
    """

    steps: ClassVar[int] = 600
    average: ClassVar[bool] = True
    max_gradient: ClassVar[float | None] = 5.0
    policy: KeypointPolicy

    def __init__(self, attempts: Sequence[Attempt]) -> None:
        """Cut the pictures to the view, fit the map. Raises `DataError` when the goals are too few or in one
        line.
        """
        goals = [goal_of(attempt) for attempt in attempts]
        boxes = np.concatenate(
            [[attempt.box_before for attempt in attempts], [goal.corners for goal in goals]]
        )
        seen = boxes[np.isfinite(boxes).all(axis=(1, 2))].reshape(-1, 2)
        view = View.around(seen, attempts[0].before.size)
        self.policy = KeypointPolicy(KeypointNet(), view, attempts[0].cell)
        self._pictures = np.stack([view.cut(attempt.before.color) for attempt in attempts])
        self._goals = [view.to_input(goal.corners) for goal in goals]
        executed = [attempt.outcome.executed for attempt in attempts]
        self._xy = np.array([(action.pick.xy, action.place.xy) for action in executed])
        self._yaw = np.array([action.pick.yaw for action in executed])
        centers = np.array([goal.center for goal in goals])
        to_robot = self.policy.network.to_robot
        to_robot.fit(apply_homography(view.normalize(), centers), self._xy[:, 1])
        with torch.no_grad():
            points = to_robot.inverse(torch.from_numpy(self._xy).float()).double().numpy()
        self._from_input = view.normalize() @ view.from_input()
        in_input = apply_homography(np.linalg.inv(self._from_input), points.reshape(-1, 2))
        self._points: FloatArray = in_input.reshape(-1, 2, 2)
        """`(N, 2, 2)`: about where pick and place labels are in the input, pixels."""

    def optimizer(self) -> Optimizer:
        """Adam with decoupled weight decay; the map has a low rate and no decay."""
        network = self.policy.network
        seeing = [p for name, p in network.named_parameters() if not name.startswith("to_robot.")]
        groups = [
            {"params": seeing, "lr": _RATE, "weight_decay": 1e-2},
            {"params": list(network.to_robot.parameters()), "lr": _MAP_RATE, "weight_decay": 0.0},
        ]
        return AdamW(groups)

    def rate(self, progress: float) -> float:
        """A short warm-up, then half a cosine."""
        return min(1.0, (progress + 1e-3) / _WARM_UP) * (1 + math.cos(math.pi * progress)) / 2

    def batch(self, rng: np.random.Generator) -> Batch:
        """`images` `(B, 4, H, W)` uint8, `to_picture` `(B, 3, 3)`; labels `xy` `(B, 2, 2)`, `yaw` `(B,)` of
        the pick, and about where they are in the heat maps, `cells` `(B, 2, 2)`.
        """
        count = len(self._pictures)
        pick_from, place_from = rng.integers(0, count, _BATCH), rng.integers(0, count, _BATCH)
        samples = [self._warped(rng, i, j) for i, j in zip(pick_from, place_from, strict=True)]
        images, to_picture, cells = zip(*samples, strict=True)
        return {
            "images": torch.from_numpy(np.stack(images)),
            "to_picture": torch.from_numpy(np.stack(to_picture)).float(),
            "cells": torch.from_numpy(np.stack(cells)).float(),
            "xy": torch.from_numpy(
                np.stack([self._xy[pick_from, 0], self._xy[place_from, 1]], axis=1)
            ).float(),
            "yaw": torch.from_numpy(self._yaw[pick_from]).float(),
        }

    def _warped(
        self, rng: np.random.Generator, pick_from: int, place_from: int
    ) -> tuple[np.ndarray, FloatArray, FloatArray]:
        """One picture with another's goal, warped: input, its cells to the normalised picture, points in
        cells.
        """
        size = self.policy.view.size
        points = np.stack([self._points[pick_from, 0], self._points[place_from, 1]])
        warp = random_warp(rng, size, points)
        picture = cv2.LUT(self._pictures[pick_from], random_light(rng)[:, None])
        warped = cv2.warpPerspective(
            picture, warp, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        # The goal's corners are warped rather than its mask: as sharp as in a picture that is not.
        image = network_input(np.asarray(warped, np.uint8), apply_homography(warp, self._goals[place_from]))
        to_picture = self._from_input @ np.linalg.inv(warp) @ CELLS_TO_INPUT
        cells = apply_homography(np.linalg.inv(CELLS_TO_INPUT) @ warp, points)
        return image, to_picture / to_picture[2, 2], cells

    def loss(self, network: nn.Module, batch: Batch) -> tuple[Tensor, dict[str, Tensor]]:
        """Huber's loss on centimetres, cross-entropy to a round heat map, squared distance of phases."""
        found: Keypoints = network(batch["images"], batch["to_picture"])
        error_cm = 100 * torch.linalg.vector_norm(found.xy - batch["xy"] + 1e-8, dim=-1)
        position = F.huber_loss(error_cm, torch.zeros_like(error_cm), delta=_ROUND_CM) / _ROUND_CM
        target = gaussians(batch["cells"], _SPREAD_CELLS, *found.log_heat.shape[-2:])
        heat = -(target * found.log_heat).sum(dim=(-2, -1)).mean()
        turned = phase.phase_of(batch["yaw"], found.jacobian.detach())
        yaw = (found.phase - turned).square().sum(dim=-1).mean()
        parts = {
            "pick_error_cm": error_cm[:, 0].mean(),
            "place_error_cm": error_cm[:, 1].mean(),
            "heat_map_nats": heat,
            "phase": yaw,
        }
        total = position + _HEAT_WEIGHT * heat + _YAW_WEIGHT * yaw
        return total, {name: part.detach() for name, part in parts.items()}
