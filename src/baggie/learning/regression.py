"""How the `regression` policy is taught: exactly as published."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, Self

import numpy as np
import torch
from torch import Tensor, nn
from torch.optim import Adam, Optimizer

from baggie.data.summary import goal_of
from baggie.learning.loop import Batch, Recipe
from baggie.options.training import RegressionTraining
from baggie.options.values import DrawnStyle, Statistics
from baggie.policies.regression import RegressionNet, RegressionPolicy, load_imagenet
from baggie.types import Attempt


class RegressionRecipe(Recipe):
    """L1 on metres, Adam at 1e-4, one picture a step; both networks learn side by side."""

    steps = 10_000
    average: ClassVar[bool] = False
    max_gradient: ClassVar[float | None] = None
    policy: RegressionPolicy

    def __init__(
        self,
        attempts: Sequence[Attempt],
        goal_style: DrawnStyle,
        goal_color: tuple[int, int, int],
        weights: str | None,
        statistics: Statistics = "running",
    ) -> None:
        """`weights`: see `load_imagenet`; raises its errors."""
        # In this layout of memory convolutions of one picture take half the time on a CPU; the numbers are the same.
        network = RegressionNet(statistics)
        network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]  # stubs forget it
        if weights is not None:
            imagenet = load_imagenet(weights)
            network.pick.resnet.load_state_dict(imagenet)
            network.place.resnet.load_state_dict(imagenet)
        first = attempts[0]
        self.policy = RegressionPolicy(network, first.before.size, first.cell, goal_style, goal_color)
        self._weights = weights
        # Nothing is drawn at random but which attempt it is, so every batch there can be is made once, here.
        self._batches = [self._batch(attempt) for attempt in attempts]

    @classmethod
    def of(cls, options: RegressionTraining, attempts: Sequence[Attempt]) -> Self:
        """The recipe that a command asks for. Raises `DataError` for weights that cannot be used."""
        return cls(attempts, options.goal_style, options.goal_color, options.weights, options.statistics)

    def chosen(self) -> dict[str, Any]:
        """Which weights it starts from."""
        return {"weights": self._weights}

    def optimizer(self) -> Optimizer:
        """Adam over both networks: as it treats every number alone, the same as one for each.

        Fused, because over 24 million numbers it otherwise takes as long as the forward pass.
        """
        return Adam(self.policy.network.parameters(), lr=1e-4, fused=True)

    def rate(self, progress: float) -> float:
        """Keep the learning rate as it is."""
        return 1.0

    def batch(self, rng: np.random.Generator) -> Batch:
        """`images` `(1, 3, 224, 224)` uint8 with the goal painted in, `xy` `(1, 2, 2)` metres."""
        return self._batches[int(rng.integers(len(self._batches)))]

    def _batch(self, attempt: Attempt) -> Batch:
        image = self.policy.painted(attempt.before.color, goal_of(attempt))
        executed = attempt.outcome.executed
        xy = np.stack([executed.pick.xy, executed.place.xy])
        return {
            "images": torch.from_numpy(image.transpose(2, 0, 1).copy()).unsqueeze(0),
            "xy": torch.from_numpy(xy).float().unsqueeze(0),
        }

    def loss(self, network: nn.Module, batch: Batch) -> tuple[Tensor, dict[str, Tensor]]:
        """The sum of both networks' mean absolute errors, metres: each gets the gradient of its own."""
        found: Tensor = network(batch["images"])
        off = (found - batch["xy"]).abs().mean(dim=(0, 2))
        error_cm = 100 * torch.linalg.vector_norm((found - batch["xy"]).detach(), dim=-1).mean(dim=0)
        return off.sum(), {"pick_error_cm": error_cm[0], "place_error_cm": error_cm[1]}
