"""What counts of a task: conditions on where things are, judged strictly and with partial credit.

Zeng et al., "Transporter Networks", CoRL 2020: a block counts where it is within 1 cm and 15 degrees of a slot.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, Protocol, Self

import numpy as np
from numpy.typing import ArrayLike

from baggie.geometry import FloatArray, PlanarPose, planar_pose, wrap_angle
from baggie.types import PickPlace

Tool = Literal["hand", "cup"]
"""What an arm carries."""

POSITION_M = 0.01
HEIGHT_M = 0.01
ANGLE_RAD = np.deg2rad(15.0)
STANDS_S = 2.0
"""For so long everything stays as it is where a task is done, strictly."""

Poses = Mapping[str, FloatArray]
"""`T_base_body` `(4, 4)` of things, by name."""


@dataclass(frozen=True)
class State:
    """Where things are at one moment, robot base frame: a simulator's truth, or what a picture showed."""

    poses: Poses
    places: Mapping[str, PlanarPose]
    """By name, where each thing's middle is above the table, and which way its x axis points."""
    obstacles: tuple[PlanarPose, ...] = ()
    """Where other things stand, which a hand or a bag can run into."""
    points: Mapping[str, FloatArray] = field(default_factory=dict)
    """By name, `(P, 3)` metres: points on the surface of what is soft."""

    @classmethod
    def of(cls, poses: Poses) -> Self:
        """The state in which things are at these poses, none of them soft, and nothing stands about."""
        return cls(poses, {name: planar_pose(T) for name, T in poses.items()})


class Condition(Protocol):
    """Something that has to become so; a task of one's own may bring a class of its own."""

    @property
    def weight(self) -> float:
        """The condition's share of the reward; those of all of a scene's conditions add up to 1."""
        ...

    def share(self, state: State) -> float:
        """How much of it is so, from 0 to 1, with partial credit as Ravens gives it."""
        ...

    def holds(self, state: State) -> bool:
        """Whether it is so, strictly."""
        ...

    def next_action(self, state: State, tool: Tool) -> PickPlace | None:
        """What a demonstrator, who knows the state, does next to make it so; None where nothing is left to do."""
        ...


@dataclass(frozen=True)
class Slot:
    """Where the middle of a thing may end: a pose and a height (metres) in the frame of a fixture, or of the base."""

    pose: PlanarPose
    height_m: float
    frame: str | None = None
    """The fixture's name; None for the robot's base."""

    def T_base_slot(self, poses: Poses) -> FloatArray:
        """`(4, 4)`, given `T_base_body` of the fixtures by name."""
        T_frame_slot = self.pose.upright(self.height_m)
        return T_frame_slot if self.frame is None else np.asarray(poses[self.frame] @ T_frame_slot)


