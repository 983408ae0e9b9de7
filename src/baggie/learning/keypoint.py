"""How the `keypoint` policy is taught: warped pictures, exchanged goals, labels in robot coordinates."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import cv2
import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F
from torch.optim import AdamW, Optimizer

from baggie.data.annotation import goal_of
from baggie.data.appearance import object_mask, random_look, turned, without_object
from baggie.data.augmentation import WarpRange, random_light, random_warp
from baggie.geometry import FloatArray, apply_homography
from baggie.learning.certainty import calibrate
from baggie.learning.labels import Labels
from baggie.learning.recipe import Batch
from baggie.policies import phase
from baggie.policies.features import Backbone, ResNetFeatures
from baggie.policies.keypoint import KeypointPolicy
from baggie.policies.keypoint_net import KeypointNet, Keypoints, phases_under
from baggie.policies.keypoint_plan import CELLS_TO_INPUT, GoalInput
from baggie.policies.learned import LearnedPolicy
from baggie.policies.resnet import load_imagenet
from baggie.policies.soft_argmax import gaussians
from baggie.policies.view import View
from baggie.types import Attempt, Goal, Image

_BATCH = 8
_RATE = 3e-3
_MAP_RATE = 1e-4
"""The map starts from a least-squares fit and only follows."""
_WARM_UP = 0.06
"""Of the training."""
_ROUND_CM = 0.5
"""Errors below this count squared: labels are no better."""
_SPREAD_CELLS = 1.5
_YAW_WEIGHT = 1.0
_TURNED = 0.5
"""The share of objects that are turned on the spot, by up to a quarter turn either way."""
_APART = 0.75
"""Of the sum of their sizes: a painted goal nearer than this to the object would hide it."""


@dataclass(frozen=True)
class KeypointOptions:
    """What can be chosen about a `keypoint` policy and its training."""

    backbone: Backbone = "small"
    weights: str | None = None
    """Published ResNet-18 weights to start from: a file or a Hub id."""
    goal_input: GoalInput = field(default_factory=GoalInput)
    new_looks: float = 0.25
    """The share of pictures that are given another cloth, table and clutter."""
    warps: WarpRange = field(default_factory=WarpRange)
    fuse_labels: bool = True


class KeypointRecipe:
    """Calibration-free augmentation: f finds a point in a warped picture A·I, g maps points, and g(A⁻¹ f(A·I)) = label.

    Two more things make 200 attempts go far. Any attempt's goal, with its release pose, can be the goal in any other's
    picture: 40,000 combinations, none to be learned by heart. And g is first fitted by least squares to all that the
    labels agree on, so that the network has only to learn to see.
    """

    steps: ClassVar[int] = 800
    average: ClassVar[bool] = True
    max_gradient: ClassVar[float | None] = 5.0
    network_class: ClassVar[type[KeypointNet]] = KeypointNet
    heat_weight: ClassVar[float] = 0.2
    """Of the heat maps' cross-entropy, nats, against position errors of half a centimetre."""
    policy: KeypointPolicy

    def __init__(self, attempts: Sequence[Attempt], options: KeypointOptions | None = None) -> None:
        """Cut the pictures to the view, fuse the labels, fit the map.

        Raises `DataError` when the goals are too few or in one line, or the weights cannot be used.
        """
        self.options = options or KeypointOptions()
        goals = [goal_of(attempt) for attempt in attempts]
        boxes = np.concatenate(
            [[attempt.box_before for attempt in attempts], [goal.corners for goal in goals]]
        )
        seen = boxes[np.isfinite(boxes).all(axis=(1, 2))].reshape(-1, 2)
        view = View.around(seen, attempts[0].before.size)
        network = self._network()
        self.policy = KeypointPolicy(network, view, attempts[0].cell, self.options.goal_input)
        self._pictures = np.stack([view.cut(attempt.before.color) for attempt in attempts])
        boxes_before = [view.to_input(attempt.box_before) for attempt in attempts]
        self._masks = [
            object_mask(picture, box) if np.isfinite(box).all() else None
            for picture, box in zip(self._pictures, boxes_before, strict=True)
        ]
        self._tables = [
            None if mask is None else without_object(picture, mask)
            for picture, mask in zip(self._pictures, self._masks, strict=True)
        ]
        self._goals = [view.goal_to_input(goal) for goal in goals]
        self.labels = Labels.of(attempts, view, network.to_robot, self.options.fuse_labels)
        with torch.no_grad():
            normalized = network.to_robot.inverse(torch.from_numpy(self.labels.xy).float())
            # The view is scaled and cut, so that directions in it are those in the picture, but for its two scales.
            jacobian = network.to_robot.jacobian(normalized[:, 0]).double().numpy()
        points = normalized.double().numpy()
        self._from_input = view.normalize() @ view.from_input()
        self._jacobian = jacobian @ self._from_input[:2, :2]
        """`(N, 2, 2)`: d (x, y) / d (u, v) at the picks, metres per pixel of the input."""
        in_input = apply_homography(np.linalg.inv(self._from_input), points.reshape(-1, 2))
        self._points: FloatArray = in_input.reshape(-1, 2, 2)
        """`(N, 2, 2)`: about where pick and place labels are in the input, pixels."""

    def _network(self) -> KeypointNet:
        options = self.options
        network = self.network_class(channels=options.goal_input.channels, backbone=options.backbone)
        if options.weights is not None:
            assert isinstance(network.features, ResNetFeatures)
            network.features.load_imagenet(load_imagenet(options.weights))
        return network

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
        """Inputs `images` `(B, C, H, W)` uint8 and `to_picture` `(B, 3, 3)`; labels `xy` `(B, 2, 2)` with `weight`
        `(B, 2)`, `yaw` of the pick `(B,)` with `yaw_weight` `(B,)`, `long` `(B,)`; and about where the labels are in
        the heat maps, `cells` `(B, 2, 2)`.
        """
        count = len(self._pictures)
        pick_from, place_from = rng.integers(0, count, _BATCH), rng.integers(0, count, _BATCH)
        place_from = np.array([self._not_hidden(i, j) for i, j in zip(pick_from, place_from, strict=True)])
        samples = [self._warped(rng, i, j) for i, j in zip(pick_from, place_from, strict=True)]
        images, to_picture, cells, yaw = zip(*samples, strict=True)
        labels = self.labels
        numbers = {
            "to_picture": np.stack(to_picture),
            "cells": np.stack(cells),
            "xy": np.stack([labels.xy[pick_from, 0], labels.xy[place_from, 1]], axis=1),
            "weight": np.stack([labels.weight[pick_from, 0], labels.weight[place_from, 1]], axis=1),
            "yaw": np.array(yaw),
            "yaw_weight": labels.yaw_weight[pick_from],
            "long": labels.long[pick_from],
        }
        tensors = {name: torch.from_numpy(array).float() for name, array in numbers.items()}
        return {"images": torch.from_numpy(np.stack(images)), **tensors}

    def _not_hidden(self, pick_from: int, place_from: int) -> int:
        """Whose goal to use: `place_from`'s, unless it is painted and would hide the object; then the attempt's own."""
        if self.options.goal_input.kind == "region":
            return place_from
        goal = self._goals[place_from].corners
        distance = np.linalg.norm(goal.mean(axis=0) - self._points[pick_from, 0])
        return place_from if distance > 2 * _APART * np.ptp(goal, axis=0).max() else pick_from

    def _warped(
        self, rng: np.random.Generator, pick_from: int, place_from: int
    ) -> tuple[Image, FloatArray, FloatArray, float]:
        """One picture with another's goal, warped: input, its cells to the normalised picture, points in cells, yaw."""
        size, goal_input = self.policy.view.size, self.options.goal_input
        points = np.stack([self._points[pick_from, 0], self._points[place_from, 1]])
        goal = self._goals[place_from]
        warp = random_warp(rng, size, points, self.options.warps)
        picture, mask, table = self._pictures[pick_from], self._masks[pick_from], self._tables[pick_from]
        yaw = float(self.labels.yaw[pick_from])
        if mask is not None and table is not None and rng.random() < _TURNED:
            angle = rng.uniform(-math.pi / 2, math.pi / 2)
            picture, mask = turned(picture, table, mask, points[0], angle)
            yaw = _turned_yaw(yaw, angle, self._jacobian[pick_from])
        if mask is not None and rng.random() < self.options.new_looks:
            picture = random_look(rng, picture, mask)
        if (
            goal_input.kind == "painted"
        ):  # before light and warp, which change a card as they change the table
            picture = goal_input.network_input(picture, goal).transpose(1, 2, 0)
        picture = cv2.LUT(picture, random_light(rng)[:, None])
        warped = cv2.warpPerspective(
            picture, warp, size, flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        image = np.asarray(warped.transpose(2, 0, 1), np.uint8)
        if goal_input.kind == "region":
            # The goal's corners are warped rather than its mask: as sharp as in a picture that is not.
            moved = Goal(apply_homography(warp, goal.corners))
            image = goal_input.network_input(np.asarray(warped, np.uint8), moved)
        to_picture = self._from_input @ np.linalg.inv(warp) @ CELLS_TO_INPUT
        cells = apply_homography(np.linalg.inv(CELLS_TO_INPUT) @ warp, points)
        return image, to_picture / to_picture[2, 2], cells, yaw

    def loss(self, network: nn.Module, batch: Batch) -> tuple[Tensor, dict[str, Tensor]]:
        """Huber's loss on centimetres, cross-entropy to a round heat map, squared distances of phases."""
        found: Keypoints = network(batch["images"], batch["to_picture"])
        error_cm = 100 * torch.linalg.vector_norm(found.xy - batch["xy"] + 1e-8, dim=-1)
        position = F.huber_loss(error_cm, torch.zeros_like(error_cm), reduction="none", delta=_ROUND_CM)
        position = (batch["weight"] * position).mean() / _ROUND_CM
        target = gaussians(batch["cells"], _SPREAD_CELLS, *found.logits.shape[-2:])
        heat = -(target * found.log_heat()).sum(dim=(-2, -1)).mean()
        # Read where the object is and not where the network thinks so: at first that is everywhere.
        yaw = _phase_loss(phases_under(target[:, :1], found.field), found.jacobian[:, 0].detach(), batch)
        parts = {
            "pick_error_cm": error_cm[:, 0].mean(),
            "place_error_cm": error_cm[:, 1].mean(),
            "heat_map_nats": heat,
            "phase": yaw,
        }
        total = position + self.heat_weight * heat + _YAW_WEIGHT * yaw
        return total, {name: part.detach() for name, part in parts.items()}

    def finish(self, policy: LearnedPolicy, val: Sequence[Attempt]) -> dict[str, Any]:
        """Measure on held-out attempts how sure the policy may be; what there is to know about the labels."""
        assert isinstance(policy, KeypointPolicy)
        labels = self.labels
        doubtful = [{"attempt_id": d.attempt_id, "what": d.what, "off_mm": d.off_mm} for d in labels.doubts]
        return {
            "radius_times_spread": calibrate(
                policy, val, labels.disagreement, opinions=2 if labels.pairs else 1
            ),
            "labels_fused": {
                "pictures_with_two_opinions": labels.pairs,
                "systematic_mm": 1000 * labels.systematic_m,
                "doubtful": doubtful,
            },
        }


def _turned_yaw(yaw: float, angle: float, jacobian: FloatArray) -> float:
    """The yaw on the table, radians, of what is turned in the picture by `angle`; `jacobian` from picture to table."""
    c, s = math.cos(angle), math.sin(angle)
    direction = np.linalg.solve(jacobian, [math.cos(yaw), math.sin(yaw)])
    x, y = jacobian @ np.array([[c, -s], [s, c]]) @ direction
    return math.atan2(y, x)


def _phase_loss(found: Tensor, jacobian: Tensor, batch: Batch) -> Tensor:
    """Squared distances of both phases `(B, 2, 2)`; that of a long thing is of no length where the thing is square."""
    square = phase.phase_of(batch["yaw"], jacobian, phase.SQUARE)
    long = phase.phase_of(batch["yaw"], jacobian, phase.LONG) * batch["long"].unsqueeze(-1)
    off = (found - torch.stack([square, long], dim=1)).square().sum(dim=(1, 2))
    return (batch["yaw_weight"] * off).mean()
