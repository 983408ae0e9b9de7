"""What counts of stacked bags: that they fill a pattern, or that their tower has been taken apart.

All heights are of bags' middles, the mean heights of their surface points, for a fill of 1. In the simulator towers of
two to four bags, laid straight, have their lowest bag at 7 to 10 mm, and each other one 16 to 25 mm above the one below
it; a bag over the gap between two lies 12 to 22 mm above their mean. A bag that has sunk into the one below it, cloth
caught in cloth, lies 15 mm too low: at most 10 mm above it, and 7 over a gap.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import takewhile

import numpy as np

from baggie.geometry import PlanarPose, Rectangle, wrap_angle
from baggie.robot.limits import WORKSPACE
from baggie.tasks.conditions import State, Tool
from baggie.tasks.pattern import SUPPORT_M, Pattern, PatternSlot
from baggie.types import PickPlace

NEAR_M = 0.02
"""A bag whose middle is at most so far beside where it belongs is right there."""
ON_TABLE_M = 0.017
"""A bag lower than this lies on the table."""
STRAIGHT_RISE_M, BRIDGE_RISE_M, MOST_RISE_M = 0.011, 0.008, 0.033
"""By how much a bag lies above what carries it: at least, straight on one bag, and over a gap; and at most."""
UNDER_M = 0.045
"""What is so near to a place, seen from above, is under a bag that is laid there."""
LAID_ANEW_M = 0.01
"""A bag further than this from where it was to be is laid anew before others are laid on it: what leans falls."""
_IN_THE_WAY_M = 0.11
"""What lies nearer to a place than this is in the way of a bag laid there."""
_ASIDE_M, _STEP_M, _EDGE_M = 0.16, 0.02, 0.02
"""Of a place where a bag is out of the way: from other bags and slots; from the next one; from the workspace's edge."""


def height_below(state: State, x: float, y: float, without: str) -> float:
    """Metres above the table of the highest surface point within 4.5 cm of a place, of all soft things but one.

    So high lies what would be under a bag there: 0 for the bare table.
    """
    heights = [
        points[np.hypot(*(points[:, :2] - [x, y]).T) <= UNDER_M, 2]
        for name, points in state.points.items()
        if name != without
    ]
    return float(np.concatenate([np.zeros(1), *heights]).max())