@dataclass(frozen=True)
class InSlots:
    """Each of these things is in one of these slots.

    What a picture cannot tell apart is listed from the robot's left to its right: the demonstrator goes by this order.
    """

    blocks: tuple[str, ...]
    """The things, by name."""
    slots: tuple[Slot, ...]
    """At least as many as there are blocks."""
    weight: float
    symmetry: int = 4
    """How many times a turn the blocks look the same: 4 for square ones, 2 for oblong ones; 0 where any yaw counts."""

    def share(self, state: State) -> float:
        """The share of blocks that count for any slot: no heights are asked for, and several may count for one slot."""
        slots = [slot.T_base_slot(state.poses) for slot in self.slots]
        inside = sum(
            any(counts(state.poses[block], slot, self.symmetry) for slot in slots) for block in self.blocks
        )
        return inside / len(self.blocks)

    def holds(self, state: State) -> bool:
        """Whether every block is, upright and at the right height, in a slot of its own."""
        return len(self.filled(state.poses)) == len(self.blocks)

    def next_action(self, state: State, tool: Tool = "cup") -> PickPlace | None:
        """The first block that fills no slot goes to the lowest free slot, the first of equally low ones.

        It is picked by its middle, by a cup at yaw 0 and by a hand along the block. The blocks' and the slots' order is
        one that a picture decides, so that what is demonstrated can be learned. Of the yaws that come to the same it
        is the one that turns the wrist least.
        """
        left = self.remaining(state.poses)
        if left is None:
            return None
        T_base_block = state.poses[left.blocks[0]]
        action = carry(T_base_block, left.slots[0].T_base_slot(state.poses), self.symmetry)
        if tool == "cup" or self.symmetry == 0:
            return action
        along = wrap_angle(yaw_of(T_base_block), 2 * np.pi / self.symmetry)
        pick, place = action.pick, action.place
        return replace(
            action, pick=replace(pick, yaw=along), place=replace(place, yaw=wrap_angle(along + place.yaw))
        )

    def filled(self, poses: Poses) -> dict[str, int]:
        """The slot that each block fills, strictly; no two fill the same, and those that fill none are left out."""
        from scipy.optimize import linear_sum_assignment  # noqa: PLC0415 -- tasks are listed without it

        slots = [slot.T_base_slot(poses) for slot in self.slots]
        fits = np.array(
            [[_fits(poses[block], slot, self.symmetry) for slot in slots] for block in self.blocks]
        )
        pairs = np.transpose(linear_sum_assignment(fits, maximize=True)).tolist()
        return {self.blocks[block]: slot for block, slot in pairs if fits[block, slot]}

    def remaining(self, poses: Poses) -> Remaining | None:
        """What is left to do, or None when every block is in its slot, strictly."""
        at = self.filled(poses)
        waiting = [block for block in self.blocks if block not in at]
        if not waiting:
            return None
        free = [slot for number, slot in enumerate(self.slots) if number not in at.values()]
        lowest = min(slot.height_m for slot in free)
        return Remaining(self, waiting, [slot for slot in free if slot.height_m == lowest])


@dataclass(frozen=True)
class Remaining:
    """What is left to do of blocks that have to be in slots."""

    condition: InSlots
    blocks: Sequence[str]
    """Those that fill no slot, in the condition's order."""
    slots: Sequence[Slot]
    """The lowest of those that are free, in the condition's order: nothing goes where nothing is yet to rest on."""


@dataclass(frozen=True)
class AtGoal:
    """A thing lies on the goal that a policy is given in the picture."""

    name: str
    goal: PlanarPose
    symmetry: int = 4
    """How many times a turn the thing looks the same; 0 for at any angle."""
    radius_m: float = 0.02
    """A thing whose middle is this near the goal's lies on it."""
    weight: float = 1.0

    def share(self, state: State) -> float:
        """1 on the goal, else 0."""
        return float(self.holds(state))

    def holds(self, state: State) -> bool:
        """Whether the thing lies on the goal, at any angle."""
        return state.places[self.name].distance(self.goal) <= self.radius_m

    def next_action(self, state: State, _tool: Tool = "hand") -> PickPlace | None:
        """From where the thing is, along it, to the goal.

        Of the yaws that look the same those that turn the wrist least: others may be out of its reach.
        """
        if self.holds(state):
            return None
        thing, turn = state.places[self.name], 2 * math.pi / self.symmetry if self.symmetry else 0.0
        pick_yaw = wrap_angle(thing.yaw, turn) if turn else 0.0
        place_yaw = pick_yaw + (wrap_angle(self.goal.yaw - pick_yaw, turn) if turn else 0.0)
        return PickPlace(replace(thing, yaw=pick_yaw), replace(self.goal, yaw=place_yaw))


def remaining(conditions: Sequence[Condition], state: State) -> Remaining | None:
    """What is left of the first condition that does not hold, strictly; None where that has no slots, or all hold."""
    first = next((each for each in conditions if not each.holds(state)), None)
    return first.remaining(state.poses) if isinstance(first, InSlots) else None


