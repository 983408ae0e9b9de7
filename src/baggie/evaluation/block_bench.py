"""What an episode with blocks needs: a cell with a task, and the policy to try in it."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Protocol

from baggie.evaluation.options import EvaluateOptions
from baggie.evaluation.subjects import open_policy
from baggie.evaluation.turn import MovingCell
from baggie.policies import DemonstratorPolicy, OraclePolicy, Policy
from baggie.sim.tasks import Task
from baggie.types import Image, Observation


class Score(Protocol):
    """How much is done as Ravens counts."""

    @property
    def total(self) -> float:
        """1 for all of the task."""
        ...

    @property
    def done(self) -> bool:
        """Whether nothing is left that counts."""
        ...


class BlockCell(MovingCell, Protocol):
    """A workcell with a task, whose scenes can be set and which knows how much is done: a simulated one."""

    @property
    def task(self) -> Task: ...  # noqa: D102 -- a workcell's attributes

    @property
    def score(self) -> Score: ...  # noqa: D102

    def reset(self, seed: Sequence[int]) -> None:
        """A new scene, drawn from the random stream with this name."""
        ...

    def look(self) -> Observation:
        """The table from straight above, with heights, the arm out of the way."""
        ...

    def count(self) -> float:
        """What has been done of the task since the last call, all of it being 1; after every turn."""
        ...

    def strict_success(self) -> bool:
        """Whether all is done, with heights, each thing in a place of its own, and stays so for two seconds."""
        ...

    def film(self, size: tuple[int, int] = ..., fps: int = ...) -> AbstractContextManager[list[Image]]:
        """Frames of the arm at work while open."""
        ...


@dataclass(frozen=True)
class BlockBench:
    """A cell and the policy to try in it."""

    cell: BlockCell
    policy: Policy


def open_block_bench(options: EvaluateOptions) -> BlockBench:
    """The simulated workcell with the task, and the policy named; imported late, because MuJoCo takes its time."""
    from baggie.workcell.block_workcell import open_block_workcell  # noqa: PLC0415

    oracle = options.policy == OraclePolicy.name
    policy = None if oracle else open_policy(options.policy, None, options.device)
    cell = open_block_workcell(options.task, options.cell)
    return BlockBench(cell, policy or DemonstratorPolicy(cell.demonstrate))
