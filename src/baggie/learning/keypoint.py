"""How the `keypoint` policy is taught: warped pictures, exchanged goals, labels in robot coordinates.

How sure it may be, in metres, is measured on attempts it did not learn from.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Self

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional as F
from torch.optim import AdamW, Optimizer

from baggie.data.summary import goal_of
from baggie.errors import BaggieError
from baggie.geometry import FloatArray
from baggie.learning.loop import Batch, Recipe
from baggie.learning.samples import SYSTEMATIC_M, Changes, Disagreement, Labels, Samples
from baggie.options.training import KeypointTraining
from baggie.options.values import Backbone
from baggie.policies.keypoint.heads import LONG, SQUARE, gaussians, phase_of
from baggie.policies.keypoint.policy import (
    KeypointNet,
    KeypointPolicy,
    Keypoints,
    ResNetFeatures,
    phases_under,
)
from baggie.policies.learned import LearnedPolicy
from baggie.policies.planning import ANYWHERE_CELLS, STACKED_CELLS, GoalInput, View
from baggie.policies.regression import load_imagenet
from baggie.types import Attempt

COVERAGE = 0.9
"""How often the truth is to be within the radius."""
SEEN_M = 0.001
"""How far the middle of what is seen of a soft object is from its own, another way in every picture.

A dent on one side moves the outline's middle, for the collector's detection and for the network alike."""
_FEWEST = 10
"""Attempts without which nothing is said: a 90% radius needs at least nine."""


def calibrate_radii(
    policy: KeypointPolicy, attempts: Sequence[Attempt], disagreement: Disagreement, opinions: int
) -> list[float] | None:
    """Set how many times the heat maps' spread the stated radii are, of pick and place, from held-out attempts.

    `opinions`: how many kinds of label there were to learn from, 1 or 2.

    Split conformal prediction: with errors over spreads e₁..eₙ of held-out attempts, the ⌈0.9 (n + 1)⌉-th smallest
    holds that of a new one at least nine times of ten, whatever their distribution. Source: H. Papadopoulos et al.,
    "Inductive confidence machines for regression", ECML 2002. None, and plans without radii, when there are fewer than
    ten.

    Picks are compared with labels half-way between the two opinions there are, as those it learned from. What both have
    wrong alike no held-out label shows, and how far they are apart says nothing of it: of two independent errors the
    mean does not depend on the difference. Each kind of label may be off by `SYSTEMATIC_M`, so their mean by that over
    √2, and what is seen by `SEEN_M`; √(ln 10) times both in quadrature holds 90% of a round normal distribution, and is
    added in quadrature.
    """
    radius = policy.network.radius
    radius.floor_m.zero_()
    radius.times_spread.fill_(1.0)
    ratios = [ratio for attempt in attempts if (ratio := _ratios(policy, attempt, disagreement)) is not None]
    if len(ratios) < _FEWEST:
        radius.times_spread.zero_()
        return None
    rank = min(math.ceil(COVERAGE * (len(ratios) + 1)), len(ratios))
    found = np.sort(np.array(ratios), axis=0)[rank - 1]
    radius.times_spread.copy_(torch.from_numpy(found))
    hidden = math.hypot(SYSTEMATIC_M / math.sqrt(opinions), SEEN_M)
    radius.floor_m[0] = math.sqrt(-math.log(1 - COVERAGE)) * hidden
    return [float(value) for value in found]


def _ratios(policy: KeypointPolicy, attempt: Attempt, disagreement: Disagreement) -> FloatArray | None:
    """`(2,)`: errors of pick and place against their labels over the heat maps' spread; None without a plan."""
    try:
        plan = policy.plan(attempt.before, goal_of(attempt))
    except BaggieError:
        return None
    executed, planned = attempt.outcome.executed, plan.action
    pick = executed.pick.xy + disagreement.at(executed.pick.xy[None])[0] / 2
    errors = [float(np.linalg.norm(planned.pick.xy - pick)), planned.place.distance(executed.place)]
    assert plan.pick_within_m is not None
    assert plan.place_within_m is not None
    return np.array(errors) / [plan.pick_within_m, plan.place_within_m]


IntArray = NDArray[np.int64]

_BATCH = 8
_RATE = 3e-3
_MAP_RATE = 1e-4
"""The map starts from a least-squares fit and only follows."""
_WARM_UP = 0.06
"""Of the training."""
_ROUND_CM = 0.5
"""Errors below this count squared: labels are no better."""
_BESIDE_CELLS = 2.0
"""As far from an object's middle, either way along both axes, somebody may point at it."""
_SPREAD_CELLS = 1.5
_YAW_WEIGHT = 1.0


@dataclass(frozen=True)
class KeypointOptions:
    """What can be chosen about a `keypoint` policy and its training."""

    backbone: Backbone = "small"
    weights: str | None = None
    """Published ResNet-18 weights to start from: a file or a Hub id."""
    goal_input: GoalInput = field(default_factory=GoalInput)
    changes: Changes = field(default_factory=Changes)
    fuse_labels: bool = True


