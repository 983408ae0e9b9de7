"""Patterns of bags, built step by step by a policy that takes goals: from pictures alone, in any workcell.

After each placement the policy is asked where the bag lies that it has laid. What is laid on it goes there, not to
where it should have been; before that, what lies too far from where it was to be is laid anew.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import cv2
import numpy as np

from baggie.errors import BaggieError
from baggie.geometry import FloatArray, PlanarPose
from baggie.policies.memory import Planner
from baggie.tasks.pattern import Pattern, PatternSlot
from baggie.tasks.stacked import LAID_ANEW_M
from baggie.types import LAYER_M, Goal, Observation, Outcome, Plan
from baggie.vision.draw import region_mask
from baggie.workcell.workcell import Workcell

MOST_ANEW = 2
"""How often the bag of a slot is laid anew."""
FALLEN_M = 0.05
"""What is not found so near to where it was laid has fallen: its slot is open again."""
_BESIDE_M = 0.2
"""Where a policy is asked only where a bag lies, the region of its goal is so far from it, as it has learned them."""
_WIDER = 1.15
"""What is built is left out by outlines so many times as wide: nothing next to them is as near as that."""
_ALIKE = 30.0
"""Colours that are nearer in RGB, of 255, may be the same in another light."""
_FAINT = 0.05
"""Of the brightest of a heat map: where nothing beside what is built is brighter, no bag lies there."""

Click = Callable[[Observation, Goal], tuple[float, float]]
"""A pixel (u, v) on the bag that a person wants to go to a goal in the picture."""


@dataclass(frozen=True)
class Care:
    """How much care a builder takes of how bags land; each part can be left out, to see what it is worth."""

    lay_anew: bool = True
    """Whether a bag that landed beside where it was to be is laid there again before others are laid on it."""
    aim_anew: bool = True
    """Whether bags go to where those that carry them truly lie; else to where those should have been."""


@dataclass(frozen=True)
class _Asked:
    """The picture in which the last plan was asked for, and the goal in it, which says which bag is to go there."""

    seen: Observation
    goal: Goal

    def left_as_it_was(self, after: Observation, at: tuple[float, float]) -> bool:
        """Whether a place has the colour still that it had, not that of the bag which was to be laid there.

        So it has where that slid off what it was laid on, which is seen there again. False where the two are alike.
        """
        assert self.goal.object_at is not None
        was, bag = self._color(self.seen, at), self._color(self.seen, self.goal.object_at)
        if np.linalg.norm(was - bag) < _ALIKE:
            return False
        here = self._color(after, at)
        return bool(np.linalg.norm(here - was) < np.linalg.norm(here - bag))

    def _color(self, seen: Observation, at: tuple[float, float]) -> FloatArray:
        """`(3,)`: the median RGB within half of a bag's outline about a pixel."""
        inner = (self.goal.corners - self.goal.center) / 2 + at
        return np.asarray(np.median(seen.color[region_mask(inner, seen.size) > 0], axis=0))


