"""What a task is: what lies on the table, where it has to go, and in what order that counts."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from baggie.geometry import FloatArray, PlanarPose
from baggie.sim.blocks import Block, Fixture


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
class Scene:
    """One drawing of a task."""

    blocks: tuple[Block, ...]
    """Those that play a part, as they are in this scene."""
    fixtures: tuple[Fixture, ...]
    poses: Mapping[str, PlanarPose]
    """Where each of them is at first, by name; robot base frame."""
    stages: tuple[Stage, ...]


@dataclass(frozen=True)
class Task:
    """What has to be done, for any number of scenes."""

    name: str
    instruction: str
    """In words, as it is recorded with every attempt."""
    blocks: tuple[Block, ...]
    """All that any scene needs; a scene may give them another size and colour."""
    fixtures: tuple[Fixture, ...]
    """The same; a scene may give them other colours."""
    draw: Callable[[np.random.Generator], Scene]
    """A scene without collisions, within the height map and the arm's reach, by this stream alone."""
    max_steps: int
    """How many picks and places an episode may take, as in Ravens."""
    object_symmetry: int
    """How many times a turn what is carried looks the same: place yaws that far apart come to the same."""
