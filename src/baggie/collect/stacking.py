"""The robot teaches itself to stack: it builds towers and pyramids of bags by itself, and takes them apart again.

Bags are told apart by their colours. In which layer one lies follows from where the robot laid it, as long as the
picture shows it there; one that is seen elsewhere slid off. What nobody laid where it is may lie on anything: it is
felt for, and put onto the table first. No truth is used, and no depth.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from baggie.calibration.image_to_robot.map import ImageToRobot
from baggie.collect.machine import Turn, out_of_reach, within_reach
from baggie.errors import BaggieError
from baggie.geometry import PlanarPose, wrap_angle
from baggie.robot.limits import MARGIN_M
from baggie.seeds import first_fit
from baggie.tasks.pattern import Pattern
from baggie.tasks.stacked import LAID_ANEW_M
from baggie.types import LAYER_M, Failure, Observation, PickPlace, middle_of_layer_m
from baggie.vision.color_mask import Detection, find_bag
from baggie.workcell.workcell import WorkcellSettings

PATTERNS = {"tower:3": 0.35, "tower:4": 0.15, "pyramid:2-1": 0.2, "pyramid:3-2-1": 0.3}
"""What is built, and in which share of cases; where there is no room for it, the first."""
LANDED_M = 0.03
"""A bag seen so near to where it was to land lies there; one laid on others that is seen further away slid off."""
_ANEW = 2
"""One that lies beside its slot is laid there anew, at most so many times in a row."""
_SLIPPED = 3
"""So often may bags slide off one slot; then what was built is taken apart."""
_STIRRED_M = 0.05
"""A bag seen further from where it lay was stirred, and lies nobody knows on what."""
_OVER_M = 0.10
"""Bags whose middles are nearer than this lie on each other."""
_FREE_M = 0.155
"""Between the middle of a bag laid aside and all others."""
_OFF_M = 0.06
"""A bag put on the table that is seen further from where it was let go was lost on the way."""
_UNMOVED_M = 0.02
_LARGEST_STEP_M = 0.03
"""The most that a layer is higher than the one below."""
_WHOLE = 0.8
"""The share of a bag's outline that is seen of one on which nothing lies."""
_TRIES = 200
_MOST_LAYERS = 8


@dataclass(frozen=True)
class Lying:
    """Where a bag is believed to lie."""

    pose: PlanarPose
    layer: int = 0
    """How many bags lie below it, on each other."""
    on: tuple[int, ...] = ()
    """The numbers of those that carry it."""
    sure: bool = True
    """Whether the robot laid it there itself, or sees all of it alone on the table."""


@dataclass(frozen=True)
class _Move:
    """What is done next."""

    bag: int
    to: Lying
    slot: int | None = None
    """Of the pattern; None aside."""


@dataclass
class _Site:
    """What is being built."""

    pattern: Pattern
    """In the robot's base frame."""
    filled: dict[int, int] = field(default_factory=dict)
    """The numbers of bags by those of their slots."""
    slipped: int = 0
    """How often a bag slid off."""
    anew: int = 0
    """How often in a row one was laid anew."""


