"""One closed-loop episode of a task with blocks: look, plan, move, until it is done or its steps are used up."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from baggie.evaluation.block_bench import BlockBench
from baggie.evaluation.kind import EpisodeRecord
from baggie.evaluation.log import Record
from baggie.evaluation.map_pictures import save_map, save_step
from baggie.evaluation.pictures import save_mp4
from baggie.evaluation.turn import Turn, take_turn
from baggie.policies.memory import remembering

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
                save_step(Path(f"{stem}-step-{len(steps):02d}.jpg"), seen, turn.plan)
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
