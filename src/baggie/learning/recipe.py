"""What the training loop needs to know of a policy: how batches are made and what is minimised."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, Protocol

import numpy as np
from torch import Tensor, nn
from torch.optim import Optimizer

from baggie.policies.learned import LearnedPolicy
from baggie.types import Attempt

Batch = dict[str, Tensor]


class Recipe(Protocol):
    """One way to teach one kind of policy. It is made with the attempts it teaches from."""

    average: ClassVar[bool]
    """Whether the exponential moving average of the weights is what is kept, rather than the last ones."""
    max_gradient: ClassVar[float | None]
    """The norm gradients are clipped to."""

    @property
    def steps(self) -> int:
        """Batches, unless told otherwise."""
        ...

    @property
    def policy(self) -> LearnedPolicy:
        """The policy being taught; its network is what changes."""
        ...

    def optimizer(self) -> Optimizer:
        """Over the network's parameters."""
        ...

    def rate(self, progress: float) -> float:
        """The learning rate relative to its highest, at `progress` in [0, 1) of the training."""
        ...

    def batch(self, rng: np.random.Generator) -> Batch:
        """Tensors on the CPU. The same generator gives the same batch; called from a thread of its own."""
        ...

    def loss(self, network: nn.Module, batch: Batch) -> tuple[Tensor, dict[str, Tensor]]:
        """What is minimised, and its parts by name with their units, detached, for the log."""
        ...

    def finish(self, policy: LearnedPolicy, val: Sequence[Attempt]) -> dict[str, Any]:
        """What is left to do with the trained policy, given attempts it did not learn from; what its metrics say."""
        ...
