"""An arm and a camera of one's own over a table with a hard cube, for tests: only what is geometry.

A workcell file names `cube_world:open_arm` and `cube_world:open_camera`. Fingers that are too near together, or turned
too far, land on the cube's top; fingers that do not open wide enough carry it along.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from baggie.geometry import FloatArray, PlanarPose, ToolPose, wrap_angle
from baggie.robot.arm import ArmInfo
from baggie.types import Intrinsics, Observation
from helpers.fake_workcell import PARKED, draw_polygon, tilted_camera

SIDE_M = 0.065
RED = (196, 40, 44)
INFO = ArmInfo("cube arm", max_width_m=0.08, max_speed_m_s=0.5, max_force_n=40.0)


@dataclass
class CubeWorld:
    """Where everything is."""

    cube: PlanarPose = field(default_factory=lambda: PlanarPose(0.5, 0.05, math.pi / 4))
    """At 45 degrees: in a hand that stays square it does not fit."""
    tool: ToolPose = PARKED
    width_m: float = 0.08
    in_hand: PlanarPose | None = None
    """The cube in the tool's frame while it is held."""
    gripped_z: float = 0.0
    landed: list[float] = field(default_factory=list)
    """How fast the hand came down on something, m/s."""
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))

    @property
    def between(self) -> tuple[float, float]:
        """How wide the cube is along the way the fingers close, and how far off their middle."""
        seen = self.tool.planar.inverse() @ self.cube
        return SIDE_M * (abs(math.cos(seen.yaw)) + abs(math.sin(seen.yaw))), seen.y

    @property
    def bottom(self) -> float:
        return self.tool.z - self.gripped_z if self.in_hand else 0.0

    def go(self, tool: ToolPose) -> None:
        self.tool = tool
        if self.in_hand:
            self.cube = tool.planar @ self.in_hand


WORLD = CubeWorld()
"""The one that is open."""


class CubeArm:
    info = INFO

    def __init__(self, world: CubeWorld) -> None:
        self.world = world

    def pose(self) -> ToolPose:
        return self.world.tool

    def move_to(self, target: ToolPose, speed_m_s: float) -> ToolPose:
        assert speed_m_s <= INFO.max_speed_m_s
        self.world.go(target)
        return target

    def lower_until_contact(self, z_min: float, speed_m_s: float, force_n: float) -> ToolPose:
        world, floor = self.world, -math.inf
        if world.in_hand:
            floor = world.gripped_z
        else:
            wide, off = world.between
            near = math.hypot(*(world.tool.planar.inverse() @ world.cube).xy) < SIDE_M
            if near and wide / 2 + abs(off) > world.width_m / 2:
                floor = SIDE_M  # on its top
        if floor > z_min:
            world.landed.append(speed_m_s)
        world.go(replace(world.tool, z=min(world.tool.z, max(z_min, floor))))
        return world.tool

    def move_gripper(self, width_m: float) -> float:
        world = self.world
        if world.in_hand:
            width_m = max(width_m, SIDE_M)
            if width_m > SIDE_M:
                world.in_hand = None
        world.width_m = width_m
        return width_m

    def grasp(self, force_n: float) -> float:
        world = self.world
        _, off = world.between
        held = world.tool.z < SIDE_M and abs(off) < world.width_m / 2
        if held and abs((world.tool.planar.inverse() @ world.cube).x) < SIDE_M / 2:
            seen = world.tool.planar.inverse() @ world.cube
            # Its sides come to lie along the fingers, and it between them.
            turned = wrap_angle(seen.yaw, math.pi / 2)
            world.in_hand, world.gripped_z = PlanarPose(seen.x, 0.0, seen.yaw - turned), world.tool.z
            world.width_m = SIDE_M
            world.go(world.tool)
        else:
            world.width_m = 0.0
        return world.width_m

    def gripper_width(self) -> float:
        return self.world.width_m

    def park(self) -> ToolPose:
        self.world.tool = PARKED
        return PARKED

    def stop(self) -> None:
        return None


class CubeCamera:
    name = "cube camera"
    size = (640, 360)
    intrinsics: Intrinsics | None = None

    def __init__(self, world: CubeWorld) -> None:
        self.world = world
        self.lens, self.transform = tilted_camera(self.size)

    def project(self, points: FloatArray) -> FloatArray:
        """`(N, 3)` metres, robot base -> `(N, 2)` pixels."""
        rotation, _ = cv2.Rodrigues(self.transform[:3, :3])
        pixels, _ = cv2.projectPoints(
            points, rotation, self.transform[:3, 3], self.lens.matrix, self.lens.distortion
        )
        return np.asarray(pixels.reshape(-1, 2))

    def look(self) -> Observation:
        image = np.full((self.size[1], self.size[0], 3), (165, 150, 130), np.uint8)
        corners = self.world.cube.outline(SIDE_M, SIDE_M)
        solid = np.concatenate(
            [np.c_[corners, np.full(4, z)] for z in (self.world.bottom, self.world.bottom + SIDE_M)]
        )
        draw_polygon(image, cv2.convexHull(self.project(solid).astype(np.float32)).reshape(-1, 2), RED)
        noisy = image + self.world.rng.normal(0.0, 2.0, image.shape)
        return Observation(np.clip(noisy, 0, 255).astype(np.uint8), time=time.time())


def open_arm() -> CubeArm:
    """What a workcell file names; a camera opened after it looks at the same world."""
    vars(WORLD).update(vars(CubeWorld()))
    return CubeArm(WORLD)


def open_camera() -> CubeCamera:
    return CubeCamera(WORLD)
