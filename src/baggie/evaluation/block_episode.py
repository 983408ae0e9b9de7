"""One closed-loop episode of a task with blocks: look, plan, move, until it is done or its steps are used up.

The closed loop with blocks: tasks of several steps, scored as Ravens does and strictly.
"""

from __future__ import annotations

import contextlib
import time
from collections import Counter
from collections.abc import Iterable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, Self

import numpy as np

from baggie.evaluation.episode import EpisodeRecord, Kind, MovingCell, Turn, take_turn
from baggie.evaluation.log import Record
from baggie.evaluation.pictures import save_map, save_mp4, save_step
from baggie.evaluation.subjects import open_policy
from baggie.geometry import FloatArray, PlanarPose
from baggie.metrics import success_rate, summary
from baggie.options.evaluating import EvaluateOptions
from baggie.policies import DemonstratorPolicy, OraclePolicy, Policy
from baggie.policies.memory import remembering
from baggie.seeds import EVALUATION
from baggie.tasks.task import Task
from baggie.types import Image, Observation, PickPlace


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

    def goal_corners(self, pose: PlanarPose) -> FloatArray:
        """`(4, 2)` pixels: where the outline of what is carried would appear if it lay there."""
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
    from baggie.workcell.simulated import open_simulated  # noqa: PLC0415

    oracle = options.policy == OraclePolicy.name
    policy = None if oracle else open_policy(options.policy, None, options.device)
    cell = open_simulated(options.cell, options.task)
    return BlockBench(cell, policy or DemonstratorPolicy(cell.demonstrate))


FILM_FPS = 5
PLAY_FPS = 20
"""Four times as fast as it was."""


@dataclass(frozen=True)
class BlockStep(Record):
    """One turn of the loop. Actions are as in `PickPlace.to_array`, metres and radians."""

    planned: tuple[float, ...] | None
    """None where the policy could not tell."""
    executed: tuple[float, ...] | None
    """None where nothing was moved."""
    reward: float
    """What Ravens counts of the task, all of it being 1; negative where something done was undone."""
    confidence: float
    failure: str
    """What went wrong; empty when nothing did by the cell's or the policy's own account."""
    message: str
    decision_ms: float

    @classmethod
    def of(cls, turn: Turn, reward: float) -> Self:
        """What of a turn is logged."""
        plan, outcome = turn.plan, turn.outcome
        return cls(
            planned=tuple(plan.action.to_array().tolist()) if plan else None,
            executed=tuple(outcome.executed.to_array().tolist()) if outcome else None,
            reward=reward,
            confidence=plan.confidence if plan else 0.0,
            failure=turn.failure,
            message=turn.message,
            decision_ms=turn.decision_ms,
        )


@dataclass(frozen=True)
class BlockEpisode(EpisodeRecord):
    """All but the times depend on the seed alone."""

    steps: tuple[BlockStep, ...]
    partial_credit: float
    """The rewards' sum."""
    ravens_success: bool
    """Whether Ravens counts the whole task as done."""
    success: bool
    """Strictly: every block upright and at its height in a slot of its own, and still so two seconds later."""
    failure: str
    """Why it is no success: what went wrong in the last step; or `ravens-only`, where Ravens counts it as one; or
    `unfinished`. Empty for a success.
    """
    message: str
    wall_s: float

    @classmethod
    def from_json(cls, record: dict[str, Any]) -> Self:
        """The inverse of `to_json`. Raises `DataError` for a record of another version of baggie."""
        steps = [BlockStep.from_json(step) for step in record.get("steps", ())]
        return super().from_json(record | {"steps": steps})


def run_block_episode(
    bench: BlockBench, number: int, stream: Sequence[int], *, out: Path, film: bool
) -> BlockEpisode:
    """Run episode `number` of a random stream; pictures are `out/episode-NNNN-{before,after,step-SS}.jpg`.

    It ends when Ravens' score says that all is done, when the most steps the task allows are used up, or when the
    policy gives up. A plan that the arm refuses takes a step, as a missed grasp does. With `film` there is a video too.
    """
    began, cell = time.perf_counter(), bench.cell
    cell.reset([*stream, number])
    stem = out / f"episode-{number:04d}"
    steps: list[BlockStep] = []
    policy = remembering(bench.policy)
    filming = cell.film(fps=FILM_FPS) if film else contextlib.nullcontext([])
    with filming as frames:
        while not cell.score.done and len(steps) < cell.task.max_steps:
            seen = cell.look()
            if not steps:
                save_map(Path(f"{stem}-before.jpg"), seen)
            turn = take_turn(policy, cell, seen)
            if turn.plan:
                ends = _pixels(cell, seen, turn.plan.action)
                save_step(Path(f"{stem}-step-{len(steps):02d}.jpg"), seen, turn.plan, ends)
            steps.append(BlockStep.of(turn, cell.count()))
            if turn.gave_up:
                break
        success = cell.strict_success()
    save_map(Path(f"{stem}-after.jpg"), cell.look())
    if frames:
        save_mp4(Path(f"{stem}.mp4"), frames, PLAY_FPS)
    failure = "" if success else steps[-1].failure or ("ravens-only" if cell.score.done else "unfinished")
    return BlockEpisode(
        episode=number,
        steps=tuple(steps),
        partial_credit=cell.score.total,
        ravens_success=cell.score.done,
        success=success,
        failure=failure,
        message="" if success else steps[-1].message,
        wall_s=time.perf_counter() - began,
    )


def _pixels(cell: BlockCell, seen: Observation, action: PickPlace) -> FloatArray:
    """`(2, 2)`: where pick and place appear in a picture."""
    if seen.grid is not None:
        return seen.grid.to_pixels([action.pick.xy, action.place.xy])
    return np.array([cell.goal_corners(pose).mean(axis=0) for pose in (action.pick, action.place)])


def _run(bench: BlockBench, number: int, options: EvaluateOptions) -> BlockEpisode:
    out, film = options.out / "episodes", number < options.film
    return run_block_episode(bench, number, (EVALUATION, options.seed), out=out, film=film)


def _measure(episodes: Sequence[BlockEpisode], _options: EvaluateOptions) -> dict[str, Any]:
    """`success` strictly and as Ravens counts, `partial_credit`, steps, times, and failures by their cause."""
    count, steps = len(episodes), [step for episode in episodes for step in episode.steps]
    return {
        "success": success_rate(sum(episode.success for episode in episodes), count),
        "ravens_success": success_rate(sum(episode.ravens_success for episode in episodes), count),
        "partial_credit": summary([episode.partial_credit for episode in episodes]),
        "steps": summary([len(episode.steps) for episode in episodes]),
        "decision_ms": summary([step.decision_ms for step in steps]),
        "failures": _counted(episode.failure for episode in episodes),
        "failed_steps": _counted(step.failure for step in steps),
    }


def _counted(causes: Iterable[str]) -> dict[str, int]:
    """How often each came, the most frequent first; no cause is no failure."""
    return dict(Counter(cause for cause in causes if cause).most_common())


def _note(episode: BlockEpisode) -> str:
    return f"last got {100 * episode.partial_credit:.0f}% done"


BLOCKS = Kind(
    log="block-episodes.jsonl",
    episode=BlockEpisode,
    open_bench=open_block_bench,
    run=_run,
    measure=_measure,
    note=_note,
)
