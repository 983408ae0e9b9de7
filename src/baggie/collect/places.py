"""Where the collector grips and where it puts down."""

from __future__ import annotations

import math

import numpy as np

from baggie.calibration.image_to_robot.map import ImageToRobot
from baggie.errors import BaggieError
from baggie.geometry import FloatArray, PlanarPose, Rectangle, wrap_angle
from baggie.seeds import first_fit

MIN_DISTANCE_M = 0.20
MARGIN_M = 0.03
"""Between any place and the workspace's edge: a soft bag lands up to this far from where it is let go."""
FALSE_45_RAD = math.radians(7)
"""Readings this close to 45 degrees are doubted."""


def random_place(
    workspace: Rectangle, last: PlanarPose, rng: np.random.Generator, margin: float = MARGIN_M
) -> PlanarPose:
    """A place uniform over the workspace, at least 20 cm from the last, the gripper square to it (yaw 0).

    `margin`: metres between it and the workspace's edge. Raises `BaggieError` when the workspace is too small for two
    places 20 cm apart.
    """

    def somewhere() -> PlanarPose:
        x, y = workspace.sample(rng, margin)
        return PlanarPose(float(x), float(y), 0.0)

    place = first_fit(somewhere, lambda pose: pose.distance(last) >= MIN_DISTANCE_M)
    if place is None:
        raise BaggieError(
            f"expected a workspace with places {MIN_DISTANCE_M * 100:.0f} cm apart, got {workspace}; "
            "make it larger"
        )
    return place


def false_45(yaw: float) -> bool:
    """Whether a square's angle (radians, modulo a quarter turn) is so near 45 degrees that it may be false.

    The rectangle of least area around a square with soft corners may as well stand on its tip.
    """
    return abs(abs(yaw) - math.pi / 4) < FALSE_45_RAD


def grip_yaw(yaw: float, believed: bool) -> float:
    """The gripper's angle for an object at `yaw` (radians, modulo a quarter turn).

    Along the object, so that putting it down with the gripper at 0 squares it to the workspace. A reading of
    45 degrees is taken for false, and the gripper stays square; but a false one does not survive being moved,
    so the second in a row is `believed`, and so is one after the square gripper has missed.
    """
    return 0.0 if false_45(yaw) and not believed else yaw


def long_yaw(image_to_robot: ImageToRobot, corners: FloatArray, yaw: float) -> float:
    """The angle of a long object's long side; radians in [-pi/2, pi/2).

    `corners` `(4, 2)`, pixels, in turn around it, tell which side is the long one; `yaw`, modulo a quarter turn, its
    angle. A gripper at this angle closes across the narrow side: at yaw 0 fingers open along y.
    """
    sides = np.roll(on_table := image_to_robot.to_robot(corners), -1, axis=0) - on_table
    x, y = sides[int(np.argmax(np.linalg.norm(sides[:2] - sides[2:], axis=1)))]
    quarters = round((math.atan2(y, x) - yaw) / (math.pi / 2))
    return wrap_angle(yaw + quarters * math.pi / 2, math.pi)


def long_place_yaw(pick_yaw: float, rng: np.random.Generator) -> float:
    """The gripper's angle to put a long object down squared up: along x or along y, whichever chance says.

    Along y the way round that turns the wrist less.
    """
    return 0.0 if rng.random() < 0.5 else math.copysign(math.pi / 2, pick_yaw)


def nearest_grip(workspace: Rectangle, x: float, y: float, reach: float) -> tuple[float, float] | None:
    """The point of the workspace nearest to (x, y); None where that is more than `reach` metres away."""
    inside = workspace.nearest(x, y)
    return inside if math.hypot(inside[0] - x, inside[1] - y) <= reach else None
