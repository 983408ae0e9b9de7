"""One closed-loop episode: a scene nobody has seen, a goal, look, plan, move, and where the bag ends."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from baggie import seeds
from baggie.collect.places import random_place
from baggie.errors import BaggieError, LimitError, ReachError
from baggie.evaluation.metrics import position_error_cm, yaw_error_deg
from baggie.evaluation.pictures import Mark, Region, heat_over, marked, save_jpeg, save_mp4
from baggie.geometry import FloatArray, PlanarPose, Rectangle
from baggie.policies.base import Policy
from baggie.types import Goal, Image, Observation, Outcome, PickPlace, Plan
from baggie.vision.draw import check_goal, paint_goal

FILM_FPS = 10
PLAY_FPS = 20
"""Twice as fast as it was: half the frames to draw, and nobody has to wait."""
_GOALS = 0x60A1
"""Keeps the stream of an episode's goal apart from any the cell makes of its scene's."""


class Settings(Protocol):
    """What an episode must know of a workcell's settings."""

    @property
    def workspace(self) -> Rectangle:
        """Where bags may lie, robot base frame, metres."""
        ...


class EvaluationCell(Protocol):
    """A workcell whose scenes can be set and whose truth is known: a simulated one."""

    @property
    def settings(self) -> Settings:
        """What it is."""
        ...

    def reset(self, seed: Sequence[int]) -> None:
        """A new scene, drawn from the random stream with this name."""
        ...

    def look(self) -> Observation:
        """A picture with the arm out of view."""
        ...

    def execute(self, action: PickPlace) -> Outcome:
        """Pick and place; raises `LimitError` and `ReachError`."""
        ...

    def truth(self) -> PlanarPose:
        """Where the bag is."""
        ...

    def goal_corners(self, pose: PlanarPose) -> FloatArray:
        """`(4, 2)` pixels: the outline of a bag resting there, in the true camera."""
        ...

    def film(self, size: tuple[int, int] = ..., fps: int = ...) -> AbstractContextManager[list[Image]]:
        """Frames of the arm at work while open."""
        ...


@dataclass
class Bench:
    """A cell and the policy to try in it."""

    cell: EvaluationCell
    policy: Policy
    goal: PlanarPose = field(init=False)
    """Where the bag is to go in this episode; only an oracle may ask."""


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
    """Modulo the quarter turns that leave a square bag as it is."""
    planned: tuple[float, ...] | None
    """The last action asked for, `PickPlace.to_array`; None without one."""
    executed: tuple[float, ...] | None
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
        """The inverse of `to_json`."""
        values: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in record.items()}
        return cls(**values)


def run_episode(
    bench: Bench,
    number: int,
    stream: Sequence[int],
    *,
    retries: int,
    out: Path,
    film: bool,
) -> Episode:
    """Run episode `number` of a random stream; save pictures as `out/episode-NNNN-{before,after,heat}.jpg`.

    The goal is drawn as the collector draws places: uniform in the workspace, at least 20 cm from the bag,
    square to it. The policy looks again, at most `retries` times, only when the gripper noticed that it held
    nothing: never because of what the simulator alone knows. With `film` there is a video too. Raises
    `BaggieError` when the camera does not see the goal.
    """
    began = time.perf_counter()
    cell = bench.cell
    cell.reset([*stream, number])
    start = cell.truth()
    pose = random_place(cell.settings.workspace, start, seeds.generator(*stream, number, _GOALS))
    bench.goal = pose
    goal = Goal(cell.goal_corners(pose))
    filming = cell.film(fps=FILM_FPS) if film else contextlib.nullcontext([])
    with filming as frames:
        turn = _take_turn(cell, bench.policy, goal, retries)
        after = cell.look()
    final = cell.truth()
    _save_pictures(out / f"episode-{number:04d}", _Scene(cell, pose, final), turn, goal, after)
    if frames:
        save_mp4(out / f"episode-{number:04d}.mp4", frames, PLAY_FPS)
    plan, outcome = turn.plan, turn.outcome
    return Episode(
        episode=number,
        start=(start.x, start.y, start.yaw),
        goal=(pose.x, pose.y, pose.yaw),
        final=(final.x, final.y, final.yaw),
        distance_cm=position_error_cm(final, pose),
        yaw_error_deg=yaw_error_deg(final, pose),
        planned=tuple(plan.action.to_array().tolist()) if plan else None,
        executed=tuple(outcome.executed.to_array().tolist()) if outcome else None,
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
    plan: Plan | None = None
    outcome: Outcome | None = None
    failure: str = ""
    message: str = ""
    decision_ms: list[float] = field(default_factory=list)


def _take_turn(cell: EvaluationCell, policy: Policy, goal: Goal, retries: int) -> _Turn:
    turn = _Turn(cell.look(), cell.truth())
    check_goal(goal, turn.seen.size)
    for look_again in range(1 + retries):
        if look_again:
            turn.seen, turn.bag = cell.look(), cell.truth()
        clock = time.perf_counter()
        try:
            turn.plan = policy.plan(turn.seen, goal)
        except BaggieError as error:
            turn.plan, turn.failure, turn.message = None, "no-plan", str(error)
            break
        finally:
            turn.decision_ms.append(1000 * (time.perf_counter() - clock))
        try:
            turn.outcome = cell.execute(turn.plan.action)
        except (LimitError, ReachError) as error:
            turn.failure, turn.message = "out-of-reach", str(error)
            break
        turn.failure = turn.outcome.failure or ""
        if turn.failure != "missed-grasp":
            break
    return turn


@dataclass(frozen=True)
class _Scene:
    """Where the bag should end and did, in the cell it was in."""

    cell: EvaluationCell
    goal: PlanarPose
    final: PlanarPose

    def pixel(self, pose: PlanarPose) -> FloatArray:
        """`(2,)`: where the middle of a bag there appears."""
        return np.asarray(self.cell.goal_corners(pose).mean(axis=0))

    def region(self, size: tuple[int, int]) -> Region:
        """The part of the picture in which bags can lie."""
        area = self.cell.settings.workspace
        corners = [PlanarPose(x, y) for x in (area.x_min, area.x_max) for y in (area.y_min, area.y_max)]
        return Region.around(np.vstack([self.cell.goal_corners(corner) for corner in corners]), size)


def _save_pictures(stem: Path, scene: _Scene, turn: _Turn, goal: Goal, after: Observation) -> None:
    region = scene.region(after.size)
    before = paint_goal(turn.seen.color, goal)
    if turn.plan is not None:
        planned, right = turn.plan.action, (turn.bag, scene.goal)
        poses = zip(("pick", "place"), (planned.pick, planned.place), right, strict=True)
        marks = [Mark(name, scene.pixel(ours), scene.pixel(true)) for name, ours, true in poses]
        save_jpeg(stem.with_name(stem.name + "-before.jpg"), marked(before, region, marks))
        if turn.plan.views:
            heat = heat_over(turn.seen.color, region, turn.plan.views)
            save_jpeg(stem.with_name(stem.name + "-heat.jpg"), heat)
    else:
        save_jpeg(stem.with_name(stem.name + "-before.jpg"), region.cut(before))
    end = Mark("end", scene.pixel(scene.final), scene.pixel(scene.goal))
    outlined = paint_goal(after.color, replace(goal, style="outline"))
    save_jpeg(stem.with_name(stem.name + "-after.jpg"), marked(outlined, region, [end]))
