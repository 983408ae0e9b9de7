"""The words of the one loop: look (Observation), plan (Goal -> Plan), move (PickPlace), check (Outcome)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Literal, get_args

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from baggie.errors import BaggieError
from baggie.geometry import FloatArray, Grid, PlanarPose
from baggie.moved import renamed
from baggie.pictures import as_metres, as_outline, as_picture

if not TYPE_CHECKING:  # so that a type checker knows which names there are
    __getattr__ = partial(renamed, __name__)

_CONVERGED_PX = 1e-6
_LAST_TO_CONVERGE = 100
"""So many of the outermost pixels tell whether all have converged."""
_NEWTON_STEPS = 30
"""It halves the error at least, and is exact after six where it begins near."""

LAYER_M = 0.022
"""By how much a bag lies higher than what carries it, on the average; measured: 18 to 25 mm."""


def middle_of_layer_m(layer: int) -> float:
    """Metres above the table of the middle of a bag with so many others below it, on each other."""
    return (layer + 0.5) * LAYER_M


Image = NDArray[np.uint8]
"""`(H, W, 3)` uint8, RGB."""

GoalStyle = Literal["outline", "solid", "card"]
"""How a goal shows in the picture: as a drawn outline or patch, or as a card that really lies there, undrawn."""
Failure = Literal["missed-grasp", "dropped", "lost-bag", "unreachable", "stalled", "slid-off"]


@dataclass(frozen=True)
class Intrinsics:
    """A pinhole camera with OpenCV's distortion model, for pictures of `width` x `height` pixels."""

    width: int
    height: int
    matrix: FloatArray
    """`(3, 3)` camera matrix, pixels."""
    distortion: FloatArray
    """`(D,)` coefficients in OpenCV's order; empty for none."""

    def scaled(self, width: int, height: int) -> Intrinsics:
        """Give the camera for its pictures resized, pixels (pixel centres at half-integers + 0.5 convention)."""
        sx, sy = width / self.width, height / self.height
        matrix = self.matrix.copy()
        matrix[0] *= sx
        matrix[1] *= sy
        matrix[0, 2] += (sx - 1) / 2
        matrix[1, 2] += (sy - 1) / 2
        return Intrinsics(width, height, matrix, self.distortion)

    def project(self, points: FloatArray) -> FloatArray:
        """Where points of the camera's frame appear: `(N, 3)` metres -> `(N, 2)` pixels (u, v)."""
        still = np.zeros(3)
        points = np.asarray(points, float).reshape(-1, 1, 3)
        pixels, _ = cv2.projectPoints(points, still, still, self.matrix, self.distortion)
        return np.asarray(pixels.reshape(-1, 2), float)

    def rays(self, pixels: FloatArray) -> FloatArray:
        """The directions (x/z, y/z) that pixels see, lens distortion undone: `(N, 2)` -> `(N, 2)`."""
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-12)
        seen = np.asarray(pixels, float).reshape(-1, 1, 2)
        same = np.eye(3)
        rays = cv2.undistortPointsIter(seen, self.matrix, self.distortion, same, same, criteria)
        return self._converged(np.asarray(rays.reshape(-1, 2), float), seen.reshape(-1, 2))

    def _converged(self, rays: FloatArray, pixels: FloatArray) -> FloatArray:
        """Rays by Newton's method where OpenCV's fixed point, which is slow for very wide lenses, is not there yet.

        Pixels that no ray reaches, beyond where the distortion folds, keep the nearest that was found.
        """
        if not len(pixels):
            return rays
        inwards = -np.linalg.norm(pixels - self.matrix[:2, 2], axis=1)
        outermost = np.argpartition(inwards, min(_LAST_TO_CONVERGE, len(pixels)) - 1)[:_LAST_TO_CONVERGE]
        if not (np.abs(self._off(rays[outermost], pixels[outermost])) > _CONVERGED_PX).any():
            return rays
        off = self._off(rays, pixels)
        far = np.flatnonzero(np.abs(off).max(axis=1) > _CONVERGED_PX)
        still, rays = np.zeros(3), rays.copy()
        for _ in range(_NEWTON_STEPS):
            if not far.size:
                break
            points = np.c_[rays[far], np.ones(far.size)]
            _, jacobian = cv2.projectPoints(points, still, still, self.matrix, self.distortion)
            by_ray = np.asarray(jacobian, float)[:, 3:5].reshape(
                -1, 2, 2
            )  # the camera's motion is the point's
            nearer = rays[far] + (np.linalg.pinv(by_ray) @ off[far, :, None])[..., 0]
            off_then = self._off(nearer, pixels[far])
            better = np.abs(off_then).max(axis=1) < np.abs(off[far]).max(axis=1)
            far, nearer, off_then = far[better], nearer[better], off_then[better]
            rays[far], off[far] = nearer, off_then
            far = far[np.abs(off_then).max(axis=1, initial=0.0) > _CONVERGED_PX]
        return rays

    def _off(self, rays: FloatArray, pixels: FloatArray) -> FloatArray:
        """How far from the pixels the rays' own ones are, `(N, 2)`."""
        return pixels - self.project(np.c_[rays, np.ones(len(rays))])


