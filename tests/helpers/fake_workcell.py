"""A kinematic workcell for tests: a drawn table, a bag that follows the gripper, failures on demand."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

from baggie import seeds
from baggie.errors import ArmError, LimitError, ReachError
from baggie.geometry import FloatArray, PlanarPose, ToolPose
from baggie.robot.arm import ArmInfo
from baggie.sim.bag import Bag
from baggie.tasks.conditions import State
from baggie.tasks.task import Scene
from baggie.types import Image, Intrinsics, Observation, Outcome, PickPlace
from baggie.workcell.workcell import Calibrations, Watch, Workcell, WorkcellSettings

SIZE = (640, 360)
PARKED = ToolPose(0.2, -0.5, 0.4)


def tilted_camera(size: tuple[int, int] = SIZE) -> tuple[Intrinsics, FloatArray]:
    """A camera 1 m up, off centre, tilted, with a little distortion: intrinsics and `T_camera_base`."""
    focal = 0.62 * size[0]
    matrix = np.array([[focal, 0, size[0] / 2 - 7.0], [0, focal, size[1] / 2 + 4.0], [0, 0, 1.0]])
    position, aim = np.array([0.58, 0.07, 1.0]), np.array([0.49, -0.02, 0.0])
    forward = (aim - position) / np.linalg.norm(aim - position)
    right = np.cross(forward, [-1.0, 0.05, 0.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = rotation, -rotation @ position
    return Intrinsics(*size, matrix, np.array([0.02, -0.01, 0.0005, -0.0005, 0.0])), transform


def draw_polygon(image: Image, points: FloatArray, color: tuple[int, int, int]) -> None:
    """Fill a convex polygon of pixels (u, v) with sub-pixel corners."""
    cv2.fillConvexPoly(image, np.round(points * 256).astype(np.int32), color, cv2.LINE_AA, shift=8)


@dataclass
class FakeCamera:
    cell: FakeCell
    name: str = "top"
    size: tuple[int, int] = SIZE
    intrinsics: Intrinsics | None = None

    def __post_init__(self) -> None:
        self.intrinsics, self.transform = tilted_camera(self.size)

    def project(self, points: FloatArray) -> FloatArray:
        """`(N, 3)` metres, robot base -> `(N, 2)` pixels."""
        assert self.intrinsics is not None
        rotation, _ = cv2.Rodrigues(self.transform[:3, :3])
        pixels, _ = cv2.projectPoints(
            points, rotation, self.transform[:3, 3], self.intrinsics.matrix, self.intrinsics.distortion
        )
        return np.asarray(pixels.reshape(-1, 2))

    def look(self) -> Observation:
        cell = self.cell
        image = np.full((self.size[1], self.size[0], 3), (165, 150, 130), np.uint8)
        if not cell.hidden:
            sx, sy, height = cell.settings.object_size_m
            square = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * [sx / 2, sy / 2]
            matrix = cell.bag.matrix()
            table = np.c_[square, np.ones(4)] @ matrix.T
            solid = np.concatenate([np.c_[table[:, :2], np.full(4, z)] for z in (0.0, height)])
            hull = cv2.convexHull(self.project(solid).astype(np.float32)).reshape(-1, 2)
            draw_polygon(image, hull, cell.settings.object_color)
        tool = cell.arm.tool
        if cell.paddle and tool != PARKED:
            marker = cell.settings.marker
            center = tool.planar @ PlanarPose(marker.offset_m, 0.0)
            ring = np.linspace(0, 2 * np.pi, 24, endpoint=False)
            rim = marker.radius_m * np.stack([np.cos(ring), np.sin(ring)], axis=1)
            draw_polygon(image, self.project(np.c_[center.xy + rim, np.full(24, tool.z)]), marker.color)
        noisy = image * cell.exposure + cell.rng.normal(0.0, 2.0, image.shape)
        if cell.frozen is not None:
            return cell.frozen
        return Observation(np.clip(noisy, 0, 255).astype(np.uint8), None, self.intrinsics, cell.clock())


@dataclass
class FakeArm:
    tool: ToolPose = PARKED
    width: float = 0.08
    info: ArmInfo = field(default_factory=lambda: ArmInfo("fake", 0.08, 1.0, 40.0))

    def pose(self) -> ToolPose:
        return self.tool

    def move_to(self, target: ToolPose, speed_m_s: float) -> ToolPose:
        if math.hypot(target.x, target.y) > 0.85:
            raise ReachError("the fake arm is 85 cm long")
        self.tool = target
        return target

    def lower_until_contact(self, z_min: float, speed_m_s: float, force_n: float) -> ToolPose:
        self.tool = ToolPose(self.tool.x, self.tool.y, z_min, self.tool.yaw)
        return self.tool

    def move_gripper(self, width_m: float) -> float:
        self.width = width_m
        return width_m

    def grasp(self, force_n: float) -> float:
        self.width = 0.0
        return 0.0

    def gripper_width(self) -> float:
        return self.width

    def park(self) -> ToolPose:
        self.tool = PARKED
        return PARKED

    def stop(self) -> None:
        return None


@dataclass
class FakeCell(Workcell):
    """`script` holds what goes wrong in the next executions, first come first served; None is for nothing.

    It knows "missed-grasp", "dropped", "lost-bag", "unreachable", "stalled" (says success, moves nothing).
    """

    settings: WorkcellSettings = field(default_factory=WorkcellSettings)
    repeatable: bool = True
    scene: Scene | None = field(default_factory=lambda: Scene((Bag(),), {}))
    scatter_m: float = 0.003
    script: list[str | None] = field(default_factory=list)
    miss_rate: float = 0.0
    helps: bool = True
    size: tuple[int, int] = SIZE

    def __post_init__(self) -> None:
        self.arm = FakeArm()
        self.camera = FakeCamera(self, size=self.size)
        self.executed: list[PickPlace] = []
        self.rescues = 0
        self.frozen: Observation | None = None
        self.calibrations = Calibrations()
        self.watch: Watch | None = None
        self.reset((0,))

    def reset(self, seed: Sequence[int]) -> None:
        self.rng = seeds.generator(*seed)
        self.time = 0.0
        self.hidden = False
        self.paddle = False
        self.exposure = self.rng.uniform(0.8, 1.15)
        self._put_bag_back()

    def _put_bag_back(self) -> None:
        x, y = self.settings.workspace.sample(self.rng, 0.04)
        self.bag = PlanarPose(float(x), float(y), float(self.rng.uniform(-np.pi, np.pi)))

    def look(self) -> Observation:
        self.arm.park()
        self.time += 0.5
        observation = self.camera.look()
        if self.watch is not None:
            self.watch.check(observation.color)
        return observation

    def clock(self) -> float:
        return self.time

    def state(self) -> State | None:
        return State({}, {"bag": self.bag})

    def rescue(self) -> bool:
        self.rescues += 1
        if self.helps:
            self.hidden = False
            self._put_bag_back()
        return self.helps

    def show_paddle(self, shown: bool) -> None:
        self.paddle = shown

    def close(self) -> None:
        return None

    def execute(self, action: PickPlace) -> Outcome:
        for pose in (action.pick, action.place):
            if not self.settings.limits.workspace.contains(pose.x, pose.y):
                raise LimitError(f"({pose.x}, {pose.y}) is outside {self.settings.limits.workspace}")
        event = self.script.pop(0) if self.script else None
        if event == "unreachable":
            raise ReachError("the fake arm was told not to reach")
        self.executed.append(action)
        self.time += 5.0
        missed = action.pick.distance(self.bag) > 0.045 or self.rng.random() < self.miss_rate
        if event == "missed-grasp" or (missed and event is None):
            return Outcome(action, "missed-grasp")
        in_hand = action.pick.inverse() @ self.bag
        noise = PlanarPose(*self.rng.normal(0, self.scatter_m, 2), self.rng.normal(0, 0.03))
        if event == "stalled":
            return Outcome(action, grasp_width_m=0.02, release_width_m=0.02)
        if event == "dropped":
            self.bag = PlanarPose(*((action.pick.xy + action.place.xy) / 2), self.bag.yaw)
            return Outcome(action, "dropped", 0.02, 0.0)
        self.bag = action.place @ in_hand @ noise
        self.hidden = event == "lost-bag"
        return Outcome(action, None, 0.02, 0.02, 0.012, 0.014, timings_s={"pick": 2.5, "place": 2.5})


def open_fake(cell: int = 0, miss_rate: float = 0.05) -> FakeCell:
    """What a worker process opens."""
    return FakeCell(miss_rate=miss_rate, size=(320, 180))


def open_slowly(cell: int) -> FakeCell:
    """A cell whose every execution takes a while, so that a kill lands in the middle of something."""
    fake = open_fake(cell)
    execute = fake.execute

    def slow(action):
        time.sleep(0.1)
        return execute(action)

    fake.execute = slow
    return fake


def open_faulty(cell: int) -> FakeCell:
    """Loses its arm in the third execution, as often as the file that the environment names says."""
    fake = open_fake(cell)
    execute, left = fake.execute, Path(os.environ["FAULTS_LEFT"])

    def lose(action):
        if len(fake.executed) == 2 and (faults := int(left.read_text())):
            left.write_text(str(faults - 1))
            raise ArmError("the cable came off")
        return execute(action)

    fake.execute = lose
    return fake


def open_unhelped(cell: int) -> FakeCell:
    """Loses the bag in its second sitting, until a person has made the file that the environment names, if it does."""
    fake = open_fake(cell, miss_rate=0.0)
    reset, look, laid_back = fake.reset, fake.look, os.environ.get("LAID_BACK")
    fake.helps = False

    def look_again():
        fake.hidden = fake.hidden and not (laid_back and Path(laid_back).exists())
        return look()

    fake.look = look_again

    def lose(seed):
        reset(seed)
        fake.script = ["lost-bag"] if seed[-1] == 1 and seed[0] == seeds.COLLECTION else []

    fake.reset = lose
    return fake
