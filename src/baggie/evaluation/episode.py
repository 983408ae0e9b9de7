"""One closed-loop episode: a scene nobody has seen, a goal, look, plan, move, and where the bag ends.

What differs between kinds of tasks in the closed loop; all else is in `closed_loop.py`.

One turn of the loop: a plan from a picture, carried out, and what went wrong by whose account.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

from baggie.errors import BaggieError, LimitError, ReachError, UnsureError
from baggie.evaluation.goals import NoCardError, draw_goal, goal_in
from baggie.evaluation.log import Record
from baggie.evaluation.pictures import EpisodeScene, save_mp4, save_pictures
from baggie.evaluation.setup import Bench
from baggie.geometry import PlanarPose
from baggie.metrics import position_error_cm, yaw_error_deg
from baggie.operator import Operator
from baggie.options.evaluating import EvaluateOptions
from baggie.options.values import GoalKind
from baggie.types import Goal, Observation, Outcome, Plan
from baggie.vision.draw import check_goal


@dataclass(frozen=True)
class EpisodeRecord(Record):
    """What every kind of episode is logged with."""

    episode: int
    """Its number: all but the times in a record depend on this, the seed and the cell alone."""


AnyBench = TypeVar("AnyBench")
AnyEpisode = TypeVar("AnyEpisode", bound=EpisodeRecord)


@dataclass(frozen=True)
class Kind(Generic[AnyBench, AnyEpisode]):
    """How one kind of task is tried, episode by episode. All are functions of a module: worker processes need them."""

    log: str
    """The file of finished episodes; a report tells by it what a folder holds."""
    episode: type[AnyEpisode]
    open_bench: Callable[[EvaluateOptions], AnyBench]
    """A cell and the policy in it; called once in each process."""
    run: Callable[[AnyBench, int, EvaluateOptions], AnyEpisode]
    """One episode, by its number."""
    measure: Callable[[Sequence[AnyEpisode], EvaluateOptions], dict[str, Any]]
    """What many episodes say together; `success` first."""
    note: Callable[[AnyEpisode], str]
    """How one ended, beside the progress."""
    conditions: Callable[[EvaluateOptions, Operator], dict[str, Any]] | None = None
    """What else an evaluation differs by than task, policy, cell and seed; warns of what may surprise."""
    prepare: Callable[[EvaluateOptions, Operator], None] | None = None
    """What has to be done once, before any process opens a bench."""


class MovingCell(Protocol):
    """A workcell that does what is planned."""

    def carry_out(self, plan: Plan) -> Outcome:
        """Pick and place; raises `UnsureError`, `LimitError` and `ReachError`."""
        ...


@dataclass(frozen=True)
class Turn:
    """What a policy wanted and what became of it."""

    plan: Plan | None
    """None where it could not tell."""
    outcome: Outcome | None
    """None where nothing was moved, or what was picked up was put back."""
    failure: str
    """`no-plan`, `unsure`, `out-of-reach`, or what the outcome says; empty when nothing went wrong."""
    message: str
    decision_ms: float
    """Wall clock of the plan."""

    @property
    def gave_up(self) -> bool:
        """Whether nothing was tried: by another look at the same scene nothing changes."""
        return self.failure in ("no-plan", "unsure")


class Planner(Protocol):
    """A policy, or a memory that asks one."""

    def plan(self, observation: Observation, goal: Goal | None = None) -> Plan:
        """Where to pick and where to place."""
        ...


def take_turn(policy: Planner, cell: MovingCell, seen: Observation, goal: Goal | None = None) -> Turn:
    """Plan from what was seen, and move."""
    clock = time.perf_counter()
    try:
        plan = policy.plan(seen, goal)
    except BaggieError as error:
        return Turn(None, None, "no-plan", str(error), 1000 * (time.perf_counter() - clock))
    decision_ms = 1000 * (time.perf_counter() - clock)
    try:
        outcome = cell.carry_out(plan)
    except UnsureError as error:
        return Turn(plan, None, "unsure", str(error), decision_ms)
    except (LimitError, ReachError) as error:
        return Turn(plan, None, "out-of-reach", str(error), decision_ms)
    return Turn(plan, outcome, outcome.failure or "", "", decision_ms)


FILM_FPS = 10
PLAY_FPS = 20
"""Twice as fast as it was: half the frames to draw, and nobody has to wait."""


@dataclass(frozen=True)
class Episode(EpisodeRecord):
    """Poses are (x, y, yaw), metres and radians. All but the times depend on the seed alone."""

    start: tuple[float, ...]
    goal: tuple[float, ...]
    final: tuple[float, ...]
    distance_cm: float
    """From the bag's middle to the goal's, at the end."""
    yaw_error_deg: float
    """Modulo the turns that leave the bag as it is."""
    planned: tuple[float, ...] | None
    """The last action asked for, `PickPlace.to_array`; None without one."""
    executed: tuple[float, ...] | None
    pick_error_cm: float | None
    """From the last plan's pick to the bag's middle in the picture it was made from; None without a plan, as below."""
    place_error_cm: float | None
    """From its place to the goal."""
    pick_yaw_error_deg: float | None
    """Modulo the turns that leave the bag as it is."""
    pick_within_m: float | None
    """What the plan said of itself; None where it said nothing, as below."""
    place_within_m: float | None
    confidence: float
    looks: int
    """1, and one more for every time the gripper noticed that it had missed."""
    failure: str
    """What went wrong by the cell's or the policy's own account; empty when nothing did."""
    message: str
    decision_ms: tuple[float, ...]
    """Wall clock, one for each look."""
    wall_s: float


def run_episode(
    bench: Bench,
    number: int,
    stream: Sequence[int],
    *,
    goal_kind: GoalKind,
    retries: int,
    out: Path,
    film: bool,
) -> Episode:
    """Run episode `number` of a random stream; save pictures as `out/episode-NNNN-{before,after,heat}.jpg`.

    `baggie.evaluation.goals` draws the goal. The policy looks again, at most `retries` times, only when the gripper
    noticed that it held nothing: never because of what the simulator alone knows. With `film` there is a video too.
    Raises `BaggieError` when the camera does not see the goal.
    """
    began = time.perf_counter()
    cell = bench.cell
    cell.reset([*stream, number])
    start = bench.bag_at_start()
    pose = bench.goal = draw_goal(cell, start, goal_kind, (*stream, number))
    if goal_kind == "card":
        cell.lay_card(pose)
    filming = cell.film(fps=FILM_FPS) if film else contextlib.nullcontext([])
    with filming as frames:
        turns = _take_turns(bench, goal_kind, (*stream, number), retries)
        after = cell.look()
    final, symmetry = bench.bag_in(after), cell.settings.object_symmetry
    plan, outcome = (turns.last.plan, turns.last.outcome) if turns.last else (None, None)
    scene = EpisodeScene(cell, pose, turns.bag, final)
    save_pictures(out / f"episode-{number:04d}", scene, before=(turns.seen, turns.goal, plan), after=after)
    if frames:
        save_mp4(out / f"episode-{number:04d}.mp4", frames, PLAY_FPS)
    return Episode(
        episode=number,
        start=(start.x, start.y, start.yaw),
        goal=(pose.x, pose.y, pose.yaw),
        final=(final.x, final.y, final.yaw),
        distance_cm=position_error_cm(final, pose),
        yaw_error_deg=yaw_error_deg(final, pose, symmetry),
        planned=tuple(plan.action.to_array().tolist()) if plan else None,
        executed=tuple(outcome.executed.to_array().tolist()) if outcome else None,
        pick_error_cm=position_error_cm(plan.action.pick, turns.bag) if plan else None,
        place_error_cm=position_error_cm(plan.action.place, pose) if plan else None,
        pick_yaw_error_deg=yaw_error_deg(plan.action.pick, turns.bag, symmetry) if plan else None,
        pick_within_m=plan.pick_within_m if plan else None,
        place_within_m=plan.place_within_m if plan else None,
        confidence=plan.confidence if plan else 0.0,
        looks=len(turns.decision_ms),
        failure=turns.last.failure if turns.last else "no-card",
        message=turns.message,
        decision_ms=tuple(turns.decision_ms),
        wall_s=time.perf_counter() - began,
    )


@dataclass
class _Turns:
    """Look, plan, move, check, until the gripper has held something."""

    seen: Observation
    """The picture the last plan was made from."""
    bag: PlanarPose
    """Where the bag was in it; a missed grasp may have moved it."""
    goal: Goal | None = None
    """As the policy was told it; None where the card was not found."""
    last: Turn | None = None
    """None without a goal."""
    message: str = ""
    decision_ms: list[float] = field(default_factory=list)


def _take_turns(bench: Bench, goal_kind: GoalKind, stream: Sequence[int], retries: int) -> _Turns:
    cell = bench.cell
    seen = cell.look()
    turns = _Turns(seen, bench.bag_in(seen))
    try:
        goal = goal_in(bench, goal_kind, bench.goal, turns.seen, stream)
    except NoCardError as error:
        turns.message = str(error)
        return turns
    check_goal(goal, turns.seen.size)
    turns.goal = goal
    for look_again in range(1 + retries):
        if look_again:
            turns.seen = cell.look()
            turns.bag = bench.bag_in(turns.seen)
        turns.last = turn = take_turn(bench.policy, cell, turns.seen, goal)
        turns.decision_ms.append(turn.decision_ms)
        turns.message = turn.message
        if turn.failure != "missed-grasp":
            break
    return turns
