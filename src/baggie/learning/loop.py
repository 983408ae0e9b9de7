"""The training loop: one for every policy that learns."""

from __future__ import annotations

import copy
import os
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from accelerate import Accelerator
from torch import Tensor
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn
from torch.utils.tensorboard import SummaryWriter

from baggie.learning.background import deferred_interrupt, flushed_denormals, prefetched
from baggie.learning.recipe import Batch, Recipe
from baggie.learning.state import Every, State
from baggie.policies.learned import LearnedPolicy
from baggie.progress import progress_bar

_LOGGED = 200
"""Points in a loss curve."""
_MEASURED = 10
"""Looks at the validation attempts on the way: to be seen, never to choose by."""


class Training:
    """A recipe at work in a folder. `run` goes from the step last saved to the end and returns the seconds it
    took.
    """

    def __init__(
        self,
        recipe: Recipe,
        folder: Path,
        *,
        steps: int,
        seed: int,
        save_every_s: float,
        accelerator: Accelerator,
    ) -> None:
        """Take up what is saved in the folder, if anything is. Raises `DataError` when that is damaged."""
        self.recipe, self.folder, self.steps, self.seed = recipe, folder, steps, seed
        self._accelerator = accelerator
        network = recipe.policy.network.to(accelerator.device)
        optimizer = recipe.optimizer()
        self._rates = [float(group["lr"]) for group in optimizer.param_groups]
        average = None
        if recipe.average:
            average = AveragedModel(network, multi_avg_fn=_averaging(steps), use_buffers=True)
        where = f"{accelerator.device.type} with {accelerator.num_processes} processes"
        self._state = State(network, optimizer, average, where)
        self._state.load(folder)
        self._model, self._optimizer = accelerator.prepare(network, optimizer)
        self._save_now = Every(save_every_s)
        # A GPU takes batches faster than one core makes them; where a CPU learns, making them takes cores away from it.
        self._makers = 1 if accelerator.device.type == "cpu" else max(1, (os.cpu_count() or 1) // 2)

    @property
    def policy(self) -> LearnedPolicy:
        """The policy with the weights it would have if the training ended now."""
        policy = copy.copy(self.recipe.policy)
        policy.network = self._state.network if self._state.average is None else self._state.average.module
        return policy

    def run(self, judge: Callable[[LearnedPolicy], Mapping[str, Any]]) -> float:
        """Learn to the end; the seconds that took, over all runs. What `judge` says of the policy now and then, as
        `measure` does, is logged.

        Ctrl-C saves and raises KeyboardInterrupt, whose message says how to go on.
        """
        state = self._state
        with (
            SummaryWriter(str(self.folder), purge_step=state.step) as board,
            progress_bar(
                f"training {self.policy.name}",
                self.steps,
                state.step,
                shown=self._accelerator.is_main_process,
            ) as advance,
            deferred_interrupt() as interrupted,
            flushed_denormals(),
        ):
            began = time.monotonic() - state.seconds
            for batch in prefetched(self._batch, range(state.step, self.steps), self._makers):
                loss, parts = self._step(batch)
                state.seconds = time.monotonic() - began
                stopped = self._by_any(interrupted) and state.step < self.steps
                if self._accelerator.is_main_process:
                    logged = state.step % max(1, self.steps // _LOGGED) == 0
                    advance(f"loss {loss.item():.3f}" if logged else "")
                    if logged:
                        self._log(board, loss, parts)
                    if state.step % max(1, self.steps // _MEASURED) == 0:
                        self._log_validation(board, judge(self.policy))
                    if stopped or state.step == self.steps or self._save_now():
                        state.save(self.folder)
                if stopped:
                    self._accelerator.wait_for_everyone()  # a launcher may end the others as soon as one ends
                    raise KeyboardInterrupt(
                        f"stopped after {state.step} of {self.steps} steps, which are saved in "
                        f"{self.folder}: "
                        "run the same command again to go on"
                    )
        return state.seconds

    def _by_any(self, interrupted: threading.Event) -> bool:
        """Whether any of the processes was interrupted: all hear of it, and stop after the same step."""
        if self._accelerator.num_processes == 1:
            return interrupted.is_set()  # nobody to ask, which a GPU would have to stop for
        if interrupted.is_set():
            self._accelerator.set_trigger()
        return bool(self._accelerator.check_trigger())

    def _batch(self, step: int) -> Batch:
        return self.recipe.batch(np.random.default_rng([self.seed, step, self._accelerator.process_index]))

    def _step(self, batch: Batch) -> tuple[Tensor, dict[str, Tensor]]:
        self._model.train()
        rate = self.recipe.rate(self._state.step / self.steps)
        for group, highest in zip(self._optimizer.param_groups, self._rates, strict=True):
            group["lr"] = highest * rate
        moved = {name: tensor.to(self._accelerator.device) for name, tensor in batch.items()}
        loss, parts = self.recipe.loss(self._model, moved)
        self._accelerator.backward(loss)
        if self.recipe.max_gradient is not None:
            self._accelerator.clip_grad_norm_(self._model.parameters(), self.recipe.max_gradient)
        self._optimizer.step()
        self._optimizer.zero_grad()
        if self._state.average is not None:
            self._state.average.update_parameters(self._state.network)
        self._state.step += 1
        return loss.detach(), parts

    def _log(self, board: SummaryWriter, loss: Tensor, parts: dict[str, Tensor]) -> None:
        for name, value in {"loss": loss, **parts}.items():
            board.add_scalar(f"train/{name}", value.item(), self._state.step)

    def _log_validation(self, board: SummaryWriter, measured: Mapping[str, Any]) -> None:
        for name, values in measured.get("labels", {}).items():
            board.add_scalar(f"val/{name}", values["mean"], self._state.step)


Tensors = tuple[Tensor, ...] | list[Tensor]


def _averaging(steps: int) -> Callable[[Tensors, Tensors, Tensor | int], None]:
    """Exponential averaging over about the last 100 steps; fewer in a short training."""
    decay = min(0.99, steps / (steps + 10))
    average: Callable[[Tensors, Tensors, Tensor | int], None]
    average = get_ema_multi_avg_fn(decay)  # type: ignore[no-untyped-call]  # untyped in torch
    return average
