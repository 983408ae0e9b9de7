"""One episode of the closed loop: a scene nobody has seen, then look, plan, move, until it is done or given up.

The loop is the same for every task. How it is judged is not: by the distance of an object from the goal in the picture,
or by the conditions of a task that itself says where things go.
"""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from baggie import seeds
from baggie.calibration.image_to_robot.rectify import raise_card
from baggie.collect.machine import random_place
from baggie.errors import BaggieError, LimitError, ReachError, UnsureError
from baggie.evaluation.builder import Builder
from baggie.evaluation.log import Credit, Episode, Landing, Step
from baggie.evaluation.marked_pictures import EpisodeScene, save_map, save_mp4, save_pictures, save_step
from baggie.evaluation.setup import Setup, task_of
from baggie.geometry import PlanarPose
from baggie.metrics import position_error_cm, yaw_error_deg
from baggie.options.evaluating import EvaluateOptions
from baggie.options.values import GoalKind
from baggie.policies.memory import Planner, remembering
from baggie.registry import TASKS
from baggie.seeds import EVALUATION, first_fit
from baggie.tasks.conditions import Score, strict_success
from baggie.tasks.stacked import Stacked, Unstacked
from baggie.types import Goal, Observation, Outcome, Plan
from baggie.vision.draw import check_goal
from baggie.vision.goal_card import find_card
from baggie.workcell.workcell import Workcell

PLAY_FPS = 20
"""Of videos."""


@dataclass(frozen=True)
class Trial:
    """A plan, and what became of it."""

    plan: Plan | None
    """None where the policy could not tell."""
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

    def logged(self, **judged: float | None) -> Step:
        """What is logged of it, beside what was `judged`."""
        plan, outcome = self.plan, self.outcome
        return Step(
            planned=tuple(plan.action.to_array().tolist()) if plan else None,
            executed=tuple(outcome.executed.to_array().tolist()) if outcome else None,
            failure=self.failure,
            message=self.message,
            decision_ms=self.decision_ms,
            confidence=plan.confidence if plan else 0.0,
            pick_within_m=plan.pick_within_m if plan else None,
            place_within_m=plan.place_within_m if plan else None,
            **judged,
        )


def try_plan(policy: Planner, cell: Workcell, seen: Observation, goal: Goal | None = None) -> Trial:
    """Plan from what was seen, and move."""
    clock = time.perf_counter()
    try:
        plan = policy.plan(seen, goal)
    except BaggieError as error:
        return Trial(None, None, "no-plan", str(error), 1000 * (time.perf_counter() - clock))
    decision_ms = 1000 * (time.perf_counter() - clock)
    try:
        outcome = cell.carry_out(plan)
    except UnsureError as error:
        return Trial(plan, None, "unsure", str(error), decision_ms)
    except (LimitError, ReachError) as error:
        return Trial(plan, None, "out-of-reach", str(error), decision_ms)
    return Trial(plan, outcome, outcome.failure or "", "", decision_ms)


class Judge(Protocol):
    """Says what the policy is told, when an episode is over, and how it ended. One for each episode."""

    film_fps: int
    """Frames of a video in a second of the scene."""
    most_steps: int
    planner: Planner
    """What is asked for plans."""

    @property
    def over(self) -> bool:
        """Whether there is nothing more to do."""
        ...

    def look(self, seen: Observation) -> Goal | None:
        """Take note of the picture that is planned from; the goal in it, where one is given.

        Raises `NoGoalError` where it cannot be given, or nothing is left to be one.
        """
        ...

    def judge(self, trial: Trial) -> Step:
        """Take note of what was done; what is logged of it."""
        ...

    def end(self) -> None:
        """Take note that nothing more is done."""
        ...

    def ending(self, after: Observation) -> dict[str, Any]:
        """What is logged of the episode's end, shown in the picture `after`; its pictures are saved."""
        ...