@dataclass(frozen=True)
class Observation:
    """What a camera saw once; or, with a grid, the table as seen from straight above.

    An orthographic picture (`baggie.vision.height_map`) has `grid` and `height` in place of `intrinsics` and `depth`.
    Raises `BaggieError` for a picture that is none, and for depths in a camera's own units.
    """

    color: Image
    """`(H, W, 3)` uint8, RGB; whatever pictures come as is made that (`baggie.pictures.as_picture`)."""
    depth: NDArray[np.float32] | None = None
    """`(H, W)` float32, metres along the optical axis; 0 where unknown."""
    intrinsics: Intrinsics | None = None
    time: float = 0.0
    """Seconds; of the workcell's own clock."""
    grid: Grid | None = None
    """Which pixel shows which place, in the robot's base frame; None for a camera's own picture."""
    height: NDArray[np.float32] | None = None
    """`(H, W)` float32, metres above the grid's lower bound of z; 0 where nothing is known. None without a grid."""
    tried: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))
    """`(N, 2)` (u, v) pixels: where picks came to nothing since the scene is as it is (`baggie.policies.memory`)."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "color", as_picture(self.color))
        for name in ("depth", "height"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, as_metres(getattr(self, name), name))

    @property
    def size(self) -> tuple[int, int]:
        """`(width, height)` in pixels."""
        return self.color.shape[1], self.color.shape[0]

    def resized(self, width: int, height: int) -> Observation:
        """Resize the picture to so many pixels (area average); depth takes the nearest value, never a mixture.

        Raises `BaggieError` for an orthographic picture: the size of its pixels is its grid's.
        """
        if self.size == (width, height):
            return self
        if self.grid is not None:
            raise BaggieError(
                f"expected an orthographic picture of {self.size[0]} x {self.size[1]} pixels to stay as it is, got "
                f"{width} x {height} asked for; fuse again over another grid"
            )
        color = np.asarray(cv2.resize(self.color, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
        depth = self.depth
        if depth is not None:
            nearest = cv2.resize(depth, (width, height), interpolation=cv2.INTER_NEAREST_EXACT)
            depth = np.asarray(nearest, np.float32)
        intrinsics = self.intrinsics.scaled(width, height) if self.intrinsics else None
        return replace(self, color=color, depth=depth, intrinsics=intrinsics)


@dataclass(frozen=True)
class Goal:
    """Where the object must end, in the picture: a region, and how it is drawn.

    The region is a polygon of pixel corners `(N, 2)` as (u, v) in the observation's picture. Raises `BaggieError` for
    corners that enclose nothing, and for a style, a colour or a point that is none.
    """

    corners: FloatArray
    """In order around the region; those of a zigzag are put in order (`baggie.pictures.as_outline`)."""
    style: GoalStyle = "solid"
    color: tuple[int, int, int] = (0, 200, 0)
    """RGB."""
    object_at: tuple[float, float] | None = None
    """A pixel (u, v) on the object to be moved, where several lie there; None leaves the choice to the policy."""
    layer: int = 0
    """How many bags lie below the region, on each other: 0 where the object goes onto the table."""
    object_layer: int = 0
    """The same of the object to be moved: how many lie below it now."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "corners", as_outline(self.corners))
        if self.style not in get_args(GoalStyle):
            raise BaggieError(
                f"expected a goal's style among {', '.join(get_args(GoalStyle))}, got {self.style!r}"
            )
        red_green_blue = _numbers(self.color, 3)
        if red_green_blue is None or not all(0 <= number <= 255 for number in red_green_blue):
            raise BaggieError(
                f"expected a goal's colour as three numbers from 0 to 255, RGB, got {self.color!r}"
            )
        if self.object_at is not None:
            pixel = _numbers(self.object_at, 2)
            if pixel is None:
                raise BaggieError(
                    f"expected the object's pixel as two numbers (u, v), got {self.object_at!r}"
                )
            object.__setattr__(self, "object_at", pixel)
        for name in ("layer", "object_layer"):
            number = getattr(self, name)
            if not isinstance(number, int | np.integer) or isinstance(number, bool) or number < 0:
                raise BaggieError(f"expected a goal's {name} as a count from 0 on, got {number!r}")
            object.__setattr__(self, name, int(number))

    @property
    def center(self) -> FloatArray:
        """`(2,)`, the mean of the corners, pixels (u, v)."""
        return np.asarray(self.corners.mean(axis=0))

    def scaled(self, factor_u: float, factor_v: float) -> Goal:
        """Scale the goal to a picture resized by these factors (pixel centres are at integer (u, v))."""
        factors = np.array([factor_u, factor_v])
        object_at = self.object_at
        if object_at is not None:
            u, v = (np.array(object_at) + 0.5) * factors - 0.5
            object_at = (float(u), float(v))
        return replace(self, corners=(self.corners + 0.5) * factors - 0.5, object_at=object_at)


