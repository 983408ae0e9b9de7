"""What a task is: what lies on the table, where it has to go, and in what order that counts."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np

from baggie.errors import BaggieError, in_a_line
from baggie.geometry import PlanarPose, Rectangle
from baggie.options.values import Scenery
from baggie.robot.limits import WORKSPACE
from baggie.sim.cell import Cell, draw_cell
from baggie.sim.objects import Block, Fixture, Pose, SceneObject
from baggie.sim.variety import Variety
from baggie.tasks.conditions import AtGoal, Condition, State, Tool
from baggie.tasks.pattern import Pattern
from baggie.types import PickPlace


@dataclass(frozen=True)
class Setting:
    """What a scene is drawn for."""

    things: tuple[SceneObject, ...]
    """The task's own, or what a workcell's file says of them."""
    given_cell: Cell | None = None
    """The workcell as it is from day to day; None for cell 0."""
    workspace: Rectangle = WORKSPACE
    """Where things may be picked and placed; robot base frame, metres."""
    scenery: Scenery = "plain"
    """How much of the scene varies."""
    seed: tuple[int, ...] = (0,)
    """The integers that name the scene."""

    @cached_property
    def cell(self) -> Cell:
        """The workcell as it is from day to day; cell 0 is drawn only for a task that looks at it."""
        return draw_cell(0) if self.given_cell is None else self.given_cell


@dataclass(frozen=True)
class Scene:
    """One drawing of a task."""

    things: tuple[SceneObject, ...]
    """Those that play a part, as they are in this scene."""
    poses: Mapping[str, PlanarPose]
    """Where each of them is at first, by name; robot base frame."""
    conditions: tuple[Condition, ...] = ()
    """What counts, in this order; none where that is the goal that a policy is given."""
    heights_m: Mapping[str, float] = field(default_factory=dict)
    """How high the middles of those are at first that stand on others, by name; all else lies on the table."""
    variety: Variety | None = None
    """Table, light and distractors; None for the cell's own."""

    @property
    def starts(self) -> dict[str, Pose]:
        """Where each of them is at first, by name: on the table, or `T_base_body` `(4, 4)` on others."""
        on_others = {name: self.poses[name].upright(height) for name, height in self.heights_m.items()}
        return {**self.poses, **on_others}

    @property
    def carried(self) -> SceneObject:
        """What goes to the goal, where a policy is given one: the first thing that can be moved."""
        return next(thing for thing in self.things if thing.movable)

    @property
    def staying(self) -> tuple[str, ...]:
        """The names of all else that can be moved, and stays where it is where a policy is given a goal."""
        return tuple(t.name for t in self.things if t.movable and t.name != self.carried.name)

    def with_goal(self, goal: PlanarPose, symmetry: int) -> Scene:
        """The scene in which the thing carried, which looks the same `symmetry` times a turn, has to lie at a goal."""
        return replace(self, conditions=(AtGoal(self.carried.name, goal, symmetry),))

    @property
    def blocks(self) -> tuple[Block, ...]:
        """Those of its things that are rigid and can be moved."""
        return tuple(thing for thing in self.things if isinstance(thing, Block))

    @property
    def fixtures(self) -> tuple[Fixture, ...]:
        """Those that stay where they are."""
        return tuple(thing for thing in self.things if isinstance(thing, Fixture))


@dataclass(frozen=True)
class Task:
    """What has to be done, for any number of scenes."""

    name: str
    instruction: str
    """In words, as it is recorded with every attempt."""
    tool: Tool
    """What the arm carries."""
    view: Literal["camera", "height-map"]
    """What a policy sees: the overhead camera's picture, or the table from straight above with heights."""
    things: tuple[SceneObject, ...]
    """All that any scene needs; a scene may give them another size and colour."""
    draw_scene: Callable[[np.random.Generator, Setting], Scene]
    """Draws one without collisions, where the camera sees it and the arm reaches, by this stream and setting alone."""
    max_steps: int
    """How many picks and places an episode may take."""
    object_symmetry: int
    """How many times a turn what is carried looks the same: place yaws that far apart come to the same."""
    has_goal: bool = False
    """Whether a policy is given a goal in the picture; else the conditions say where things go."""
    pattern: Pattern | None = None
    """Of stacked bags: what they are stacked in, in the pattern's own frame."""
    depth: bool = False
    """Whether the camera's depth is recorded with its pictures."""
    workspace: Rectangle = WORKSPACE
    """Where a hand picks and places in its scenes unless a workcell's file says otherwise; a cup goes all over the
    table. Robot base frame, metres.
    """

    def __post_init__(self) -> None:
        if not any(thing.movable for thing in self.things):
            raise BaggieError(
                f"expected something that can be carried among the things of {self.name}, got "
                f"{', '.join(thing.name for thing in self.things) or 'none'}; add a Block or a Bag"
            )
        soft = [thing.name for thing in self.things if thing.soft]
        if self.tool == "cup" and soft:
            raise BaggieError(
                f"expected rigid things only in {self.name}, as no cup seals on soft ones, got {', '.join(soft)}; take "
                "the tool hand"
            )

    @property
    def blocks(self) -> tuple[Block, ...]:
        """Those of its things that are rigid and can be moved."""
        return tuple(thing for thing in self.things if isinstance(thing, Block))

    def draw(self, rng: np.random.Generator, setting: Setting | None = None) -> Scene:
        """A scene, drawn from a stream; of cell 0 with nothing varied unless a setting is given.

        Raises `BaggieError`, as its conditions then do, where code of the task's own raises anything.
        """
        with _naming("draw_scene", self.name):
            scene = self.draw_scene(rng, setting or Setting(self.things, workspace=self.workspace))
            conditions = (
                each if type(each).__module__.startswith("baggie.") else _Own(each, self.name)
                for each in scene.conditions
            )
            return replace(scene, conditions=tuple(conditions))


@contextmanager
def _naming(what: str, task: str) -> Iterator[None]:
    """Raise `BaggieError` with the name of a task where this code of its own raises."""
    try:
        yield
    except BaggieError:
        raise
    except Exception as error:  # whatever somebody else's code may raise
        raise BaggieError(
            f"expected no error in {what} of the task {task}, got {in_a_line(error)}; mend it: check_task of "
            "baggie.collect.task_contract shows where"
        ) from error


@dataclass(frozen=True)
class _Own:
    """A condition of a class of a task's own, whose errors name the task."""

    condition: Condition
    task: str

    @property
    def weight(self) -> float:
        """As the condition has it."""
        with self._named("weight"):
            return self.condition.weight

    def share(self, state: State) -> float:
        """As the condition says."""
        with self._named("share"):
            return self.condition.share(state)

    def holds(self, state: State) -> bool:
        """As the condition says."""
        with self._named("holds"):
            return self.condition.holds(state)

    def next_action(self, state: State, tool: Tool) -> PickPlace | None:
        """As the condition says."""
        with self._named("next_action"):
            return self.condition.next_action(state, tool)

    def _named(self, what: str) -> AbstractContextManager[None]:
        return _naming(f"{type(self.condition).__name__}.{what}", self.task)
