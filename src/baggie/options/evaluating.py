"""What can be said about judging a policy, about telling others, and about taking it elsewhere."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, get_args

from tyro.conf import Positional

from baggie.errors import UsageError
from baggie.options.collecting import TaskName
from baggie.options.values import (
    COLOR_MASK,
    ORACLE,
    USUAL_TASK,
    Count,
    GoalKind,
    Number,
    Options,
    Positive,
    Scenery,
    Seed,
    Workers,
)
from baggie.registry import TASKS

_WITH_GOAL = ("workcell", "scenery", "goal", "radius_cm", "retries")
"""What means something only for tasks whose goal is given in the picture: others say themselves what counts."""
_STACKING = ("pattern", "one_color")
"""What means something only for tasks that stack bags."""


@dataclass(frozen=True)
class ValidateOptions(Options):
    """Measure pick and place errors on attempts the policy never learned from."""

    policy: str
    """A training run's folder, a Hub id, or `color-mask`."""
    data: Path
    """The recording."""
    out: Path
    """Where metrics.json, predictions.json and pictures/ go."""
    last: Count = 50
    """For a policy that was not trained: how many successful attempts, from the end, to measure it on."""
    calibration: Path | None = None
    """For `color-mask`: its image-to-robot map. By default the one in the recording's calibration/ folder."""


@dataclass(frozen=True)
class EvaluateOptions(Options):
    """Run a policy in the closed loop on unseen scenes, and measure how often it does its task.

    Again with the same words it goes on where it stopped; with more episodes it adds to those it has.
    """

    policy: str
    """A training run's folder, a Hub id, `color-mask` (where a goal is given in the picture, or bags are stacked), or
    `oracle`, which reads the simulator's truth.
    """
    out: Path
    """Where metrics.json, the log of episodes, pictures and videos go."""
    task: TaskName = USUAL_TASK
    """What is on the table and what counts as done."""
    pattern: str | None = None
    """Where bags are stacked: another pattern than the task's own, in words, such as tower:5, pyramid:3-2-1 or
    "layers:2x2,2x2 turned", or a YAML file with its slots.
    """
    one_color: bool = False
    """Where bags are stacked: all of them are of one colour; else each is of one of its own."""
    episodes: Count = 100
    """How many scenes."""
    seed: Seed = 0
    """Names the scenes; no seed of `collect` ever gives one of them."""
    cell: Seed = 0
    """The workcell; a policy belongs to the one it was trained in."""
    workcell: Path | None = None
    """Where a goal is given in the picture: a workcell file. Try it there, on a real arm, one scene after the other as
    they come; its map from the picture to the robot says where objects end.
    """
    scenery: Scenery = "plain"
    """With bags: the cell as it is; other light; what a varied collection shows; a bag, or all of a scene, that none
    ever shows; or a second bag. Where bags are stacked: plain, light or unseen-bag.
    """
    goal: GoalKind = "virtual"
    """How a goal is given in the picture: marked square to the workspace; at any angle; or by a real green card that
    has to be found.
    """
    radius_cm: Positive = 2.0
    """An object this near the middle of its goal in the picture is a success."""
    retries: Number = 2
    """Where a goal is given in the picture: how often to look again when the gripper noticed that it missed. Elsewhere
    that takes a step.
    """
    device: Literal["cpu", "cuda", "mps"] = "cpu"
    """Where a policy that was trained computes."""
    workers: Workers | None = None
    """Processes, each with a workcell of its own; as many as there are cores unless given."""
    film: Number = 2
    """How many of the first episodes to make a video of."""
    calibration: Path | None = None
    """A recording of this cell, for its map: `color-mask` plans with it, and `--goal card` allows for an object's
    height.
    """

    def check(self) -> None:
        """Raise `UsageError` for what cannot be evaluated."""
        for name, chosen, known in (
            ("task", self.task, TASKS.names()),
            ("scenery", self.scenery, get_args(Scenery)),
            ("goal", self.goal, get_args(GoalKind)),
        ):
            if chosen not in known:
                raise UsageError(f"expected a {name} among {', '.join(known)}, got {chosen!r}")
        stacks = TASKS[self.task].pattern is not None
        if not stacks:
            self._refuse(_STACKING, instead="bag-tower")
        if not TASKS[self.task].has_goal:
            self._check_without_goal(stacks)
        elif self.workcell is not None:
            self._check_real()

    @property
    def processes(self) -> int:
        """How many work side by side: one, where there is one arm."""
        return self.workers or (1 if self.workcell is not None else os.cpu_count() or 1)

    def _check_real(self) -> None:
        given = f"with --workcell {self.workcell}, "
        if self.scenery != "plain" or self.goal == "card":
            raise UsageError(
                f"expected --scenery plain and --goal virtual or turned {given}got {self.scenery} and {self.goal}; "
                "nobody lays another table or a card there between scenes"
            )
        if self.policy == ORACLE:
            raise UsageError(
                f"expected a policy that looks {given}got {self.policy}: nobody knows the truth there"
            )
        if self.processes != 1:
            raise UsageError(f"expected --workers 1 {given}which has one arm, got {self.workers}")

    def _refuse(self, names: Sequence[str], instead: str) -> None:
        """Raise `UsageError` for an option that means nothing with this task, and something with the one `instead`."""
        for name in names:
            if (given := getattr(self, name)) != getattr(EvaluateOptions, name):
                raise UsageError(
                    f"expected no --{name.replace('_', '-')} with --task {self.task}, got {given}; leave it out, or "
                    f"take --task {instead}"
                )

    def _check_without_goal(self, stacks: bool) -> None:
        by_color = stacks and self.policy == COLOR_MASK
        others = [name for name in _WITH_GOAL if name != "scenery" or not stacks]
        self._refuse(others if by_color else [*others, "calibration"], instead=USUAL_TASK)
        if self.policy == COLOR_MASK and not stacks:
            raise UsageError(
                f"expected a policy that knows the task with --task {self.task}, got {self.policy}, which takes a bag "
                "to a goal in the picture; give the folder of a run that was taught it, or oracle"
            )
        if by_color and not self.one_color:
            raise UsageError(
                f"expected --one-color with --task {self.task} and {self.policy}, which knows one colour; say it, or "
                "give the folder of a run that was taught to stack"
            )


@dataclass(frozen=True)
class ReportOptions:
    """Put everything that is known about some runs on one self-contained page."""

    runs: Positional[tuple[Path, ...]]
    """Folders that train, validate or evaluate wrote, or folders of such."""
    out: Path = Path("report.html")
    """The page."""
    title: str | None = None
    """Its heading; by default what it is about."""


@dataclass(frozen=True)
class ExportOptions:
    """Write a trained policy as files that run without PyTorch."""

    policy: str
    """The folder of a training run, or a Hub id."""
    out: Path
    """The folder for policy.onnx and config.yaml."""
