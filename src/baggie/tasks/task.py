"""What a task is: what lies on the table, where it has to go, and in what order that counts."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from baggie.geometry import FloatArray, PlanarPose, Rectangle
from baggie.options.values import Scenery
from baggie.robot.limits import WORKSPACE
from baggie.sim.cell import Cell, draw_cell
from baggie.sim.objects import Block, Fixture, SceneObject
from baggie.sim.variety import Variety

Tool = Literal["hand", "cup"]
"""What an arm carries."""


@dataclass(frozen=True)
class Slot:
    """Where the middle of a block may end: a pose and a height (metres) in the frame of a fixture, or of the base."""

    pose: PlanarPose
    height_m: float
    frame: str | None = None
    """The fixture's name; None for the robot's base."""

    def T_base_slot(self, poses: Mapping[str, FloatArray]) -> FloatArray:
        """`(4, 4)`, given `T_base_body` of the fixtures by name."""
        T_frame_slot = self.pose.upright(self.height_m)
        return T_frame_slot if self.frame is None else np.asarray(poses[self.frame] @ T_frame_slot)


@dataclass(frozen=True)
class Stage:
    """Blocks that may each fill any of these slots, before the next stage counts.

    What a picture cannot tell apart is listed from the robot's left to its right: the demonstrator goes by this order.
    """

    blocks: tuple[str, ...]
    slots: tuple[Slot, ...]
    """At least as many as there are blocks."""
    weight: float
    """Its share of the reward; those of all stages add up to 1."""
    symmetry: int = 4
    """How many times a turn the blocks look the same: 4 for square ones, 2 for oblong ones; 0 where any yaw counts."""


@dataclass(frozen=True)
class Setting:
    """What a scene is drawn for."""

    things: tuple[SceneObject, ...]
    """The task's own, or what a workcell's file says of them."""
    cell: Cell = field(default_factory=lambda: draw_cell(0))
    """The workcell as it is from day to day."""
    workspace: Rectangle = WORKSPACE
    """Where things may be picked and placed; robot base frame, metres."""
    scenery: Scenery = "plain"
    """How much of the scene varies."""
    seed: tuple[int, ...] = (0,)
    """The integers that name the scene."""


@dataclass(frozen=True)
class Scene:
    """One drawing of a task."""

    things: tuple[SceneObject, ...]
    """Those that play a part, as they are in this scene."""
    poses: Mapping[str, PlanarPose]
    """Where each of them is at first, by name; robot base frame."""
    stages: tuple[Stage, ...] = ()
    """In the order in which they count; none where what counts is the goal that a policy is given."""
    variety: Variety | None = None
    """Table, light and distractors; None for the cell's own."""

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
    """Whether a policy is given a goal in the picture; else the stages say where things go."""
    depth: bool = False
    """Whether the camera's depth is recorded with its pictures."""

    @property
    def blocks(self) -> tuple[Block, ...]:
        """Those of its things that are rigid and can be moved."""
        return tuple(thing for thing in self.things if isinstance(thing, Block))

    def draw(self, rng: np.random.Generator, setting: Setting | None = None) -> Scene:
        """A scene, drawn from a stream; of cell 0 with nothing varied unless a setting is given."""
        return self.draw_scene(rng, setting or Setting(self.things))