def _numbers(values: Any, count: int) -> tuple[float, ...] | None:
    """Read values as so many finite numbers; None where they are none."""
    try:
        numbers = np.asarray(values, float)
    except (TypeError, ValueError):
        return None
    return tuple(numbers.tolist()) if numbers.shape == (count,) and np.isfinite(numbers).all() else None


def require_observation(observation: Observation) -> Observation:
    """The observation, for a policy. Raises `BaggieError` for what is none, such as its picture alone."""
    if not isinstance(observation, Observation):
        kind = type(observation).__name__
        raise BaggieError(f"expected an observation, got {kind}; give plan(Observation(picture), goal) one")
    return observation


def require_goal(goal: Goal | None) -> Goal:
    """The goal, for a policy that needs one. Raises `BaggieError` where there is none."""
    if goal is None:
        raise BaggieError("expected a goal marked in the picture, got none; give plan(observation, goal) one")
    if not isinstance(goal, Goal):
        kind = type(goal).__name__
        raise BaggieError(f"expected a goal, got {kind}; give plan(observation, Goal(corners)) one")
    return goal


@dataclass(frozen=True)
class PickPlace:
    """The action: where to grasp and where to let go, in the robot's base frame.

    How low the hand goes follows from what lies there; it stops before where it feels something.
    """

    pick: PlanarPose
    place: PlanarPose
    pick_on_m: float | None = 0.0
    """Height above the table, metres, of what the thing to be picked lies on; None where nobody knows: then the thing
    is felt for, which takes an arm that feels as little as a soft thing gives (`ArmInfo.feels_n`)."""
    place_on_m: float | None = 0.0
    """The same of what it shall be placed on."""
    tallest_m: float = 0.0
    """Height of the tallest stack on the table, metres, that the hand and what it carries have to pass over."""

    def carry(self, pose: PlanarPose) -> PlanarPose:
        """Where a thing comes to lie that is at `pose` and moves with the hand from the pick to the place."""
        return self.place @ self.pick.inverse() @ pose

    def to_array(self) -> FloatArray:
        """`(6,)`: pick x, y, yaw, place x, y, yaw; metres and radians."""
        a, b = self.pick, self.place
        return np.array([a.x, a.y, a.yaw, b.x, b.y, b.yaw])

    @classmethod
    def from_array(cls, values: ArrayLike) -> PickPlace:
        """The inverse of `to_array`. Raises `BaggieError` for anything but six numbers."""
        try:
            px, py, pt, qx, qy, qt = (float(value) for value in np.asarray(values, float))
        except (TypeError, ValueError):
            raise BaggieError(
                "expected an action of six numbers, pick x, y, yaw and place x, y, yaw, got "
                f"{' '.join(str(values).split())}; give metres and radians"
            ) from None
        return cls(PlanarPose(px, py, pt), PlanarPose(qx, qy, qt))


