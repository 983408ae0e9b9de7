"""Move the end effector to known positions and find it in the picture: the points of a homography."""

from __future__ import annotations

import numpy as np

from baggie.errors import LimitError, ReachError
from baggie.geometry import FloatArray, PlanarPose, Rectangle
from baggie.vision.color_mask import find_bag
from baggie.workcell.arm import Arm
from baggie.workcell.camera import Camera
from baggie.workcell.workcell import Marker

_SPEED_M_S = 0.5


def grid(workspace: Rectangle, margin: float, columns: int = 4, rows: int = 3) -> FloatArray:
    """Positions spread evenly over the workspace less a margin, by lanes: `(columns * rows, 2)` metres."""
    xs = np.linspace(workspace.x_min + margin, workspace.x_max - margin, rows)
    ys = np.linspace(workspace.y_min + margin, workspace.y_max - margin, columns)
    lanes = [(x, y) for lane, x in enumerate(xs) for y in (ys if lane % 2 == 0 else ys[::-1])]
    return np.array(lanes)


def collect_points(
    arm: Arm, camera: Camera, positions: FloatArray, height_m: float, marker: Marker
) -> tuple[FloatArray, FloatArray]:
    """Take the marker in the hand to each of `positions` `(N, 2)` at one height and find it by its colour.

    Positions out of reach and pictures without the marker are passed over: what is missing shows in the
    count. Returns pixels (u, v) and where the marker really was (metres): two arrays `(M, 2)`, M <= N.
    """
    marker_in_tool = PlanarPose(marker.offset_m, 0.0)
    pixels, robot = [], []
    for x, y in positions:
        target = PlanarPose(float(x), float(y)) @ marker_in_tool.inverse()
        try:
            reached = arm.move_to(target.at_height(height_m), _SPEED_M_S)
        except (LimitError, ReachError):
            continue
        seen = find_bag(camera.look().color, marker.color)
        if seen is not None:
            pixels.append(seen.center)
            robot.append((reached.planar @ marker_in_tool).xy)
    return np.array(pixels).reshape(-1, 2), np.array(robot).reshape(-1, 2)
