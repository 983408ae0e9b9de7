"""One attempt with a bag grasped off its middle, and what can be known of it: truth, pictures of the held bag."""

from __future__ import annotations

from typing import Any

import numpy as np

from baggie import seeds
from baggie.calibration.image_to_robot.map import ImageToRobot
from baggie.collect.machine import random_place
from baggie.errors import LimitError, ReachError
from baggie.geometry import FloatArray, PlanarPose, ToolPose, wrap_angle
from baggie.robot.primitives import pick, place
from baggie.types import Image
from baggie.vision.color_mask import FIRST_THRESHOLD, blobs, chroma_of, find_bag, hue_likeness, reference_of
from baggie.workcell.simulated import SimulatedWorkcell

STREAM = 0x5EC0
"""Scenes of this benchmark alone."""
OFFSETS = 0x0FF5
"""Keeps the grasp and the place apart from where the scene's own stream puts the bag."""
OFFSET_M = 0.02
YAW_RAD = np.deg2rad(3)
"""How far off grasps are made: uniform in distance; standard deviation of yaw."""
LOST_M = 0.06
"""A bag this far from where it was let go was dropped, as the collector sees it."""
SPOT = ToolPose(0.36, 0.0, 0.32)
"""Where the hand shows what it holds: in front of the camera, so that it looks under the hand from the side."""
HANGS_M = 0.03
"""The bag's middle below the tool, in the mean."""


def attempt(cell: SimulatedWorkcell, to_robot: ImageToRobot, stream: tuple[int, ...]) -> dict[str, Any]:
    """One attempt. Positions are of the bag in the tool's frame, `[x, y]` metres; the fingers open along y."""
    cell.reset(stream)
    rng = seeds.generator(*stream, OFFSETS)
    bag, h = cell.truth(), cell.settings.handling
    found = find_bag(cell.look().color, cell.settings.object_color)
    radius, angle = OFFSET_M * rng.random(), rng.uniform(-np.pi, np.pi)
    off = PlanarPose(radius * np.cos(angle), radius * np.sin(angle), rng.normal(0.0, YAW_RAD))
    planned = PlanarPose(bag.x, bag.y, wrap_angle(bag.yaw, np.pi / 2)) @ off
    try:
        grasp = pick(cell.arm, planned, h)
        at = grasp.pose.planar
        record: dict[str, Any] = {
            "held": grasp.held,
            "width": grasp.width_m,
            "arm": xy(at.inverse() @ planned),
            "eye": xy(at.inverse() @ PlanarPose(*to_robot.to_robot(found.center)[0])) if found else None,
            "offset": xy(at.inverse() @ bag),
            "turn": wrap_angle(bag.yaw - at.yaw, np.pi / 2),
        }
        if not grasp.held:
            return record
        record["hanging"] = hanging(cell)
        record["over_pick"] = seen_held(cell, to_robot)
        record["place"] = xy(at)
        began = cell.clock()
        cell.arm.move_to(SPOT, h.carry_m_s)
        record["detour_s"] = cell.clock() - began
        record["at_spot"] = seen_held(cell, to_robot)
        target = random_place(cell.settings.workspace, at, rng)
        cell.arm.move_to(target.at_height(h.travel_z_m), h.carry_m_s)
        record["before_lowering"] = hanging(cell)
        release = place(cell.arm, target, h)
        cell.look()
        after = release.pose.planar.inverse() @ cell.truth()
    except (LimitError, ReachError) as error:
        return {"failure": str(error)}
    record["landing"] = xy(after) if release.held and np.hypot(after.x, after.y) < LOST_M else None
    return record


def xy(pose: PlanarPose) -> list[float]:
    return [float(pose.x), float(pose.y)]


def hanging(cell: SimulatedWorkcell) -> list[float]:
    """The truth: the mean of the bag's points in the tool's frame `(3,)`, and their spread in x, y, z `(3,)`."""
    tool = cell.arm.pose()
    points = cell.world.bodies["bag"].points - tool.xyz
    c, s = np.cos(tool.yaw), np.sin(tool.yaw)
    points = points @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    return [*points.mean(axis=0).tolist(), *points.std(axis=0).tolist()]


def seen_held(cell: SimulatedWorkcell, to_robot: ImageToRobot) -> list[float] | None:
    """What the camera sees of the bag, in the tool's frame: middle x, y; second moments xx, xy, yy; area. m, m²."""
    tool = cell.arm.pose()
    pixels = mask_of(cell.camera.look().color, cell.settings.object_color)
    if pixels is None:
        return None
    plane = to_robot.at_height(tool.z - HANGS_M)
    points = plane.to_robot(pixels) - tool.xyz[:2]
    c, s = np.cos(tool.yaw), np.sin(tool.yaw)
    points = points @ np.array([[c, -s], [s, c]])
    spread = np.cov(points.T)
    corner = plane.to_robot(pixels.mean(axis=0) + np.array([[0, 0], [1, 0], [0, 1]]))
    area = len(pixels) * abs(float(np.linalg.det(corner[1:] - corner[0])))
    return [*points.mean(axis=0).tolist(), spread[0, 0], spread[0, 1], spread[1, 1], area]


def mask_of(image: Image, color: tuple[int, int, int]) -> FloatArray | None:
    """Pixels (u, v) of that colour `(N, 2)` in blobs of any shape: the hand may cut the bag in two."""
    alike = hue_likeness(chroma_of(image), reference_of(color, "the object's")) > FIRST_THRESHOLD
    found = [blob for blob, _ in blobs(alike, 300.0)]
    if not found:
        return None
    rows, columns = np.nonzero(np.any(found, axis=0))
    return np.column_stack([columns, rows]).astype(float)