class ByDistance:
    """Judges how far from the goal in the picture the object ends.

    The policy looks again only when the gripper noticed that it held nothing: never because of what the simulator alone
    knows.
    """

    # So that videos are twice as fast as it was: half the frames to draw, and nobody has to wait.
    film_fps = 10

    def __init__(self, setup: Setup, options: EvaluateOptions, stream: Sequence[int], stem: Path) -> None:
        """Draw the goal, and lay a card there where it is given by one."""
        self._setup, self._kind, self._stream, self._stem = setup, options.goal, stream, stem
        self.planner: Planner = remembering(setup.policy)
        self.most_steps = 1 + options.retries
        self.over = False
        self._start = setup.object_at_start()
        self._goal = draw_goal(setup.cell, self._start, self._kind, stream)
        setup.cell.give_goal(self._goal)
        if self._kind == "card":
            setup.cell.lay_card(self._goal)
        self._told: Goal | None = None
        self._failure = self._message = ""
        self._last: Trial | None = None

    def look(self, seen: Observation) -> Goal | None:
        """The goal, as told in the first picture. Raises `NoGoalError` where there is no card to be seen in it."""
        self._seen, self._object = seen, self._setup.object_in(seen)
        if self._told is None:
            try:
                goal = goal_in(self._setup, self._kind, self._goal, seen, self._stream)
            except NoGoalError as error:
                self._failure, self._message = "no-card", str(error)
                raise
            check_goal(goal, seen.size)
            self._told = goal
        return self._told

    def judge(self, trial: Trial) -> Step:
        """How far pick and place were off; anything but a missed grasp ends the episode."""
        self._last, self._failure, self._message = trial, trial.failure, trial.message
        self.over = trial.failure != "missed-grasp"
        if trial.plan is None:
            return trial.logged()
        action, symmetry = trial.plan.action, self._setup.cell.settings.object_symmetry
        return trial.logged(
            pick_error_cm=position_error_cm(action.pick, self._object),
            place_error_cm=position_error_cm(action.place, self._goal),
            pick_yaw_error_deg=yaw_error_deg(action.pick, self._object, symmetry),
        )

    def end(self) -> None:
        """What is measured is where the object is seen to lie."""

    def ending(self, after: Observation) -> dict[str, Any]:
        """Where the object came to lie."""
        cell, goal, final = self._setup.cell, self._goal, self._setup.object_in(after)
        scene = EpisodeScene(cell, goal, self._object, final)
        plan = self._last.plan if self._last else None
        save_pictures(self._stem, scene, before=(self._seen, self._told, plan), after=after)
        start, end, there = ((pose.x, pose.y, pose.yaw) for pose in (self._start, goal, final))
        landing = Landing(
            start=start,
            goal=end,
            final=there,
            distance_cm=position_error_cm(final, goal),
            yaw_error_deg=yaw_error_deg(final, goal, cell.settings.object_symmetry),
        )
        return {"landing": landing, "failure": self._failure, "message": self._message}