class Builder:
    """Says the next goal of a pattern, and plans for it by a policy that takes goals.

    First `look` at a picture, then `plan` for the goal, then `note` what came of it; `build` does so.
    """

    def __init__(
        self,
        cell: Workcell,
        policy: Planner,
        pattern: Pattern,
        care: Care | None = None,
        standing: Pattern | None = None,
    ) -> None:
        """`pattern`: in the robot's base frame, as `standing` is, what stands there and is taken apart for it.

        Raises `BaggieError` where it leaves the workspace, or a layer is higher than the cell can tell in a picture.
        """
        pattern.check_fits(cell.settings.workspace)
        top = pattern.slots[-1]
        cell.outline(top.pose, top.layer)
        self._cell, self._policy, self._pattern, self._care = cell, policy, pattern, care or Care()
        self._standing = standing
        self._lies: dict[int, PlanarPose] = {}
        self._laid_anew: Counter[int] = Counter()
        self._unseen: int | None = None
        self._asked: _Asked | None = None
        self.slot = 0
        """The number of the slot that the last goal was for."""

    @property
    def lies(self) -> dict[int, PlanarPose]:
        """Where the bags that have been laid lie as the policy sees it, by the numbers of their slots."""
        return dict(self._lies)

    def look(self, seen: Observation) -> Goal | None:
        """Where the next bag has to go in a picture; None where, as far as the pictures tell, all is built.

        The first slot that is open, or whose bag is laid anew: then the goal says where that lies (`object_at`).
        """
        laid, self._unseen = self._unseen, None
        if laid is not None:
            self._find(laid, self._aim(laid), seen, self._asked)
        slot = next(filter(self._wanting, range(len(self._pattern.slots))), None)
        if slot is None:
            return None
        self.slot, layer = slot, self._pattern.slots[slot].layer
        region, lies = self._cell.outline(self._aim(slot), layer), self._lies.get(slot)
        if lies is not None:
            return Goal(region, layer=layer, object_at=self._pixel(lies, layer), object_layer=layer)
        if self._standing is None:
            return Goal(region, layer=layer)
        top = self._still_standing[-1]  # nothing lies on the last that was built
        return Goal(region, layer=layer, object_at=self._pixel(top.pose, top.layer), object_layer=top.layer)

    def plan(self, observation: Observation, goal: Goal | None = None) -> Plan:
        """The policy's plan for the goal that `look` said, a bag chosen by its heat map unless somebody clicked on one.

        Raises `BaggieError` where the policy does, and where there is no bag beside what is built.
        """
        if goal is None:
            raise BaggieError("expected a goal to plan for, got none; give plan the one that look says")
        if goal.object_at is None:
            goal = replace(goal, object_at=self._choice(observation, goal))
        plan = self._policy.plan(observation, goal)
        half = min(self._cell.settings.object_size_m[:2]) / 2
        new = self.slot not in self._lies
        if new and any(plan.action.pick.distance(pose) < half for pose in self._lies.values()):
            raise self._no_bag()
        self._asked = _Asked(observation, goal)
        built = [self._pattern.slots[slot].layer for slot in self._lies]
        tallest = 1 + max([*built, *(each.layer for each in self._still_standing)], default=-1)
        return replace(plan, action=replace(plan.action, tallest_m=tallest * LAYER_M))

    def note(self, outcome: Outcome | None) -> None:
        """Take note of what became of the plan; None where nothing was moved."""
        if self.slot in self._lies:
            self._laid_anew[self.slot] += 1
        if outcome is None or outcome.failure == "missed-grasp":
            return
        # Fingers that held a thin fold seem empty at the end: where it is seen to lie tells whether it was dropped.
        self._unseen = self.slot

    @property
    def _still_standing(self) -> tuple[PatternSlot, ...]:
        """What has not been taken yet of what stood, in the order of building."""
        if self._standing is None:
            return ()
        return self._standing.slots[: len(self._standing.slots) - len(self._lies)]

    def _wanting(self, slot: int) -> bool:
        """Whether a slot is open, or its bag is to be laid anew."""
        if slot not in self._lies:
            return True
        off_m = self._lies[slot].distance(self._aim(slot))
        again = self._care.lay_anew and self._laid_anew[slot] < MOST_ANEW
        return again and off_m > LAID_ANEW_M and not self._carries(slot)

    def _carries(self, slot: int) -> bool:
        return any(slot in self._pattern.supports(above) for above in self._lies)

    def _aim(self, slot: int) -> PlanarPose:
        """Where a bag is to go: off its slot by as much as those are, on the average, that it is laid on."""
        nominal, below = self._pattern.slots[slot].pose, self._pattern.supports(slot)
        if not below or not self._care.aim_anew:
            return nominal
        off = np.mean([self._lies[each].xy - self._pattern.slots[each].pose.xy for each in below], axis=0)
        return replace(nominal, x=nominal.x + float(off[0]), y=nominal.y + float(off[1]))

    def _find(self, slot: int, expected: PlanarPose, seen: Observation, laid: _Asked | None = None) -> None:
        """Take note of where a slot's bag lies; where it has fallen, of what became of those that it was laid on.

        `laid`: what had been asked for when it was laid just now; else it lay there before.
        """
        layer = self._pattern.slots[slot].layer
        found = self._seen_near(expected, layer, seen)
        if found is not None and not (laid and laid.left_as_it_was(seen, self._pixel(found, layer))):
            self._lies[slot] = found
            return
        self._lies.pop(slot, None)
        for below in self._pattern.supports(slot):
            if below in self._lies and not self._carries(below):
                self._find(below, self._lies[below], seen)

    def _seen_near(self, expected: PlanarPose, layer: int, seen: Observation) -> PlanarPose | None:
        """Where the policy would pick a bag that is expected there; None where it sees none, or is unsure."""
        there = self._pixel(expected, layer)
        area = self._cell.settings.workspace
        inwards = (area.y_min + area.y_max) / 2 - expected.y
        beside = replace(expected, y=expected.y + math.copysign(_BESIDE_M, inwards))
        try:
            plan = self._policy.plan(
                seen, Goal(self._cell.outline(beside), object_at=there, object_layer=layer)
            )
        except BaggieError:
            return None
        radius, limit = plan.pick_within_m, self._cell.settings.sure_within_m
        near = plan.action.pick.distance(expected) <= FALLEN_M
        return plan.action.pick if near and (radius is None or radius <= limit) else None

    def _choice(self, seen: Observation, goal: Goal) -> tuple[float, float]:
        """A pixel on the bag that the policy would pick first, of those that are not built already."""
        plan = self._policy.plan(seen, goal)
        if "pick" not in plan.views:
            return self._pixel(plan.action.pick, 0)
        height, width = plan.views["pick"].shape
        factors = width / seen.size[0], height / seen.size[1]
        # Of two bags the one with more of the map about it: what is left at the edge of another is a speck.
        side_px = float(np.ptp(Goal(goal.corners).scaled(*factors).corners, axis=0).mean())
        heat = cv2.GaussianBlur(plan.views["pick"], (0, 0), max(side_px / 6, 0.5))
        brightest = heat.max()
        for slot, pose in self._lies.items():
            corners = self._cell.outline(pose, self._pattern.slots[slot].layer)
            wider = corners.mean(axis=0) + _WIDER * (corners - corners.mean(axis=0))
            heat[region_mask(Goal(wider).scaled(*factors).corners, (width, height)) > 0] = 0.0
        if not heat.max() > _FAINT * brightest:
            raise self._no_bag()
        v, u = np.unravel_index(int(heat.argmax()), heat.shape)
        at_u, at_v = ((np.array([u, v]) + 0.5) / factors - 0.5).tolist()
        return at_u, at_v

    def _pixel(self, pose: PlanarPose, layer: int) -> tuple[float, float]:
        """Where the middle of a bag at a pose in a layer appears."""
        u, v = np.asarray(self._cell.outline(pose, layer)).mean(axis=0).tolist()
        return u, v

    def _no_bag(self) -> BaggieError:
        return BaggieError(
            f"expected a bag for slot {self.slot + 1} of {len(self._pattern.slots)} beside what is built, found none; "
            "put one into view, away from the pattern"
        )


