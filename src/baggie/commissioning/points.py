"""The arm takes a marker to known positions, the camera looks: what image-to-robot maps are fitted to."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator

import numpy as np

from baggie.errors import BaggieError, LimitError, ReachError
from baggie.geometry import FloatArray, Rectangle, ToolPose, hand_matrix, transform_points
from baggie.types import Image, Observation
from baggie.vision.color_mask import find_bag
from baggie.vision.targets import Marker, parse_target
from baggie.workcell.arm import Arm, hand_pose
from baggie.workcell.camera import Camera

YAW_RAD = 0.35
"""How far the hand is turned at each point, to one side or the other."""
_SPEED_M_S = 0.5

Find = Callable[[Image], FloatArray | None]
"""Where a marker's middle is in a picture: `(2,)` pixels, None where it is not seen."""


def grid(
    workspace: Rectangle, margin: float, heights_m: tuple[float, ...], columns: int = 4, rows: int = 3
) -> FloatArray:
    """Positions spread evenly over the workspace less a margin, by lanes, at each height: `(N, 3)` metres."""
    xs = np.linspace(workspace.x_min + margin, workspace.x_max - margin, rows)
    ys = np.linspace(workspace.y_min + margin, workspace.y_max - margin, columns)
    lanes = [(x, y) for lane, x in enumerate(xs) for y in (ys if lane % 2 == 0 else ys[::-1])]
    return np.array([(x, y, z) for z in heights_m for x, y in lanes])


def visit(
    arm: Arm, camera: Camera, positions: FloatArray, marker_in_hand: FloatArray
) -> Iterator[tuple[int, FloatArray, Observation]]:
    """Take a marker to each of `positions` `(N, 3)` and look: its number, `T_base_hand` `(4, 4)` there, the picture.

    `marker_in_hand` `(3,)`: its middle in the tool's frame. The hand is turned one way and the other in turn, so that a
    marker that is not where it is said to be shows. Positions out of reach are passed over: what is missing shows in
    the count.
    """
    speed = min(_SPEED_M_S, arm.info.max_speed_m_s)
    for number, position in enumerate(positions):
        yaw = YAW_RAD if number % 2 else -YAW_RAD
        upright = hand_matrix(ToolPose(0.0, 0.0, 0.0, yaw))
        x, y, z = position - transform_points(upright, marker_in_hand[None])[0]
        try:
            arm.move_to(ToolPose(float(x), float(y), float(z), yaw), speed)
        except (LimitError, ReachError):
            continue
        yield number, hand_pose(arm), camera.look()


def color_finder(color: tuple[int, int, int]) -> Find:
    """Finds a blob of this RGB colour, as the published system does."""

    def find(image: Image) -> FloatArray | None:
        seen = find_bag(image, color)
        return None if seen is None else seen.center

    return find


def marker_finder(marker: Marker) -> Find:
    """Finds an ArUco marker: where its diagonals cross, which is its middle in every perspective."""

    def find(image: Image) -> FloatArray | None:
        seen = marker.detect(image)
        if seen is None:
            return None
        a, b, c, d = np.c_[seen.pixels, np.ones(4)]
        crossing = np.cross(np.cross(a, c), np.cross(b, d))
        return np.asarray(crossing[:2] / crossing[2])

    return find


def parse_marker(spec: str) -> tuple[Find, Marker | None]:
    """How to find what a person wrote, `aruco:DICTIONARY:NUMBER:SIZE` or `color:R,G,B`, and the marker if it is one.

    Raises `BaggieError` for anything else.
    """
    color = re.fullmatch(r"color:(\d+),(\d+),(\d+)", spec)
    if color is not None and max(map(int, color.groups())) <= 255:
        return color_finder((int(color[1]), int(color[2]), int(color[3]))), None
    marker = None if spec.startswith("color:") else parse_target(spec)
    if not isinstance(marker, Marker):
        raise BaggieError(
            f"expected a marker as aruco:DICTIONARY:NUMBER:SIZE (metres) or color:R,G,B, each at most 255, got {spec!r}"
        )
    return marker_finder(marker), marker