class ByConditions:
    """Judges how much of a task that itself says where things go is done, as Ravens counts it and strictly.

    A plan that the arm refuses takes a step, as a missed grasp does. A policy that wants goals is given those of the
    bags that are to be stacked, one after the other, as a builder says them from what it sees.
    """

    film_fps = 5  # so that videos are four times as fast as it was

    def __init__(self, setup: Setup, options: EvaluateOptions, stem: Path) -> None:
        self._cell, self._stem = setup.cell, stem
        assert self._cell.scene is not None, "only a simulated cell says what counts"
        self._conditions = self._cell.scene.conditions
        self._score = Score(self._conditions)
        self.most_steps = task_of(options).max_steps
        self._stacked = next((e for e in self._conditions if isinstance(e, Stacked | Unstacked)), None)
        self._builder: Builder | None = None
        self.planner: Planner = remembering(setup.policy)
        if self._stacked is not None and getattr(setup.policy, "wants_goal", False):
            standing = self._stacked.standing if isinstance(self._stacked, Unstacked) else None
            self.planner = self._builder = Builder(
                self._cell, setup.policy, self._stacked.pattern, standing=standing
            )
        self._steps = 0
        self._gave_up = self._strict = False
        self._last: Trial | None = None

    @property
    def over(self) -> bool:
        """Whether all is done as Ravens counts, or the policy gave up."""
        return self._score.done or self._gave_up

    def look(self, seen: Observation) -> Goal | None:
        """The next goal of a builder. Raises `NoGoalError` where all is built, as far as it sees."""
        if not self._steps:
            save_map(self._picture("before"), self._marked(seen))
        self._seen = seen
        if self._builder is None:
            return None
        goal = self._builder.look(seen)
        if goal is None:
            raise NoGoalError("all of the pattern is built, as far as the pictures tell")
        return goal

    def judge(self, trial: Trial) -> Step:
        """What it earned."""
        if trial.plan:
            save_step(self._picture(f"step-{self._steps:02d}"), self._cell, self._seen, trial.plan)
        self._last, self._steps, self._gave_up = trial, self._steps + 1, trial.gave_up
        if self._builder is not None:
            self._builder.note(trial.outcome)
        state = self._cell.state()
        assert state is not None
        return trial.logged(reward=self._score.count(state))

    def end(self) -> None:
        """Two seconds pass where all seems done."""
        self._strict = strict_success(self._conditions, self._cell)

    def ending(self, after: Observation) -> dict[str, Any]:
        """How much was done."""
        save_map(self._picture("after"), after)
        layers, offsets = self._slots()
        credit = Credit(self._score.total, self._score.done, self._strict, layers, offsets)
        if self._strict:
            return {"credit": credit, "failure": "", "message": ""}
        failed, message = (self._last.failure, self._last.message) if self._last else ("", "")
        failure = failed or ("ravens-only" if self._score.done else "unfinished")
        return {"credit": credit, "failure": failure, "message": message}

    def _slots(self) -> tuple[tuple[bool, ...], tuple[tuple[float | None, ...], ...]]:
        """Of a pattern, which layers are right, and how far from each slot its bag is, layer by layer; else nothing."""
        state = self._cell.state()
        if not isinstance(self._stacked, Stacked) or state is None:
            return (), ()
        off = [None if m is None else 100 * m for m in self._stacked.offsets_m(state)]
        layers = tuple(tuple(off[slot] for slot in layer) for layer in self._stacked.pattern.layers)
        return tuple(None not in layer for layer in layers), layers

    def _marked(self, seen: Observation) -> Observation:
        """What was seen, with the pattern drawn in it."""
        if self._stacked is None:
            return seen
        return replace(seen, color=self._stacked.pattern.paint(seen.color, self._cell.outline))

    def _picture(self, what: str) -> Path:
        return self._stem.with_name(f"{self._stem.name}-{what}.jpg")


def run_episode(setup: Setup, number: int, options: EvaluateOptions) -> Episode:
    """Run the episode with a number; its pictures, and a video of the first ones, go to `options.out/episodes`.

    Raises `BaggieError` when the camera does not see the goal.
    """
    began, cell = time.perf_counter(), setup.cell
    stream = (EVALUATION, options.seed, number)
    cell.reset(stream)
    stem = options.out / "episodes" / f"episode-{number:04d}"
    judge: Judge
    if TASKS[options.task].has_goal:
        judge = ByDistance(setup, options, stream, stem)
    else:
        judge = ByConditions(setup, options, stem)
    steps: list[Step] = []
    with contextlib.ExitStack() as stack:
        frames = stack.enter_context(cell.film(fps=judge.film_fps)) if number < options.film else []
        with contextlib.suppress(NoGoalError):
            while not judge.over and len(steps) < judge.most_steps:
                seen = cell.look()
                goal = judge.look(seen)
                steps.append(judge.judge(try_plan(judge.planner, cell, seen, goal)))
        judge.end()
        after = cell.look()
    ending = judge.ending(after)
    if frames:
        save_mp4(stem.with_name(f"{stem.name}.mp4"), frames, PLAY_FPS)
    return Episode(episode=number, steps=tuple(steps), wall_s=time.perf_counter() - began, **ending)