class Stacking:
    """A `Play`: builds towers and pyramids of bags of different colours, and takes them apart.

    Raises `BaggieError` for fewer than two colours, and a map that is right at one height only.
    """

    def __init__(
        self, image_to_robot: ImageToRobot, settings: WorkcellSettings, rng: np.random.Generator
    ) -> None:
        if len(settings.object_colors) < 2:
            raise BaggieError(
                f"expected bags of at least two colours to stack, got {len(settings.object_colors)}; say the colour of "
                "each in the workcell file"
            )
        if not image_to_robot.height_aware:
            raise BaggieError(
                "expected a map from the picture to the robot that knows more than one height, to stack by, got one at "
                f"{image_to_robot.height_m:g} m only; calibrate at two heights, or with --intrinsics"
            )
        self._settings, self._rng = settings, rng
        self._maps = [image_to_robot.at_height(middle_of_layer_m(layer)) for layer in range(_MOST_LAYERS)]
        self.lying: dict[int, Lying] = {}
        """What is believed, by the bags' numbers."""
        self._site: _Site | None = None
        self._apart = False
        """Whether it is being taken apart."""
        self._hidden = 0
        """How many bags are out of sight, and others are put aside to find them."""
        self._move: _Move | None = None
        self._seen: dict[int, Detection] = {}

    # -- what is seen -------------------------------------------------------------------------------------------

    def find(self, turn: Turn) -> str:
        """Take note of where bags are seen; the trouble where one is neither in sight nor under another."""
        assert turn.before is not None
        self._take_note(turn.before)
        if self._move is not None and turn.outcome is not None and turn.outcome.failure == "missed-grasp":
            self._missed(self._move.bag)
        missing = [n for n in range(len(self._settings.object_colors)) if n not in self._seen]
        hidden = [n for n in missing if not self._carries(n)]
        if hidden and not self._hidden:  # they may lie under any other
            self.lying = {
                n: replace(each, sure=False, layer=max(each.layer, len(hidden)))
                for n, each in self.lying.items()
                if n not in hidden
            }
        if self._hidden and not hidden:  # what lies alone, all of it in sight, lies on the table
            self.lying.update({n: Lying(at) for n in self._on_top() if (at := self._alone(n))})
        self._hidden = len(hidden)
        if hidden and not any(not self.lying[n].sure for n in self._on_top()):
            color = self._settings.object_colors[hidden[0]]
            return f"the bag of colour RGB {color} is not in sight: put it back into the workspace"
        return ""

    def _take_note(self, observation: Observation, moved: _Move | None = None) -> None:
        """Bring what is believed up to date with a picture, after a bag was `moved`."""
        colors = self._settings.object_colors
        found = {n: find_bag(observation.color, color) for n, color in enumerate(colors)}
        self._seen = {n: each for n, each in found.items() if each is not None}
        if moved is not None:
            self.lying.pop(moved.bag, None)
        stirred = []
        for number, seen in self._seen.items():
            if self._carries(number):
                continue  # only its rim shows
            before = moved.to if moved is not None and number == moved.bag else self.lying.get(number)
            at = self._where(seen, before.layer) if before else None
            near = LANDED_M if moved is not None and number == moved.bag else _STIRRED_M
            if before and at and at.distance(before.pose) <= near:
                self.lying[number] = replace(before, pose=at)
            else:
                stirred.append(number)
                self.lying.pop(number, None)
        for number in stirred:
            self.lying[number] = self._settled(number)

    def _settled(self, number: int) -> Lying:
        """Where a bag lies that nobody laid where it is seen: on the table, unless others are there."""
        seen = self._seen[number]
        at = self._where(seen, 0)
        below = [n for n in self._on_top() if self.lying[n].pose.distance(at) < _OVER_M]
        if below:
            layer = min(1 + max(self.lying[n].layer for n in below), _MOST_LAYERS - 1)
            return Lying(self._where(seen, layer), layer, tuple(below), sure=False)
        return Lying(at, self._hidden, sure=self._looks_whole(seen, at) and not self._hidden)

    def _where(self, seen: Detection, layer: int) -> PlanarPose:
        """The pose of a bag seen in a layer, robot base frame; its yaw modulo a quarter turn."""
        to_robot = self._maps[layer]
        x, y = to_robot.to_robot(seen.center)[0]
        return PlanarPose(float(x), float(y), to_robot.yaw_to_robot(seen.center, seen.yaw))

    def _looks_whole(self, seen: Detection, at: PlanarPose) -> bool:
        outline = self._maps[0].to_pixels(at.outline(*self._settings.object_size_m[:2]))
        u, v = outline.T
        area = abs(float(np.dot(u, np.roll(v, -1)) - np.dot(v, np.roll(u, -1)))) / 2
        return seen.area_px >= _WHOLE * area

    def _alone(self, number: int) -> PlanarPose | None:
        """Where on the table a bag lies that is seen whole, and no other near it."""
        if number not in self._seen:
            return None
        at = self._where(self._seen[number], 0)
        near = any(each.pose.distance(at) < _OVER_M for n, each in self.lying.items() if n != number)
        return at if self._looks_whole(self._seen[number], at) and not near else None

    def _carries(self, number: int) -> bool:
        return any(number in each.on for each in self.lying.values())

    def _on_top(self) -> list[int]:
        """The numbers of bags on which no other lies."""
        return [n for n in self.lying if not self._carries(n)]

    # -- what is done -------------------------------------------------------------------------------------------

    def plan(self, turn: Turn) -> str:
        """Choose a bag and where it goes; the trouble where it is out of reach."""
        move = self._next()
        lies, to = self.lying[move.bag], move.to
        grip = within_reach(self._settings, lies.pose)
        if grip is None:
            return out_of_reach(self._settings, lies.pose)
        # A square bag is taken by those of its sides that turn it least; the fingers open as the place says.
        yaw = to.pose.yaw + wrap_angle(lies.pose.yaw - to.pose.yaw, math.pi / 2)
        tallest = max((each.layer + 1 for each in self.lying.values() if each.layer or each.on), default=0)
        self._move, turn.found = move, self._seen[move.bag]
        turn.color, turn.pose = self._settings.object_colors[move.bag], lies.pose
        turn.layers, turn.under = (
            (lies.layer, to.layer),
            tuple(self.lying[n].pose for n in to.on),
        )
        turn.action = PickPlace(
            PlanarPose(*grip, yaw),
            to.pose,
            pick_on_m=self._height(lies, turn),
            place_on_m=to.layer * LAYER_M,
            tallest_m=tallest * _LARGEST_STEP_M,
        )
        return ""

    def _height(self, lies: Lying, turn: Turn) -> float | None:
        """How high lies what is below a bag: as it counts, or, where nobody knows and the arm can, to be felt for."""
        feels = turn.cell.arm.info.feels_n <= turn.cell.settings.handling.top_force_n
        return lies.layer * LAYER_M if lies.sure or not feels else None

    def judge(self, turn: Turn) -> Failure | None:
        """See where the bag came to lie."""
        assert turn.after is not None
        assert turn.outcome is not None
        assert turn.pose is not None
        move, failure = self._move, turn.outcome.failure
        assert move is not None
        held = failure not in ("missed-grasp", "unreachable")
        self._take_note(turn.after, move if held else None)
        turn.found_after = self._seen.get(move.bag)
        landed = self.lying.get(move.bag)
        if not held:
            self._missed(move.bag)
            return failure
        if landed is None or turn.found_after is None:
            return "lost-bag"
        self._score(move, landed)
        if landed.layer != move.to.layer or landed.on != move.to.on:
            return failure or "slid-off"
        if landed.pose.distance(turn.pose) < _UNMOVED_M and move.to.pose.distance(turn.pose) > LANDED_M:
            return failure or "stalled"
        # Fingers that held a thin fold seem empty; where it is seen to lie tells whether it was lost on the way.
        return "dropped" if landed.pose.distance(turn.outcome.executed.place) > _OFF_M else None

    def _missed(self, bag: int) -> None:
        """Doubt what is believed of a bag that was not there; the second time it lies lower."""
        if bag in self.lying:
            lies = self.lying[bag]
            self.lying[bag] = replace(lies, sure=False, layer=max(lies.layer - (not lies.sure), 0))

    def _score(self, move: _Move, landed: Lying) -> None:
        """Take note of whether a slot is filled now."""
        site = self._site
        if site is None or move.slot is None:
            return
        if landed.layer == move.to.layer and landed.on == move.to.on:
            again = site.filled.get(move.slot) == move.bag
            site.filled[move.slot], site.anew = move.bag, site.anew + 1 if again else 0
        else:
            site.filled.pop(move.slot, None)
            site.slipped += 1

    def _next(self) -> _Move:
        """What is done next: first what nobody knows is cleared up, then built, then taken apart."""
        doubtful = [n for n in self._on_top() if not self.lying[n].sure]
        if doubtful:
            return self._aside(max(doubtful, key=lambda n: self.lying[n].layer))
        if self._site is None:
            self._site, self._apart = self._drawn(), False
        if self._site is not None and not self._apart:
            step = self._build(self._site)
            if step is not None:
                return step
            self._apart = True
        high = [n for n in self._on_top() if self.lying[n].layer]
        self._site = self._site if high else None
        loose = high or self._on_top()
        top = max(self.lying[n].layer for n in loose)
        return self._aside(self._any([n for n in loose if self.lying[n].layer == top]))

    def _build(self, site: _Site) -> _Move | None:
        """The next bag for a slot; None where all are filled, or too many slid off, or what stands is askew."""
        pattern = site.pattern
        for slot, bag in list(site.filled.items()):
            lies = self.lying.get(bag)
            right = lies is not None and lies.layer == pattern.slots[slot].layer
            if lies is None or not right or lies.pose.distance(self._aim(site, slot).pose) > _STIRRED_M:
                del site.filled[slot]
        askew = any(not self._carried(site, slot) for slot in site.filled)
        if askew or site.slipped >= _SLIPPED:
            return None
        for slot in range(len(pattern.slots)):
            aim = self._aim(site, slot)
            if slot in site.filled:
                bag = site.filled[slot]
                off = self.lying[bag].pose.distance(aim.pose) > LAID_ANEW_M
                if off and not self._carries(bag) and site.anew < _ANEW:
                    return _Move(bag, aim, slot)
                continue
            waiting = [n for n in self._on_top() if not self.lying[n].layer and n not in site.filled.values()]
            if not waiting:
                return None
            in_the_way = [n for n in waiting if self.lying[n].pose.distance(aim.pose) < _OVER_M]
            if len(in_the_way) > 1 or (in_the_way and aim.layer):
                return self._aside(in_the_way[0])
            return _Move(in_the_way[0] if in_the_way else self._any(waiting), aim, slot)
        return None

    def _carried(self, site: _Site, slot: int) -> bool:
        """Whether all that should carry a slot is filled."""
        return all(below in site.filled for below in site.pattern.supports(slot))

    def _aim(self, site: _Site, slot: int) -> Lying:
        """Where a bag has to lie to fill a slot: over the middle of those that carry it, as they truly lie."""
        wanted = site.pattern.slots[slot]
        on = tuple(site.filled[below] for below in site.pattern.supports(slot) if below in site.filled)
        if not on:
            return Lying(wanted.pose, wanted.layer)
        x, y = np.mean([self.lying[n].pose.xy for n in on], axis=0)
        return Lying(PlanarPose(float(x), float(y), wanted.pose.yaw), wanted.layer, on)

    def _aside(self, bag: int) -> _Move:
        """A free place on the table for a bag: the freest of those drawn where none is free."""
        others = [each.pose for n, each in self.lying.items() if n != bag or not each.sure]

        def room(pose: PlanarPose) -> float:
            return min((pose.distance(other) for other in others), default=math.inf)

        drawn = list(self._places())
        free = next((pose for pose in drawn if room(pose) >= _FREE_M), None)
        return _Move(bag, Lying(free or max(drawn, key=room)))

    def _places(self) -> Iterator[PlanarPose]:
        """Draw poses anywhere in the workspace."""
        for _ in range(_TRIES):
            x, y = self._settings.workspace.sample(self._rng, MARGIN_M)
            yield PlanarPose(float(x), float(y), float(self._rng.uniform(-math.pi / 4, math.pi / 4)))

    def _drawn(self) -> _Site | None:
        """A pattern and a site for it, which begins at a bag that lies there; None where there is room for none."""
        words = list(PATTERNS)
        drawn = words[self._rng.choice(len(words), p=list(PATTERNS.values()))]
        for pattern in map(Pattern.parse, (drawn, words[0])):
            if len(pattern.slots) <= len(self.lying):
                found = first_fit(partial(self._somewhere, pattern), self._fits, _TRIES)
                if found is not None:
                    return found
        return None

    def _somewhere(self, pattern: Pattern) -> _Site:
        """A pattern with its first slot where a loose bag lies, turned at will about it."""
        bag = self._any(self._on_top())
        lies = self.lying[bag].pose
        turns = self._rng.integers(4) if len(pattern.layers[0]) > 1 else 0
        first = pattern.slots[0].pose
        yaw = lies.yaw + turns * math.pi / 2 - first.yaw
        site = PlanarPose(lies.x, lies.y, yaw) @ PlanarPose(-first.x, -first.y)
        return _Site(pattern.at(site), {0: bag})

    def _fits(self, site: _Site) -> bool:
        """Whether the workspace holds a site, and no other bag lies on it."""
        area, (anchor,) = self._settings.workspace, site.filled.values()
        base = [site.pattern.slots[n].pose for n in site.pattern.layers[0]]
        others = [each.pose for n, each in self.lying.items() if n != anchor]
        return all(area.contains(pose.x, pose.y, 0.0) for pose in base) and all(
            pose.distance(other) >= _FREE_M for pose in base[1:] for other in others
        )

    def _any(self, numbers: Sequence[int]) -> int:
        return int(self._rng.choice(numbers))
