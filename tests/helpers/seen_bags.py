"""Bags that lie in layers before a drawn camera, a hand that lands them as told, and an eye for what lies on top."""

from __future__ import annotations

import colorsys
from collections import deque
from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from baggie.errors import BaggieError
from baggie.geometry import PlanarPose, Rectangle
from baggie.policies.base import Policy
from baggie.tasks.conditions import State
from baggie.tasks.pattern import LAYER_M, SUPPORT_M
from baggie.types import Goal, Observation, Outcome, PickPlace, Plan
from baggie.workcell.workcell import Workcell, WorkcellSettings, middle_m
from helpers.stacks import ON_TABLE_M, lying
from helpers.synthetic import image_to_robot, to_pixels

SIZE = (640, 360)
AREA = Rectangle(0.29, 0.68, -0.36, 0.36)
_NEAR_PX = 50.0
"""So near to a click a bag is looked for, some 10 cm."""


class BagTable(Workcell):
    """Bags by number, each at a pose in a layer; what is laid lands off by what is next in `lands`, metres.

    There `miss` is a grasp that closes on nothing, `drop` a bag that is lost on the way, and `thin` one that lands 2 cm
    beside, held by so thin a fold that it seems to have been lost.
    """

    one_color = False

    def __init__(self, bags: Sequence[PlanarPose], lands: Sequence[tuple[float, float] | str] = ()) -> None:
        self.settings = WorkcellSettings(workspace=AREA)
        self.bags = {number: (pose, 0) for number, pose in enumerate(bags)}
        self.lands = deque(lands)
        self.done: list[PickPlace] = []

    def state(self) -> State:
        return lying(
            {f"bag {n}": (pose, ON_TABLE_M + layer * LAYER_M) for n, (pose, layer) in self.bags.items()}
        )

    def look(self) -> Observation:
        picture = np.full((SIZE[1], SIZE[0], 3), 90, np.uint8)
        for number, (pose, layer) in sorted(self.bags.items(), key=lambda each: each[1][1]):
            color = colorsys.hsv_to_rgb(0.0 if self.one_color else number / 8, 0.8, 200)
            cv2.fillPoly(picture, [self.outline(pose, layer).round().astype(np.int32)], color)
        return Observation(picture)

    def outline(self, pose: PlanarPose, layer: int = 0) -> np.ndarray:
        length, width, _ = self.settings.object_size_m
        return to_pixels(np.c_[pose.outline(length, width), np.full(4, middle_m(self.settings, layer))], SIZE)

    def tops(self) -> dict[int, tuple[PlanarPose, int]]:
        """The bags that nothing lies on."""
        return {number: at for number, at in self.bags.items() if not self._on(number)}

    def _on(self, number: int) -> list[int]:
        pose, layer = self.bags[number]
        return [
            other
            for other, (there, above) in self.bags.items()
            if above == layer + 1 and there.distance(pose) <= SUPPORT_M
        ]

    def carry_out(self, plan: Plan) -> Outcome:
        action, lands = plan.action, self.lands.popleft() if self.lands else (0.0, 0.0)
        self.done.append(action)
        near = {n: pose for n, (pose, _) in self.tops().items() if pose.distance(action.pick) < 0.03}
        if lands == "miss" or not near:
            return Outcome(action, "missed-grasp")
        number = min(near, key=lambda n: near[n].distance(action.pick))
        assert action.pick_on_m == self.bags[number][1] * LAYER_M
        del self.bags[number]
        off = {"drop": (0.0, 0.3), "thin": (0.0, 0.02)}[lands] if isinstance(lands, str) else lands
        pose = replace(action.place, x=action.place.x + off[0], y=action.place.y + off[1])
        below = [layer for there, layer in self.bags.values() if there.distance(pose) <= SUPPORT_M]
        self.bags[number] = (pose, 1 + max(below, default=-1))
        return Outcome(action, "dropped" if isinstance(lands, str) else None)


class Eye(Policy):
    """Sees the bags that nothing lies on through the camera of a cell; which one it picks first its heat map says."""

    name = "eye"
    wants_goal = True

    def __init__(self, cell: BagTable, pick_within_m: float | None = None) -> None:
        self.cell, self.pick_within_m = cell, pick_within_m

    def seen(self) -> list[tuple[PlanarPose, int]]:
        """Poses and layers of the bags that nothing lies on."""
        return list(self.cell.tops().values())

    def plan(self, observation: Observation, goal: Goal | None = None) -> Plan:
        assert goal is not None
        tops = self.seen()
        outlines = [self.cell.outline(pose, layer) for pose, layer in tops]
        pixels = np.mean(outlines, axis=1)
        number = 0
        if goal.object_at is not None:
            apart = np.hypot(*(pixels - goal.object_at).T)
            number = int(apart.argmin())
            if apart[number] > _NEAR_PX:
                raise BaggieError("no bag in sight")
        heat = np.zeros((SIZE[1] // 4, SIZE[0] // 4), np.float32)
        for share, (u, v) in zip(np.geomspace(1.0, 0.3, len(tops)), pixels, strict=True):
            cv2.circle(heat, (round(u / 4), round(v / 4)), 2, float(share), cv2.FILLED)
        pick = self._place(outlines[number], goal.object_layer)
        place = self._place(goal.corners, goal.layer)
        action = PickPlace(pick, place, goal.object_layer * LAYER_M, goal.layer * LAYER_M)
        return Plan(action, pick_within_m=self.pick_within_m, views={"pick": heat})

    def _place(self, corners: np.ndarray, layer: int) -> PlanarPose:
        """Where what appears with these corners lies in a layer."""
        at = image_to_robot(SIZE).at_height(middle_m(self.cell.settings, layer))
        x, y = at.to_robot(corners).mean(axis=0).tolist()
        return PlanarPose(x, y)