CLEARANCE_M = 0.16
"""Between a goal and what stands there or a bag that is to stay: two bags lie side by side, not on each other."""
CLICK_M = 0.02
"""How far from the middle of a bag a person may click on it."""
_GOALS = 0x60A1
"""Keeps the stream of an episode's goal apart from any the cell makes of its scene's."""
_CLICKS = 0xC11C
_TRIES = 100


class NoGoalError(BaggieError):
    """There is no goal to plan for: its card is not to be seen, or all is done as far as that can be seen."""


def draw_goal(cell: Workcell, bag: PlanarPose, kind: GoalKind, stream: Sequence[int]) -> PlanarPose:
    """Where the bag is to go: as the collector draws places, uniform in the workspace, at least 20 cm from where it is.

    Square to the workspace if `virtual`, else at any angle; at least 16 cm from obstacles and from a second bag. Raises
    `BaggieError` where there is no such place.
    """
    rng = seeds.generator(*stream, _GOALS)
    occupied = _occupied(cell)
    pose = first_fit(
        lambda: random_place(cell.settings.workspace, bag, rng),
        lambda place: all(place.distance(other) >= CLEARANCE_M for other in occupied),
        _TRIES,
    )
    if pose is None:
        raise BaggieError(
            f"expected room for a goal {CLEARANCE_M * 100:.0f} cm from each of {len(occupied)} things on the table, "
            f"found none in {_TRIES} tries; clear the workspace ({cell.settings.workspace})"
        )
    if kind == "virtual":
        return pose
    # One turn of the bag that looks like no turn: what is further away looks the same, and the wrist need not go there.
    half = math.pi / max(cell.settings.object_symmetry, 1)
    return replace(pose, yaw=float(rng.uniform(-half, half)))


def _occupied(cell: Workcell) -> list[PlanarPose]:
    """Where things stand, or are to stay, as far as anybody knows."""
    state = cell.state()
    if state is None:
        return []
    return [*state.obstacles, *(state.places[name] for name in (cell.scene.staying if cell.scene else ()))]


def goal_in(setup: Setup, kind: GoalKind, pose: PlanarPose, seen: Observation, stream: Sequence[int]) -> Goal:
    """The goal as the policy is told it in the picture `seen`, with a click on the bag where there are two.

    A card's corners are those found in the picture, raised to the bag's height where the setup has a map for that.
    Raises `NoGoalError` where it is not found.
    """
    cell = setup.cell
    object_at = _click(cell, setup.object_in(seen), stream) if cell.scene and cell.scene.staying else None
    if kind != "card":
        return Goal(cell.outline(pose), object_at=object_at)
    card = find_card(seen.color)
    if card is None:
        raise NoGoalError(
            "expected the goal card in the picture, found none; lay it where the camera sees all of it"
        )
    corners = card.corners
    if setup.image_to_robot is not None:
        to_robot = setup.image_to_robot.for_size(seen.size)
        corners = raise_card(corners, to_robot, cell.settings.object_size_m[2] / 2)
    return Goal(corners, "card", card.color, object_at)


def _click(cell: Workcell, bag: PlanarPose, stream: Sequence[int]) -> tuple[float, float]:
    """A pixel on the bag to be moved, uniform within 2 cm of its middle."""
    rng = seeds.generator(*stream, _CLICKS)
    radius, angle = CLICK_M * math.sqrt(rng.random()), rng.uniform(-math.pi, math.pi)
    there = PlanarPose(bag.x + radius * math.cos(angle), bag.y + radius * math.sin(angle))
    u, v = np.asarray(cell.outline(there)).mean(axis=0)
    return float(u), float(v)