@dataclass(frozen=True)
class Stacked:
    """The bags fill all slots of a pattern, one each, any bag any slot, at any angle.

    A bag is right within 2 cm of where it belongs: straight above the one that carries it, or else in its slot. On the
    table it is lower than 17 mm, on others above them by at least 11 mm, 8 over a gap, and at most 33 mm, which is more
    than a layer and less than two; all times the fill.
    """

    bags: tuple[str, ...]
    """By name; at least as many as there are slots."""
    pattern: Pattern
    """In the robot's base frame."""
    workspace: Rectangle = WORKSPACE
    """Where bags that are in the way may be laid aside."""
    symmetry: int = 4
    """How many times a turn the bags look the same; 0 for at any angle."""
    fill: float = 1.0
    """How full the bags are, as `baggie.sim.bag.Bag` says."""
    weight: float = 1.0

    def share(self, state: State) -> float:
        """The share of layers all of whose slots are filled, from below up to the first that is not."""
        at, layers = self.filled(state), self.pattern.layers
        whole = list(takewhile(lambda layer: all(slot in at for slot in layer), layers))
        return len(whole) / len(layers)

    def holds(self, state: State) -> bool:
        """Whether every slot is filled."""
        return len(self.filled(state)) == len(self.pattern.slots)

    def filled(self, state: State) -> dict[int, str]:
        """The bags that are right, by the numbers of the slots that they fill.

        None where what should carry it is not right itself.
        """
        at: dict[int, str] = {}
        for slot in range(len(self.pattern.slots)):
            if all(below in at for below in self.pattern.supports(slot)):
                bag = self._bag_in(slot, at, state)
                if bag is not None:
                    at[slot] = bag
        return at

    def offsets_m(self, state: State) -> tuple[float | None, ...]:
        """How far the bag that fills it is from each slot, by their numbers; None for a slot that none fills."""
        at = self.filled(state)
        return tuple(
            state.places[at[number]].distance(slot.pose) if number in at else None
            for number, slot in enumerate(self.pattern.slots)
        )

    def next_action(self, state: State, _tool: Tool = "hand") -> PickPlace | None:
        """The first slot, in the order of building, gets the nearest bag that fills none and carries nothing.

        A bag that fills its slot but lies more than 1 cm from where it was to be is laid anew before that, while it
        carries nothing. Where another bag is in the way, that one's load or itself goes aside first. Bags are picked
        along their own yaw and laid by the slot's; heights are what the state says of what is below.
        """
        at = self.filled(state)
        for slot in range(len(self.pattern.slots)):
            aim, bag = self._aim(slot, at, state), at.get(slot)
            if bag is None:
                waiting = [each for each in self.bags if each not in at.values()]
                bag = self._next_of(waiting, aim, state)
                in_the_way = [
                    other
                    for other in waiting
                    if other != bag and state.places[other].distance(aim) < _IN_THE_WAY_M
                ]
                return self._carry(bag, self._aside(bag, state) if in_the_way else aim, state)
            if state.places[bag].distance(aim) > LAID_ANEW_M and not self._carries(bag, state):
                return self._carry(bag, aim, state)
        return None

    def _bag_in(self, slot: int, at: dict[int, str], state: State) -> str | None:
        """The bag that fills a slot whose supports are filled."""
        aim = self._aim(slot, at, state)
        there = [
            bag for bag in self.bags if bag not in at.values() and state.places[bag].distance(aim) <= NEAR_M
        ]
        if not there:
            return None
        lowest = min(there, key=lambda bag: _height(bag, state))  # what lies on that is of no layer below it
        height, supports = _height(lowest, state), self.pattern.supports(slot)
        if not supports:
            return lowest if height < ON_TABLE_M * self.fill else None
        rise = height - float(np.mean([_height(at[below], state) for below in supports]))
        least = BRIDGE_RISE_M if self.pattern.straight_on(slot) is None else STRAIGHT_RISE_M
        return lowest if least * self.fill <= rise <= MOST_RISE_M * self.fill else None

    def _aim(self, slot: int, at: dict[int, str], state: State) -> PlanarPose:
        """Where a bag has to be to fill a slot: where the one that it stands straight on truly is, or in the slot."""
        nominal, below = self.pattern.slots[slot].pose, self.pattern.straight_on(slot)
        return nominal if below is None else replace(state.places[at[below]], yaw=nominal.yaw)

    def _next_of(self, waiting: list[str], aim: PlanarPose, state: State) -> str:
        return min(waiting, key=lambda bag: (self._carries(bag, state), state.places[bag].distance(aim)))

    def _carries(self, bag: str, state: State) -> bool:
        """Whether another bag lies on it."""
        return any(
            state.places[bag].distance(state.places[other]) <= SUPPORT_M
            and _height(other, state) - _height(bag, state) >= BRIDGE_RISE_M * self.fill
            for other in self.bags
            if other != bag
        )

    def _carry(self, bag: str, to: PlanarPose, state: State) -> PickPlace:
        lies = state.places[bag]
        turn = wrap_angle(lies.yaw - to.yaw, 2 * np.pi / self.symmetry) if self.symmetry else 0.0
        return PickPlace(
            replace(lies, yaw=to.yaw + turn),
            to,
            pick_on_m=height_below(state, lies.x, lies.y, bag),
            place_on_m=height_below(state, to.x, to.y, bag),
        )

    def _aside(self, bag: str, state: State) -> PlanarPose:
        """The nearest place with no other bag and no slot about; where the bag lies, if there is none."""
        area, lies = self.workspace, state.places[bag]
        x = np.arange(area.x_min + _EDGE_M, area.x_max - _EDGE_M, _STEP_M)
        y = np.arange(area.y_min + _EDGE_M, area.y_max - _EDGE_M, _STEP_M)
        places = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        others = [state.places[other].xy for other in self.bags if other != bag]
        taken = np.array([*others, *(slot.pose.xy for slot in self.pattern.slots)])
        free = places[(np.linalg.norm(places[:, None] - taken, axis=2) >= _ASIDE_M).all(axis=1)]
        if not len(free):
            return lies
        x, y = free[np.linalg.norm(free - lies.xy, axis=1).argmin()]
        return PlanarPose(float(x), float(y), lies.yaw)


@dataclass(frozen=True)
class Unstacked:
    """A stack has been taken apart: its lowest bags lie where they stood, each other one in a free place of its own.

    So those below are where they were, within 2 cm, while those above are taken away.
    """

    bags: tuple[str, ...]
    """By the numbers of the slots in which they stand at first."""
    standing: Pattern
    """What stands at first, robot base frame."""
    places: tuple[PlanarPose, ...]
    """Free places on the table, as many as there are bags above the lowest layer; robot base frame."""
    workspace: Rectangle = WORKSPACE
    symmetry: int = 4
    fill: float = 1.0
    weight: float = 1.0

    @property
    def pattern(self) -> Pattern:
        """Where the bags go that are taken away, all of it on the table."""
        return Pattern(tuple(PatternSlot(pose, 0) for pose in self.places))

    @property
    def flat(self) -> Stacked:
        """The same bags, all of them on the table."""
        lowest = [self.standing.slots[slot] for slot in self.standing.layers[0]]
        return Stacked(
            self.bags, Pattern((*self.pattern.slots, *lowest)), self.workspace, self.symmetry, self.fill
        )

    def share(self, state: State) -> float:
        """The share of free places that are filled; 0 while a bag is in none of them, nor where it stood."""
        at = self.flat.filled(state)
        away = {at[place] for place in range(len(self.places)) if place in at}
        stood = zip(self.bags, self.standing.slots, strict=True)
        if any(bag not in away and state.places[bag].distance(slot.pose) > NEAR_M for bag, slot in stood):
            return 0.0
        return len(away) / len(self.places)

    def holds(self, state: State) -> bool:
        """Whether each bag lies on the table, the lowest where they stood, the others in places of their own."""
        return self.flat.holds(state) and self.share(state) == 1.0

    def next_action(self, state: State, tool: Tool = "hand") -> PickPlace | None:
        """The highest bag goes to the first free place, as bags go to their slots in `Stacked`."""
        return self.flat.next_action(state, tool)


def _height(bag: str, state: State) -> float:
    return float(state.poses[bag][2, 3])
