"""Planar poses, rigid transforms, homographies, and the grid of an orthographic picture.

`T_a_b` maps points of frame b into frame a. Metres and radians; pixels are `(u, v)`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baggie.errors import BaggieError

FloatArray = NDArray[np.float64]


@overload
def wrap_angle(angle: float, period: float = ...) -> float: ...
@overload
def wrap_angle(angle: FloatArray, period: float = ...) -> FloatArray: ...
def wrap_angle(angle: float | FloatArray, period: float = 2 * math.pi) -> float | FloatArray:
    """The angle (radians) modulo `period`, in [-period/2, period/2)."""
    return (angle + period / 2) % period - period / 2


def nearest_angle(angle: float, to: float) -> float:
    """The angle (radians), whole turns added, that is nearest to `to`: within half a turn, itself if it is already."""
    if -math.pi < angle - to <= math.pi:
        return angle
    return to - wrap_angle(to - angle)


@dataclass(frozen=True)
class PlanarPose:
    """A pose on the table in the robot's base frame: x forward, y left (metres), yaw about z (radians).

    As an element of SE(2), `a @ b` composes and `a.inverse()` inverts:

    >>> a = PlanarPose(0.4, 0.1, 0.5)
    >>> a @ a.inverse()
    PlanarPose(x=0.0, y=0.0, yaw=0.0)
    """

    x: float
    y: float
    yaw: float = 0.0

    @property
    def xy(self) -> FloatArray:
        """`(2,)` metres."""
        return np.array([self.x, self.y])

    def matrix(self) -> FloatArray:
        """`(3, 3)` homogeneous transform of the plane."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return np.array([[c, -s, self.x], [s, c, self.y], [0.0, 0.0, 1.0]])

    def inverse(self) -> PlanarPose:
        """The pose of the base seen from this pose."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return PlanarPose(-c * self.x - s * self.y, s * self.x - c * self.y, wrap_angle(-self.yaw))

    def __matmul__(self, other: PlanarPose) -> PlanarPose:
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return PlanarPose(
            self.x + c * other.x - s * other.y,
            self.y + s * other.x + c * other.y,
            wrap_angle(self.yaw + other.yaw),
        )

    def distance(self, other: PlanarPose) -> float:
        """Metres between the two positions; yaw plays no part."""
        return math.hypot(self.x - other.x, self.y - other.y)

    def outline(self, length: float, width: float) -> FloatArray:
        """`(4, 2)` metres: the corners of a rectangle centred here, its length along the pose's own x axis."""
        own = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * [length / 2, width / 2]
        return apply_homography(self.matrix(), own)

    def upright(self, z: float) -> FloatArray:
        """`T_base_body` `(4, 4)` of what stands here, its frame `z` metres above the table."""
        T_base_body = np.eye(4)
        T_base_body[:2, [0, 1, 3]] = self.matrix()[:2]
        T_base_body[2, 3] = z
        return T_base_body

    def at_height(self, z: float) -> ToolPose:
        """The tool pointing straight down at this pose, its tip `z` metres above the table."""
        return ToolPose(self.x, self.y, z, self.yaw)


def planar_pose(T_base_body: FloatArray) -> PlanarPose:
    """Where the origin of a body's frame is above the table, and which way its x axis points there; `(4, 4)`."""
    T = T_base_body
    return PlanarPose(float(T[0, 3]), float(T[1, 3]), float(np.arctan2(T[1, 0], T[0, 0])))


@dataclass(frozen=True)
class ToolPose:
    """The tool (point between the fingertips) pointing straight down, in the robot's base frame.

    Metres and radians; z is the height above the base frame's xy plane, which is the table top.
    At yaw 0 the fingers open along y and the tool's own x axis points along the frame's, away from the robot's base.
    """

    x: float
    y: float
    z: float
    yaw: float = 0.0

    @property
    def planar(self) -> PlanarPose:
        """The pose on the table, without its height."""
        return PlanarPose(self.x, self.y, self.yaw)

    @property
    def xyz(self) -> FloatArray:
        """`(3,)` metres."""
        return np.array([self.x, self.y, self.z])