@dataclass(frozen=True)
class BuildStep:
    """One pick and place of a pattern."""

    slot: int
    """The number of the slot that it was for."""
    goal: Goal
    plan: Plan
    outcome: Outcome


def build(
    cell: Workcell,
    policy: Planner,
    pattern: Pattern,
    site: PlanarPose,
    *,
    standing: Pattern | None = None,
    care: Care | None = None,
    click: Click | None = None,
) -> Iterator[BuildStep]:
    """Build a pattern whose own frame is at `site`, robot base frame, a pick and place a step; ends when all is built.

    for step in build(cell, policy, Pattern.parse("pyramid:3-2-1"), PlanarPose(0.5, 0.1)):
        print(step.slot, step.outcome.failure)

    `standing`, robot base frame, is taken apart for it, from above. Else `click` is asked for each new bag; unless
    given the policy chooses. Raises `BaggieError` where the pattern leaves the workspace, the policy finds no bag or is
    unsure, or the arm does not reach; called again it begins anew.
    """
    builder = Builder(cell, policy, pattern.at(site), care, standing)
    while (goal := builder.look(seen := cell.look())) is not None:
        if click is not None and goal.object_at is None:
            goal = replace(goal, object_at=click(seen, goal))
        plan = builder.plan(seen, goal)
        outcome = cell.carry_out(plan)
        builder.note(outcome)
        yield BuildStep(builder.slot, goal, plan, outcome)