def carry(
    T_base_block: FloatArray,
    T_base_slot: FloatArray,
    symmetry: int,
    at: ArrayLike = (0.0, 0.0),
    alike: int = 0,
) -> PickPlace:
    """From where a block is to where it has to go, `(4, 4)` both; `symmetry` as in `InSlots`.

    `at` `(2,)`: where it is picked, in its own frame, metres. `alike`: which of the turns that come to the same, of
    `symmetry`; 0 is the least.
    """
    turn = 0.0
    if symmetry:
        turn = wrap_angle(yaw_of(T_base_slot) - yaw_of(T_base_block), 2 * np.pi / symmetry)
        turn = wrap_angle(turn + 2 * np.pi * alike / symmetry) if alike else turn
    beside = T_base_block[:2, :2] @ np.asarray(at, float)
    (from_x, from_y), (to_x, to_y) = (
        T_base_block[:2, 3] + beside,
        T_base_slot[:2, 3] + PlanarPose(0.0, 0.0, turn).matrix()[:2, :2] @ beside,
    )
    return PickPlace(PlanarPose(float(from_x), float(from_y)), PlanarPose(float(to_x), float(to_y), turn))


def counts(T_base_block: FloatArray, T_base_slot: FloatArray, symmetry: int) -> bool:
    """Whether a block counts for a slot as published: within 1 cm and 15 degrees of what looks the same."""
    near = np.hypot(*(T_base_block - T_base_slot)[:2, 3]) < POSITION_M
    turn = yaw_of(T_base_block) - yaw_of(T_base_slot)
    return bool(near and (symmetry == 0 or abs(wrap_angle(turn, 2 * np.pi / symmetry)) < ANGLE_RAD))


def _fits(T_base_block: FloatArray, T_base_slot: FloatArray, symmetry: int) -> bool:
    level = abs(T_base_block[2, 3] - T_base_slot[2, 3]) < HEIGHT_M
    upright = T_base_block[2, 2] > np.cos(ANGLE_RAD)
    return bool(level and upright and counts(T_base_block, T_base_slot, symmetry))


def yaw_of(T: FloatArray) -> float:
    """Radians: which way the x axis points, seen from above."""
    return float(np.arctan2(T[1, 0], T[0, 0]))


class Score:
    """The published reward, from one pick and place to the next.

    Zeng et al., "Transporter Networks", CoRL 2020. The condition at hand earns its share of its weight. As published,
    what is no longer so loses its share again, and a condition that was met once is never looked at again. At most one
    is met at a time.
    """

    def __init__(self, conditions: Sequence[Condition]) -> None:
        self.total = 0.0
        """The reward so far, 1 for all of the task: the partial credit."""
        self._conditions = tuple(conditions)
        self._met = 0

    @property
    def done(self) -> bool:
        """Whether every condition has been met."""
        return self._met == len(self._conditions)

    def count(self, state: State) -> float:
        """How much the total has grown (or shrunk) since the last time, by where everything is now."""
        if self.done:
            return 0.0
        condition, before = self._conditions[self._met], self.total
        share, earned = condition.share(state), 0.0
        if share >= 1.0:
            self._met += 1
        else:
            earned = condition.weight * share
        # Of the sum of all weights, added up alike, so that all of the task is 1 exactly.
        self.total = (_weight(self._conditions[: self._met]) + earned) / _weight(self._conditions)
        return self.total - before


class Standing(Protocol):
    """Of a workcell, what strict success asks."""

    def state(self) -> State | None:
        """Where everything is; None where nobody knows."""
        ...

    def wait(self, seconds: float) -> None:
        """Let time pass."""
        ...


def all_hold(conditions: Sequence[Condition], state: State) -> bool:
    """Whether every condition holds, strictly."""
    return all(condition.holds(state) for condition in conditions)


def strict_success(conditions: Sequence[Condition], cell: Standing, stands_s: float = STANDS_S) -> bool:
    """Whether all conditions hold now and still do after `stands_s` seconds, which pass only if they do now.

    Never so where nobody knows where things are.
    """
    for waited_s in (0.0, stands_s):
        if waited_s:
            cell.wait(waited_s)
        state = cell.state()
        if state is None or not all_hold(conditions, state):
            return False
    return True


def _weight(conditions: Sequence[Condition]) -> float:
    return sum(condition.weight for condition in conditions)