@dataclass(frozen=True)
class Rectangle:
    """An axis-aligned rectangle of the table in the robot's base frame, metres."""

    x_min: float
    x_max: float
    y_min: float
    y_max: float

    def contains(self, x: float, y: float, margin: float = 0.0) -> bool:
        """Whether (x, y) lies inside, at least `margin` metres from the edge."""
        inside_x = self.x_min + margin <= x <= self.x_max - margin
        return inside_x and self.y_min + margin <= y <= self.y_max - margin

    def nearest(self, x: float, y: float) -> tuple[float, float]:
        """The point of the rectangle that is nearest to (x, y)."""
        return min(max(x, self.x_min), self.x_max), min(max(y, self.y_min), self.y_max)

    def sample(self, rng: np.random.Generator, margin: float = 0.0) -> FloatArray:
        """A point uniform in the rectangle shrunk by `margin`: `(2,)` metres.

        Raises `BaggieError` where no point is so far from all its edges.
        """
        low = [self.x_min + margin, self.y_min + margin]
        high = [self.x_max - margin, self.y_max - margin]
        if low[0] > high[0] or low[1] > high[1]:
            raise BaggieError(
                f"expected a rectangle with a point {margin:.2f} m from all its edges, got {self}; make it larger"
            )
        return rng.uniform(low, high)

    def __str__(self) -> str:
        return f"x {self.x_min:.2f}..{self.x_max:.2f} m, y {self.y_min:.2f}..{self.y_max:.2f} m"


