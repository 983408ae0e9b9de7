"""A kinematic workcell for tests in which bags of several colours lie on each other."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from baggie import seeds
from baggie.geometry import FloatArray, PlanarPose
from baggie.options.values import Color
from baggie.tasks.bag_stacks import WORKSPACE, colored_bags
from baggie.tasks.pattern import LAYER_M
from baggie.types import Observation, Outcome, PickPlace
from baggie.workcell.workcell import Calibrations, Workcell, WorkcellSettings
from helpers.fake_workcell import FakeArm, draw_polygon, tilted_camera

SIZE = (1280, 720)
SETTINGS = WorkcellSettings(
    workspace=WORKSPACE, object_symmetry=2, object_colors=tuple(bag.color for bag in colored_bags(6))
)
REACH_M, OVER_M = 0.045, 0.10


class StackCamera:
    """Looks at the bags of a cell."""

    name, size = "top", SIZE

    def __init__(self, cell: FakeStacks) -> None:
        self._cell = cell
        self.intrinsics, self._transform = tilted_camera(SIZE)

    def project(self, points: FloatArray) -> FloatArray:
        """`(N, 3)` metres, robot base -> `(N, 2)` pixels."""
        rotation, _ = cv2.Rodrigues(self._transform[:3, :3])
        lens = self.intrinsics
        pixels, _ = cv2.projectPoints(points, rotation, self._transform[:3, 3], lens.matrix, lens.distortion)
        return np.asarray(pixels.reshape(-1, 2))

    def look(self) -> Observation:
        """The picture now: the lower bags first."""
        image = np.full((SIZE[1], SIZE[0], 3), (165, 150, 130), np.uint8)
        for bag in sorted(self._cell.layers, key=lambda bag: self._cell.layers[bag]):
            if bag in self._cell.gone:
                continue
            outline, bottom = self._cell.poses[bag].outline(0.12, 0.12), self._cell.layers[bag] * LAYER_M
            solid = np.concatenate([np.c_[outline, np.full(4, z)] for z in (bottom, bottom + LAYER_M)])
            hull = cv2.convexHull(self.project(solid).astype(np.float32)).reshape(-1, 2)
            draw_polygon(image, hull, self._cell.settings.object_colors[bag])
        return Observation(image, None, self.intrinsics)


class FakeStacks(Workcell):
    """Six bags; `script` says what goes wrong in the next executions, `""` for nothing, `slid-off` or `missed-grasp`.

    A hand that does not come down to where the bag lies, within 15 mm, misses it.
    """

    repeatable = True

    def __init__(self, script: Sequence[str] = ()) -> None:
        self.arm, self.settings, self.camera = FakeArm(), SETTINGS, StackCamera(self)
        self.calibrations, self.watch, self.scene = Calibrations(), None, None
        self.script = list(script)
        self.gone: set[int] = set()
        self.executed: list[PickPlace] = []
        self.reset((0,))

    def reset(self, seed: Sequence[int]) -> None:
        """All bags on the table, apart."""
        self.rng = seeds.generator(*seed)
        places = [(x, y) for x in (0.36, 0.60) for y in (-0.25, 0.0, 0.25)]
        yaws = self.rng.uniform(-0.7, 0.7, 6)
        self.poses = {n: PlanarPose(*places[n], float(yaws[n])) for n in range(6)}
        self.layers = dict.fromkeys(range(6), 0)

    def pile(self, *bags: int) -> None:
        """Put these bags on each other, the first below."""
        for layer, bag in enumerate(bags):
            self.poses[bag], self.layers[bag] = self.poses[bags[0]], layer

    def carries(self, bag: int) -> bool:
        """Whether another bag lies on it."""
        return any(
            self.layers[other] > self.layers[bag] and self.poses[other].distance(self.poses[bag]) < OVER_M
            for other in self.poses
        )

    def look(self) -> Observation:
        return self.camera.look()

    def clock(self) -> float:
        return 0.0

    def truth(self, color: Color | None = None) -> PlanarPose:
        return self.poses[self.settings.object_colors.index(color or self.settings.object_colors[0])]

    def rescue(self) -> bool:
        return False

    def execute(self, action: PickPlace) -> Outcome:
        """Move the top bag at the pick, onto whatever lies at the place."""
        self.executed.append(action)
        event = self.script.pop(0) if self.script else ""
        there = [bag for bag in self.poses if self.poses[bag].distance(action.pick) < REACH_M]
        bag = max(there, key=lambda bag: self.layers[bag], default=None)
        low = bag is not None and action.pick_on_m is not None
        if (
            event == "missed-grasp"
            or bag is None
            or (low and abs(action.pick_on_m - self.layers[bag] * LAYER_M) > 0.015)
        ):
            return Outcome(action, "missed-grasp")
        assert not self.carries(bag)
        dx, dy = self.rng.normal(0.0, 0.002, 2)
        self.poses[bag] = PlanarPose(action.place.x + dx, action.place.y + dy, action.place.yaw)
        below = [
            other
            for other in self.poses
            if other != bag and self.poses[other].distance(self.poses[bag]) < OVER_M
        ]
        self.layers[bag] = 1 + max((self.layers[other] for other in below), default=-1)
        if event == "slid-off":
            self._slide(bag)
        return Outcome(action, None, 0.02, 0.02, 0.012, 0.014)

    def _slide(self, bag: int) -> None:
        """Let a bag come to lie on the table beside, where nothing is."""
        at = self.poses[bag]
        for angle in np.linspace(0.0, 2 * np.pi, 40):
            beside = PlanarPose(at.x + 0.13 * np.cos(angle), at.y + 0.13 * np.sin(angle), at.yaw)
            others = [self.poses[other].distance(beside) for other in self.poses if other != bag]
            if min(others) > 0.12 and WORKSPACE.contains(beside.x, beside.y):
                self.poses[bag], self.layers[bag] = beside, 0
                return

    def close(self) -> None:
        return None
