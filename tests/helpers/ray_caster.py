"""A table and boxes as ideal depth cameras see them: each pixel's ray meets a surface in closed form."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from baggie.geometry import FloatArray, rigid
from baggie.types import Image, Intrinsics, Observation

Paint = Callable[[FloatArray], FloatArray]
"""Points `(N, 3)` metres -> their RGB colours `(N, 3)` in [0, 255]."""


@dataclass(frozen=True)
class Box:
    """Axis-aligned, in the robot's base frame: opposite corners, metres."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    color: tuple[int, int, int] = (200, 40, 40)


def ravens_poses() -> list[FloatArray]:
    """`T_base_camera` of Ravens' three cameras: in front, to the left, to the right."""
    angles = [(45, 180, -90), (40, 180, 45), (40, 180, 135)]
    places = [(1.0, 0.0, 0.75), (0.0, 0.5, 0.75), (0.0, -0.5, 0.75)]
    turns = [Rotation.from_euler("xyz", angle, degrees=True).as_matrix() for angle in angles]
    return [rigid(turn, place) for turn, place in zip(turns, places, strict=True)]


def overhead_pose(x: float, y: float, z: float) -> FloatArray:
    """`T_base_camera` of a camera that looks straight down, its picture's u along -y."""
    return rigid([[0, -1, 0], [-1, 0, 0], [0, 0, -1]], [x, y, z])


def pinhole(width: int, height: int, focal_px: float, distortion: Sequence[float] = ()) -> Intrinsics:
    """The middle of the picture is half way between its two middle pixels' centres."""
    center = (width - 1) / 2, (height - 1) / 2
    matrix = np.array([[focal_px, 0, center[0]], [0, focal_px, center[1]], [0, 0, 1.0]])
    return Intrinsics(width, height, matrix, np.array(distortion, float))


def look(
    camera: Intrinsics,
    pose: FloatArray,
    boxes: Sequence[Box] = (),
    table: Paint | tuple[int, int, int] = (120, 110, 90),
) -> Observation:
    """What a camera at `T_base_camera` sees of the plane z = 0 and the boxes on it; no depth where it sees neither."""
    v, u = np.divmod(np.arange(camera.width * camera.height, dtype=float), camera.width)
    if camera.distortion.size:
        slopes = camera.rays(np.c_[u, v])
        np.testing.assert_allclose(camera.project(np.c_[slopes, np.ones(len(u))]), np.c_[u, v], atol=1e-6)
    else:
        (fx, _, cx), (_, fy, cy), _ = camera.matrix
        slopes = np.c_[(u - cx) / fx, (v - cy) / fy]
    # Along the optical axis these have length 1: how far along one is depth.
    rays = np.c_[slopes, np.ones(len(u))] @ pose[:3, :3].T
    start = pose[:3, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = np.where(rays[:, 2] < 0, -start[2] / rays[:, 2], math.inf)
        points = start + depth[:, None] * rays
        color = np.full(points.shape, table, float) if isinstance(table, tuple) else table(points)
        for box in boxes:
            ends = (np.stack([box.low, box.high])[:, None] - start) / rays
            enter, leave = ends.min(axis=0).max(axis=1), ends.max(axis=0).min(axis=1)
            hit = (enter < leave) & (enter > 0) & (enter < depth)
            depth[hit], color[hit] = enter[hit], box.color
    depth[~np.isfinite(depth)] = 0
    color[depth == 0] = 0
    shape = camera.height, camera.width
    picture: Image = np.round(color).astype(np.uint8).reshape(*shape, 3)
    return Observation(picture, depth.astype(np.float32).reshape(shape), camera)