class KeypointRecipe(Recipe):
    """Calibration-free augmentation: f finds a point in a warped picture A·I, g maps points, and g(A⁻¹ f(A·I)) = label.

    Two more things make 200 attempts go far. Any attempt's goal, with its release pose, can be the goal in any other's
    picture: 40,000 combinations, none to be learned by heart. And g is first fitted by least squares to all that the
    labels agree on, so that the network has only to learn to see.
    """

    steps = 800
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
        self.labels = Labels.of(attempts, view, network.to_robot, self.options.fuse_labels)
        self.samples = Samples(attempts, self.labels, self.policy, self.options.changes)

    @classmethod
    def of(cls, options: KeypointTraining, attempts: Sequence[Attempt]) -> Self:
        """The recipe that a command asks for. Raises `DataError` as the class does."""
        goal_input = GoalInput(options.goal_input, options.goal_style, options.goal_color)
        changes = Changes(options.new_looks)
        return cls(attempts, KeypointOptions(options.backbone, options.weights, goal_input, changes))

    def chosen(self) -> dict[str, Any]:
        """Which weights it starts from, how many pictures are changed."""
        return {"weights": self.options.weights, "new_looks": self.options.changes.new_looks}

    def _network(self) -> KeypointNet:
        options = self.options
        network = self.network_class(channels=options.goal_input.channels, backbone=options.backbone)
        if options.weights is not None:
            assert isinstance(network.features, ResNetFeatures)
            network.features.load_imagenet(load_imagenet(options.weights))
        return network

    def optimizer(self) -> Optimizer:
        """Adam with decoupled weight decay; the map, as far as it is trained, has a low rate and no decay."""
        network = self.policy.network
        seeing = [p for name, p in network.named_parameters() if not name.startswith("to_robot.")]
        mapping = [p for p in network.to_robot.parameters() if p.requires_grad]
        groups = [
            {"params": seeing, "lr": _RATE, "weight_decay": 1e-2},
            {"params": mapping, "lr": _MAP_RATE, "weight_decay": 0.0},
        ]
        return AdamW(groups)

    def rate(self, progress: float) -> float:
        """A short warm-up, then half a cosine."""
        return min(1.0, (progress + 1e-3) / _WARM_UP) * (1 + math.cos(math.pi * progress)) / 2

    def batch(self, rng: np.random.Generator) -> Batch:
        """Inputs `images` `(B, C, H, W)` uint8 and `to_picture` `(B, 3, 3)`; labels `xy` `(B, 2, 2)` with `weight`
        `(B, 2)`, `yaw` of the pick `(B,)` with `yaw_weight` `(B,)`, lengths of its `phases` `(B, 2)`; and about
        where the labels are in the heat maps, `cells` `(B, 2, 2)`. Where several objects lie about, two more inputs:
        `near` `(B, 3)`, where the one to be picked is pointed at, and `layers` `(B, 2)` of both places.
        """
        pick_from, place_from = self.pairs(rng)
        samples = [self.samples.draw(rng, i, j) for i, j in zip(pick_from, place_from, strict=True)]
        images, to_picture, cells, shapes = zip(*samples, strict=True)
        labels = self.labels
        numbers = {
            "to_picture": np.stack(to_picture),
            "cells": np.stack(cells),
            "xy": np.stack([labels.xy[pick_from, 0], labels.xy[place_from, 1]], axis=1),
            "weight": np.stack([labels.weight[pick_from, 0], labels.weight[place_from, 1]], axis=1),
            "yaw": np.array([shape.yaw for shape in shapes]),
            "yaw_weight": labels.yaw_weight[pick_from],
            "phases": np.array([shape.phases for shape in shapes]),
        }
        if labels.counted.any():
            pointed_at = numbers["cells"][:, 0] + rng.uniform(-_BESIDE_CELLS, _BESIDE_CELLS, (_BATCH, 2))
            within = np.where(labels.counted[pick_from], STACKED_CELLS, ANYWHERE_CELLS)
            numbers |= {
                "near": np.column_stack([pointed_at, within]),
                "layers": np.stack([labels.layers[pick_from, 0], labels.layers[place_from, 1]], axis=1),
            }
        tensors = {name: torch.from_numpy(array).float() for name, array in numbers.items()}
        return {"images": torch.from_numpy(np.stack(images)), **tensors}

    def pairs(self, rng: np.random.Generator) -> tuple[IntArray, IntArray]:
        """Whose pictures, and whose goals to put into them, `(B,)` each: of any two, where the goal hides no bag."""
        count = len(self.samples)
        pick_from, place_from = rng.integers(0, count, _BATCH), rng.integers(0, count, _BATCH)
        hidden = [self.samples.hides(i, j) for i, j in zip(pick_from, place_from, strict=True)]
        return pick_from, np.where(hidden, pick_from, place_from)

    def loss(self, network: nn.Module, batch: Batch) -> tuple[Tensor, dict[str, Tensor]]:
        """Huber's loss on centimetres, cross-entropy to a round heat map, squared distances of phases.

        Where several objects lie about, the pick is read near the one that was picked, as if it were pointed at; its
        heat map is judged as a whole, so that its peak is at one that can be picked.
        """
        found: Keypoints = network(
            batch["images"], batch["to_picture"], batch.get("near"), batch.get("layers")
        )
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
        doubtful = [{"attempt_id": d.attempt_id, "what": d.what, "off_mm": d.off_mm} for d in labels.outliers]
        return {
            "radius_times_spread": calibrate_radii(
                policy, val, labels.disagreement, opinions=2 if labels.pairs else 1
            ),
            "labels_fused": {
                "pictures_with_two_opinions": labels.pairs,
                "systematic_mm": 1000 * labels.systematic_m,
                "doubtful": doubtful,
            },
        }


def _phase_loss(found: Tensor, jacobian: Tensor, batch: Batch) -> Tensor:
    """Squared distances of both phases `(B, 2, 2)`; that of a long thing is of no length where the thing is square, and
    both where it is round.
    """
    square = phase_of(batch["yaw"], jacobian, SQUARE)
    long = phase_of(batch["yaw"], jacobian, LONG)
    wanted = batch["phases"].unsqueeze(-1) * torch.stack([square, long], dim=1)
    off = (found - wanted).square().sum(dim=(1, 2))
    return (batch["yaw_weight"] * off).mean()
