"""One closed-loop episode: a scene nobody has seen, a goal, look, plan, move, and where the bag ends."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from baggie.errors import BaggieError, DataError, LimitError, ReachError, UnsureError
from baggie.evaluation.bench import Bench
from baggie.evaluation.episode_pictures import EpisodeScene, save_pictures
from baggie.evaluation.goals import NoCardError, draw_goal, goal_in
from baggie.evaluation.log import read_lines
from baggie.evaluation.metrics import position_error_cm, yaw_error_deg
from baggie.evaluation.options import GoalKind
from baggie.evaluation.pictures import save_mp4
from baggie.geometry import PlanarPose
from baggie.types import Goal, Observation, Outcome, Plan
from baggie.vision.draw import check_goal

FILM_FPS = 10
PLAY_FPS = 20
"""Twice as fast as it was: half the frames to draw, and nobody has to wait."""


@dataclass(frozen=True)
class Episode:
    """Poses are (x, y, yaw), metres and radians. All but the times depend on the seed alone."""

    episode: int
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
    """From the last plan's pick to the bag's true middle when it was made; None without a plan, as below."""
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

    def to_json(self) -> dict[str, Any]:
        """For the log."""
        return asdict(self)

    @classmethod
    def from_json(cls, record: dict[str, Any]) -> Episode:
        """The inverse of `to_json`. Raises `DataError` for a record of another version of baggie."""
        own = {entry.name for entry in fields(cls)}
        if record.keys() != own:
            raise DataError(
                f"expected an episode as this version of baggie logs it, got one without {sorted(own - record.keys())} "
                f"and with {sorted(record.keys() - own)} besides; evaluate again into another folder"
            )
        values: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in record.items()}
        return cls(**values)


def read_episodes(log: Path) -> list[Episode]:
    """The episodes in a log, oldest first; none where there is no log. Raises `DataError`, naming it, as above."""
    try:
        return [Episode.from_json(record) for record in read_lines(log)]
    except DataError as error:
        raise DataError(f"cannot use {log}: {error}") from None


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
    start = cell.truth()
    pose = bench.goal = draw_goal(cell, goal_kind, (*stream, number))
    if goal_kind == "card":
        cell.lay_card(pose)
    filming = cell.film(fps=FILM_FPS) if film else contextlib.nullcontext([])
    with filming as frames:
        turn = _take_turn(bench, goal_kind, (*stream, number), retries)
        after = cell.look()
    final, symmetry = cell.truth(), cell.settings.object_symmetry
    scene = EpisodeScene(cell, pose, turn.bag, final)
    save_pictures(out / f"episode-{number:04d}", scene, before=(turn.seen, turn.goal, turn.plan), after=after)
    if frames:
        save_mp4(out / f"episode-{number:04d}.mp4", frames, PLAY_FPS)
    plan, outcome = turn.plan, turn.outcome
    return Episode(
        episode=number,
        start=(start.x, start.y, start.yaw),
        goal=(pose.x, pose.y, pose.yaw),
        final=(final.x, final.y, final.yaw),
        distance_cm=position_error_cm(final, pose),
        yaw_error_deg=yaw_error_deg(final, pose, symmetry),
        planned=tuple(plan.action.to_array().tolist()) if plan else None,
        executed=tuple(outcome.executed.to_array().tolist()) if outcome else None,
        pick_error_cm=position_error_cm(plan.action.pick, turn.bag) if plan else None,
        place_error_cm=position_error_cm(plan.action.place, pose) if plan else None,
        pick_yaw_error_deg=yaw_error_deg(plan.action.pick, turn.bag, symmetry) if plan else None,
        pick_within_m=plan.pick_within_m if plan else None,
        place_within_m=plan.place_within_m if plan else None,
        confidence=plan.confidence if plan else 0.0,
        looks=len(turn.decision_ms),
        failure=turn.failure,
        message=turn.message,
        decision_ms=tuple(turn.decision_ms),
        wall_s=time.perf_counter() - began,
    )


@dataclass
class _Turn:
    """Look, plan, move, check, until the gripper has held something."""

    seen: Observation
    """The picture the last plan was made from."""
    bag: PlanarPose
    """Where the bag truly was in it; a missed grasp may have moved it."""
    goal: Goal | None = None
    """As the policy was told it; None where the card was not found."""
    plan: Plan | None = None
    outcome: Outcome | None = None
    failure: str = ""
    message: str = ""
    decision_ms: list[float] = field(default_factory=list)


def _take_turn(bench: Bench, goal_kind: GoalKind, stream: Sequence[int], retries: int) -> _Turn:
    cell = bench.cell
    turn = _Turn(cell.look(), cell.truth())
    try:
        goal = goal_in(bench, goal_kind, bench.goal, turn.seen, stream)
    except NoCardError as error:
        turn.failure, turn.message = "no-card", str(error)
        return turn
    check_goal(goal, turn.seen.size)
    turn.goal = goal
    for look_again in range(1 + retries):
        if look_again:
            turn.seen, turn.bag = cell.look(), cell.truth()
        clock = time.perf_counter()
        try:
            turn.plan = bench.policy.plan(turn.seen, goal)
        except BaggieError as error:
            turn.plan, turn.failure, turn.message = None, "no-plan", str(error)
            break
        finally:
            turn.decision_ms.append(1000 * (time.perf_counter() - clock))
        try:
            turn.outcome = cell.carry_out(turn.plan)
        except UnsureError as error:
            turn.failure, turn.message = "unsure", str(error)
            break
        except (LimitError, ReachError) as error:
            turn.failure, turn.message = "out-of-reach", str(error)
            break
        turn.failure = turn.outcome.failure or ""
        if turn.failure != "missed-grasp":
            break
    return turn
