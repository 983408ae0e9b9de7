"""The training loop of every policy that learns, and the recipe that makes batches and says what is minimised.

Batches are prefetched in threads. A kill costs what was learned since the last save, and nothing else.
"""

from __future__ import annotations

import copy
import io
import os
import signal
import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any, ClassVar, Self, TypeVar

import numpy as np
import torch
from accelerate import Accelerator
from torch import Tensor, nn
from torch.optim import Optimizer
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn
from torch.utils.tensorboard import SummaryWriter

from baggie.errors import DataError
from baggie.learning.split import Split
from baggie.operator import Operator, progress
from baggie.policies.checkpoint import write_files
from baggie.policies.learned import LearnedPolicy
from baggie.types import Attempt

T = TypeVar("T")


def prefetched(make: Callable[[int], T], steps: range, workers: int = 1, ahead: int = 4) -> Iterator[T]:
    """`make(step)` for each step in order, made in threads of their own up to `ahead` steps early for each."""
    ahead *= workers
    with ThreadPoolExecutor(workers, "prefetch") as pool:
        coming = deque(pool.submit(make, step) for step in steps[:ahead])
        try:
            for step in steps:
                if step + ahead in steps:
                    coming.append(pool.submit(make, step + ahead))
                yield coming.popleft().result()
        finally:
            for future in coming:
                future.cancel()


@contextmanager
def deferred_interrupt() -> Iterator[threading.Event]:
    """Ctrl-C sets the event instead of breaking a step in half; a second one breaks. Main thread only."""
    asked = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield asked
        return

    def ask(number: int, frame: FrameType | None) -> None:
        asked.set()
        signal.signal(signal.SIGINT, before)

    before = signal.signal(signal.SIGINT, ask)
    try:
        yield asked
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def flushed_denormals() -> Iterator[None]:
    """Numbers below 1e-38 count as zero: a saturated softmax is full of them, and a CPU a hundred times
    slower.
    """
    torch.set_flush_denormal(True)
    try:
        yield
    finally:
        torch.set_flush_denormal(False)


Batch = dict[str, Tensor]


class Recipe(ABC):
    """One way to teach one kind of policy. It is made with the attempts it teaches from."""

    policy: LearnedPolicy
    """The policy being taught; its network is what changes."""
    steps: int
    """Batches, unless told otherwise."""
    steps_before: int | None = None
    """Batches of older versions, where those were other ones: their trainings go on."""
    symmetry: int | None = None
    """How often a turn what is moved looks the same, where the attempts are not to be asked for it."""
    average: ClassVar[bool]
    """Whether the exponential moving average of the weights is what is kept, rather than the last ones."""
    max_gradient: ClassVar[float | None]
    """The norm gradients are clipped to."""

    @classmethod
    @abstractmethod
    def of(cls, options: Any, attempts: Sequence[Attempt]) -> Self:
        """The recipe that a command asks for by `options`, its policy's own (`baggie.options.training`).

        Raises `BaggieError` for attempts that cannot be learned from.
        """

    @classmethod
    def split(cls, attempts: Sequence[Attempt], train: int | None, val: int | None) -> Split:
        """Which of a recording's attempts teach, and which measure; how many of each, where somebody said so."""
        return Split.of(attempts, train, val)

    def chosen(self) -> dict[str, Any]:
        """What decides the result and does not stand in the policy's own config, by name; None where nobody chose."""
        return {}

    def note(self) -> str:
        """What a person should know before it begins; empty for nothing."""
        return ""

    @abstractmethod
    def optimizer(self) -> Optimizer:
        """Over the network's parameters."""

    @abstractmethod
    def rate(self, progress: float) -> float:
        """The learning rate relative to its highest, at `progress` in [0, 1) of the training."""

    @abstractmethod
    def batch(self, rng: np.random.Generator) -> Batch:
        """Tensors on the CPU. The same generator gives the same batch; called from a thread of its own."""

    @abstractmethod
    def loss(self, network: nn.Module, batch: Batch) -> tuple[Tensor, dict[str, Tensor]]:
        """What is minimised, and its parts by name with their units, detached, for the log."""

    def finish(self, policy: LearnedPolicy, val: Sequence[Attempt]) -> dict[str, Any]:
        """What is left to do with the trained policy, given attempts it did not learn from; what its metrics say."""
        return {}


FILE = "resume.pt"


@dataclass
class TrainingState:
    """All that changes during a training. Random numbers are none of it: every batch follows from seed and
    step.
    """

    network: nn.Module
    optimizer: Optimizer
    average: AveragedModel | None
    where: str = "cpu"
    """What computes: going on elsewhere would be another training."""
    step: int = 0
    seconds: float = 0.0
    """Spent in training so far, over all runs."""

    def save(self, folder: Path) -> None:
        """Write `resume.pt`, complete or not at all. Raises `DataError`."""
        stream = io.BytesIO()
        content = {"step": self.step, "seconds": self.seconds, "where": self.where}
        torch.save(content | {name: part.state_dict() for name, part in self._parts().items()}, stream)
        write_files(folder, {FILE: stream.getvalue()})

    def load(self, folder: Path) -> None:
        """Take over what `save` wrote; without a file, nothing.

        Raises `DataError` when it is damaged, or was written elsewhere than `where`.
        """
        path = folder / FILE
        if not path.exists():
            return
        try:
            content = torch.load(path, map_location="cpu", weights_only=True)
            for name, part in self._parts().items():
                part.load_state_dict(content[name])
            self.step, self.seconds = int(content["step"]), float(content["seconds"])
            where = str(content.get("where", self.where))  # older versions did not say
        except Exception as error:  # a damaged pickle or zip raises nearly anything
            raise DataError(
                f"{path} cannot be read ({type(error).__name__}): delete {folder} and train again"
            ) from None
        if where != self.where:
            raise DataError(
                f"the training in {folder} was begun on {where}, not on {self.where}: go on there, or give another "
                "--out"
            )

    def _parts(self) -> dict[str, nn.Module | Optimizer]:
        parts: dict[str, nn.Module | Optimizer] = {"network": self.network, "optimizer": self.optimizer}
        return parts if self.average is None else parts | {"average": self.average}


class Throttle:
    """True once every so many seconds."""

    def __init__(self, seconds: float) -> None:
        self._seconds = seconds
        self._last = time.monotonic()

    def __call__(self) -> bool:
        """Whether it is time again."""
        now = time.monotonic()
        if now - self._last < self._seconds:
            return False
        self._last = now
        return True


_LOGGED = 200
"""Points in a loss curve."""
_MEASURED = 10
"""Looks at the validation attempts on the way: to be seen, never to choose by."""


class TrainingLoop:
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
        operator: Operator,
    ) -> None:
        """Take up what is saved in the folder, if anything is. Raises `DataError` when that is damaged.

        `operator` is told how far it is.
        """
        self.recipe, self.folder, self.steps, self.seed = recipe, folder, steps, seed
        self._accelerator, self._operator = accelerator, operator
        network = recipe.policy.network.to(accelerator.device)
        optimizer = recipe.optimizer()
        self._rates = [float(group["lr"]) for group in optimizer.param_groups]
        average = None
        if recipe.average:
            average = AveragedModel(network, multi_avg_fn=_averaging(steps), use_buffers=True)
        where = f"{accelerator.device.type} with {accelerator.num_processes} processes"
        self._state = TrainingState(network, optimizer, average, where)
        self._state.load(folder)
        self._model, self._optimizer = accelerator.prepare(network, optimizer)
        self._save_now = Throttle(save_every_s)
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
            progress(self._operator, f"training {self.policy.name}", self.steps, state.step) as advance,
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