def rotation(angle: float) -> FloatArray:
    """`(2, 2)`: a turn of the plane by `angle` radians, from its first axis towards its second."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s], [s, c]])


def apply_homography(matrix: ArrayLike, points: ArrayLike) -> FloatArray:
    """Map points through a homography: `(3, 3)`, `(N, 2)` -> `(N, 2)`."""
    homogeneous = np.c_[np.atleast_2d(np.asarray(points, float)), np.ones(len(np.atleast_2d(points)))]
    mapped = homogeneous @ np.asarray(matrix, float).T
    return np.asarray(mapped[:, :2] / mapped[:, 2:], float)


def invert_transform(transform: ArrayLike) -> FloatArray:
    """The inverse of a rigid transform: `T_a_b` `(4, 4)` -> `T_b_a` `(4, 4)`."""
    t = np.asarray(transform, float)
    result = np.eye(4)
    result[:3, :3] = t[:3, :3].T
    result[:3, 3] = -t[:3, :3].T @ t[:3, 3]
    return result


def rigid(rotation: ArrayLike, translation: ArrayLike) -> FloatArray:
    """`(3, 3)` rotation and `(3,)` translation -> `(4, 4)` homogeneous transform."""
    result = np.eye(4)
    result[:3, :3] = rotation
    result[:3, 3] = np.asarray(translation, float).reshape(3)
    return result


def is_rigid(transform: ArrayLike, tolerance: float) -> bool:
    """Whether it is a rotation and a translation above a row 0 0 0 1, `(4, 4)` finite numbers.

    `tolerance`: how far the products of the rotation's rows may be from those of orthonormal ones.
    """
    t = np.asarray(transform, float)
    if t.shape != (4, 4) or not np.isfinite(t).all():
        return False
    rotation = t[:3, :3]
    orthonormal = np.allclose(rotation @ rotation.T, np.eye(3), rtol=0, atol=tolerance)
    return bool(
        orthonormal and np.linalg.det(rotation) > 0 and np.allclose(t[3], [0, 0, 0, 1], rtol=0, atol=1e-8)
    )


def hand_matrix(pose: ToolPose) -> FloatArray:
    """`T_base_hand` `(4, 4)` of a tool that points straight down.

    The hand's frame is the tool's: origin between the fingertips, z out of the hand along the fingers, y the axis they
    open along; at yaw 0 x points forward.
    """
    c, s = math.cos(pose.yaw), math.sin(pose.yaw)
    return rigid([[c, s, 0.0], [s, -c, 0.0], [0.0, 0.0, -1.0]], pose.xyz)


def tool_pose(T_base_hand: ArrayLike) -> ToolPose:
    """The inverse of `hand_matrix`: `(4, 4)` -> where the tool is and its yaw; a tilt is left out."""
    t = np.asarray(T_base_hand, float)
    x, y, z = (float(value) for value in t[:3, 3])
    return ToolPose(x, y, z, math.atan2(t[1, 0], t[0, 0]))


def from_vector(vector: ArrayLike) -> FloatArray:
    """`(6,)`, a rotation vector (radians) and then a translation -> `(4, 4)`."""
    from scipy.spatial.transform import Rotation  # noqa: PLC0415 -- half a second, for what mostly starts without

    vector = np.asarray(vector, float).reshape(6)
    return rigid(Rotation.from_rotvec(vector[:3]).as_matrix(), vector[3:])


def to_vector(transform: ArrayLike) -> FloatArray:
    """The inverse of `from_vector`: `(4, 4)` -> `(6,)`."""
    from scipy.spatial.transform import Rotation  # noqa: PLC0415 -- as above

    t = np.asarray(transform, float)
    return np.concatenate([Rotation.from_matrix(t[:3, :3]).as_rotvec(), t[:3, 3]])


def transform_points(transform: ArrayLike, points: ArrayLike) -> FloatArray:
    """`T_a_b` `(4, 4)` and points of frame b `(N, 3)` -> the same points in frame a `(N, 3)`."""
    t = np.asarray(transform, float)
    return np.asarray(np.asarray(points, float).reshape(-1, 3) @ t[:3, :3].T + t[:3, 3], float)


def difference(a: ArrayLike, b: ArrayLike) -> tuple[float, float]:
    """How far two transforms `(4, 4)` between the same frames are apart: metres, radians."""
    from scipy.spatial.transform import Rotation  # noqa: PLC0415 -- as above

    turn = np.asarray(a, float)[:3, :3].T @ np.asarray(b, float)[:3, :3]
    shift = np.asarray(a, float)[:3, 3] - np.asarray(b, float)[:3, 3]
    return float(np.linalg.norm(shift)), float(Rotation.from_matrix(turn).magnitude())


@dataclass(frozen=True)
class Grid:
    """The box of space that a height map shows, in the robot's base frame, and the size of its pixels.

    Rows run along y and columns along x, as in Ravens: u grows with x, v with y. Pixels are (u, v) with centres at
    integers, so the middle of pixel 0 is half a pixel inside the lower bound. The defaults are those of Ravens.

    Raises `BaggieError` for bounds that are no whole number of pixels, at least one, or the wrong way round.
    """

    x: tuple[float, float] = (0.25, 0.75)
    """Metres, lower and upper bound."""
    y: tuple[float, float] = (-0.5, 0.5)
    z: tuple[float, float] = (0.0, 0.28)
    pixel_m: float = 0.003125

    def __post_init__(self) -> None:
        if not 0 < self.pixel_m < np.inf:
            raise BaggieError(
                f"expected pixels of a positive size in metres, got {self.pixel_m}; try 0.003125"
            )
        for axis, (low, high) in (("x", self.x), ("y", self.y), ("z", self.z)):
            if not -np.inf < low < high < np.inf:
                raise BaggieError(
                    f"expected bounds of {axis} from low to high, metres, got {low} to {high}; give the lower first"
                )
        for axis, (low, high) in (("x", self.x), ("y", self.y)):
            pixels = (high - low) / self.pixel_m
            whole = max(round(pixels), 1)
            if abs(pixels - whole) > 1e-6:
                raise BaggieError(
                    f"expected bounds of {axis} a whole number of {self.pixel_m} m pixels apart, got {low} to {high} "
                    f"({pixels:.2f} pixels); end at {low + whole * self.pixel_m:.9g}"
                )

    @property
    def shape(self) -> tuple[int, int]:
        """`(rows, columns)` of a height map."""
        rows, columns = (round((high - low) / self.pixel_m) for low, high in (self.y, self.x))
        return rows, columns

    def to_pixels(self, xy: ArrayLike) -> FloatArray:
        """`(N, 2)` metres in the robot's base frame -> `(N, 2)` pixels (u, v), inside the grid or not."""
        return (np.asarray(xy, float).reshape(-1, 2) - [self.x[0], self.y[0]]) / self.pixel_m - 0.5

    def to_robot(self, pixels: ArrayLike) -> FloatArray:
        """The inverse of `to_pixels`: `(N, 2)` pixels (u, v) -> `(N, 2)` metres."""
        return (np.asarray(pixels, float).reshape(-1, 2) + 0.5) * self.pixel_m + [self.x[0], self.y[0]]

    def contains(self, xy: ArrayLike) -> NDArray[np.bool_]:
        """Which points `(N, 2)` metres lie in one of the pixels: `(N,)`. The upper bounds themselves do not."""
        rows, columns = self.shape
        edges = self.to_pixels(xy) + 0.5
        return np.asarray(((edges >= 0) & (edges < [columns, rows])).all(axis=1))