@dataclass(frozen=True)
class Plan:
    """What a policy wants done, how sure it is, and what a person wants to see."""

    action: PickPlace
    confidence: float = 1.0
    """In [0, 1]; 1 where the policy has no doubt or cannot tell."""
    pick_within_m: float | None = None
    """The radius around the pick that holds the object's true middle nine times of ten; None where it cannot tell."""
    place_within_m: float | None = None
    """The radius around the goal in which the object ends nine times of ten, scatter of its release included."""
    views: Mapping[str, NDArray[np.float32]] = field(default_factory=dict)
    """Heat maps by name, `(h, w)` float32 in [0, 1], of the whole picture at any resolution."""


@dataclass(frozen=True)
class Outcome:
    """What happened when an action was executed."""

    executed: PickPlace
    """Poses the arm really was at when it closed and opened the gripper."""
    failure: Failure | None = None
    grasp_width_m: float = 0.0
    """Between the fingers, after the lift."""
    release_width_m: float = 0.0
    """Between the fingers just before letting go; much less than `grasp_width_m` means it was dropped."""
    pick_z_m: float = 0.0
    """Height of the fingertips when the gripper closed, above the table."""
    place_z_m: float = 0.0
    """Height of the fingertips at release."""
    tries: int = 1
    timings_s: Mapping[str, float] = field(default_factory=dict)
    """Seconds of the workcell's clock by phase: `pick`, `place`, ..."""

    @property
    def success(self) -> bool:
        """Whether the object was grasped, carried and put down."""
        return self.failure is None


@dataclass(frozen=True)
class Truth:
    """What only a simulator knows. Evaluation may read it; no policy ever does."""

    before: PlanarPose
    """The object's centre and yaw before the attempt."""
    after: PlanarPose
    """The same at its end."""


@dataclass(frozen=True)
class Attempt:
    """One turn of the loop, recorded: the unit of data."""

    attempt_id: int
    task: str
    """The instruction in words, as LeRobot stores it."""
    before: Observation
    after: Observation | None
    commanded: PickPlace
    outcome: Outcome
    box_before: FloatArray
    """`(4, 2)` corners of the bag in the picture before, pixels (u, v); NaN where it was not found."""
    box_after: FloatArray
    """`(4, 2)`, the same in the picture after."""
    cell: int = 0
    seed: int = 0
    time: float = 0.0
    """Seconds of the workcell's clock when the attempt began."""
    truth: Truth | None = None
    episode: int | None = None
    """Of a task that takes several attempts: which try at it this one belongs to; None where it stands alone."""
    step: int = 0
    """Which attempt of its episode it is, from 0."""
    reward: float | None = None
    """How much of its episode's task this attempt has done, all of it being 1; None where nobody counts."""
    object_symmetry: int | None = None
    """How often a turn what is moved looks the same: 4 a square, 2 a long one, 1 only after a whole turn, 0 at any
    angle; None where nobody said."""
    pick_layer: int | None = None
    """How many bags lay below what was picked, on each other, as whoever showed it believed; None if nobody counted."""
    place_layer: int | None = None
    """The same of where it was placed."""
    under: tuple[PlanarPose, ...] = ()
    """Where those that it was placed on lay, as whoever showed it believed; robot base frame."""
