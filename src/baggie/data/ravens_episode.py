"""What an episode of the Ravens benchmark (Zeng et al., "Transporter Networks", CoRL 2020) holds."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from baggie.errors import DataError
from baggie.geometry import FloatArray, PlanarPose, wrap_angle

Vector3 = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
"""(x, y, z, w), of norm 1."""


class RavensPose(NamedTuple):
    """A pose in the robot's base frame."""

    xyz: Vector3
    """Metres; the table top is at z 0."""
    xyzw: Quaternion


class RavensAction(NamedTuple):
    """Where the tool picks and where it places."""

    pose0: RavensPose
    """The pick; in the demonstrations its rotation is the identity, for the tool is a suction cup."""
    pose1: RavensPose
    """The place: how far the object turns between the two is the rotation from `pose0` to this."""


class RavensObject(NamedTuple):
    """Where an object truly is, in the robot's base frame."""

    position: Vector3
    """Of its middle, metres."""
    rotation: Quaternion
    dimensions: Vector3
    """Along its own axes, metres."""


@dataclass(frozen=True)
class RavensEpisode:
    """S actions and the S + 1 moments before, between and after them."""

    number: int
    seed: int
    color: NDArray[np.uint8]
    """`(S + 1, 3, 480, 640, 3)` RGB: moment, camera (as in `RAVENS_CAMERAS`), row, column."""
    depth: NDArray[np.float32]
    """`(S + 1, 3, 480, 640)` metres along the optical axis."""
    actions: tuple[RavensAction, ...]
    """S of them; what follows action i is moment i + 1."""
    rewards: FloatArray
    """`(S + 1,)`: what had been earned by the action before; 0 at first."""
    info: tuple[Mapping[int, RavensObject] | None, ...]
    """S + 1 times all objects by their number; None where nothing was known, as before the first action."""


def pose_to_planar(pose: RavensPose, max_tilt: float = 0.02) -> PlanarPose:
    """The pose without its height.

    Raises `DataError` where it is tilted out of the plane by more than `max_tilt` radians; objects at rest are by less
    than 0.001.
    """
    (x, y, _), (qx, qy, qz, qw) = pose
    tilt = 2 * math.atan2(math.hypot(qx, qy), math.hypot(qz, qw))
    if tilt > max_tilt:
        raise DataError(
            f"a pose at x {x:.3f}, y {y:.3f} m is tilted by {math.degrees(tilt):.1f} degrees, where at most "
            f"{math.degrees(max_tilt):.1f} are expected: take a task in which objects are turned about z alone"
        )
    return PlanarPose(x, y, wrap_angle(2 * math.atan2(qz, qw)))


def planar_to_pose(pose: PlanarPose, z: float) -> RavensPose:
    """The pose `z` metres above the table, turned about z alone."""
    return RavensPose((pose.x, pose.y, z), (0.0, 0.0, math.sin(pose.yaw / 2), math.cos(pose.yaw / 2)))
