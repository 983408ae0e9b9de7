"""Drawn attempts: a table, a red bag or several in stacks, and a camera map that is known exactly.

Enough for tests and for training a small network: the picture-to-robot map is smooth and fixed, the labels
carry the noise real grasps have, and the truth is there to measure against.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np

from baggie.calibration.files import CameraIdentity
from baggie.calibration.image_to_robot.map import ImageToRobot
from baggie.geometry import FloatArray, PlanarPose, Rectangle, wrap_angle
from baggie.types import (
    LAYER_M,
    Attempt,
    Failure,
    Image,
    Intrinsics,
    Observation,
    Outcome,
    PickPlace,
    Truth,
)

WORKSPACE = Rectangle(0.35, 0.65, -0.25, 0.25)
TASK = "put the bag on the goal"
BAG_SIDE_M = 0.12
BAG_HEIGHT_M = 0.03
LABEL_NOISE_M = 0.002
RED = (200, 40, 40)
COLORS = (RED, (60, 90, 200), (40, 160, 70), (200, 170, 40))
"""Of bags that lie about together."""

# The camera stands 1 m above the table, off centre and tilted by about 12 degrees: nothing is axis-aligned.
_CAMERA_XYZ = np.array([0.33, 0.08, 1.0])
_LOOKS_AT = np.array([0.51, -0.02, 0.0])
_ROLL = 0.08


def _camera_from_base() -> tuple[FloatArray, FloatArray]:
    """`T_camera_base` as a rotation vector and a translation; OpenCV's camera frame (z forward, y down)."""
    forward = (_LOOKS_AT - _CAMERA_XYZ) / np.linalg.norm(_LOOKS_AT - _CAMERA_XYZ)
    down = np.array([-math.cos(_ROLL), math.sin(_ROLL), 0.0])
    right = np.cross(down, forward)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    vector = np.asarray(cv2.Rodrigues(rotation)[0].ravel(), float)
    return vector, np.asarray(-rotation @ _CAMERA_XYZ)


def image_to_robot(size: tuple[int, int] = (1280, 720)) -> ImageToRobot:
    """The map of the drawn camera as a collector would have fitted it, right at half a bag's height."""
    at = [np.linspace(0.3, 0.7, 4), np.linspace(-0.3, 0.3, 4), [0.07, 0.17]]
    points = np.stack(np.meshgrid(*at), axis=-1).reshape(-1, 3)
    return ImageToRobot.fit(
        to_pixels(points, size),
        points,
        CameraIdentity("drawn", *size),
        intrinsics=intrinsics(size),
        height_m=BAG_HEIGHT_M / 2,
    )


def intrinsics(size: tuple[int, int] = (1280, 720)) -> Intrinsics:
    """The drawn camera: 93 x 61 degrees with a little distortion."""
    full = Intrinsics(
        1280,
        720,
        np.array([[608.0, 0.0, 642.3], [0.0, 607.6, 363.8], [0.0, 0.0, 1.0]]),
        np.array([0.06, -0.04, 0.0006, -0.0003, 0.0]),
    )
    return full.scaled(*size)


def to_pixels(xyz: FloatArray, size: tuple[int, int] = (1280, 720)) -> FloatArray:
    """Points of the robot base frame `(N, 3)` metres -> pixels `(N, 2)` (u, v)."""
    camera = intrinsics(size)
    rotation, translation = _camera_from_base()
    points = cv2.projectPoints(
        np.asarray(xyz, float), rotation, translation, camera.matrix, camera.distortion
    )[0]
    return np.asarray(points[:, 0], float)


def box_corners(pose: PlanarPose, size: tuple[int, int] = (1280, 720), layer: int = 0) -> FloatArray:
    """The outline of a bag at `pose`, half its height above the table or its layer: `(4, 2)` pixels (u, v)."""
    half = BAG_SIDE_M / 2
    corners = np.array([[-half, -half], [half, -half], [half, half], [-half, half]])
    return to_pixels(_on_table(pose, corners, layer * LAYER_M + BAG_HEIGHT_M / 2), size)


def make_attempt(
    attempt_id: int,
    rng: np.random.Generator,
    size: tuple[int, int] = (1280, 720),
    *,
    failure: Failure | None = None,
    depth: bool = True,
) -> Attempt:
    """An attempt in which a bag at a random pose was carried at least 20 cm (nowhere, when it failed).

    The executed poses are the truth plus about 2 mm of noise, as real grasps are.
    """
    before = _random_pose(rng)
    after = _random_pose(rng)
    while after.distance(before) < 0.2:
        after = _random_pose(rng)
    return carried(attempt_id, rng, before, after, size, failure=failure, depth=depth)


def carried(
    attempt_id: int,
    rng: np.random.Generator,
    before: PlanarPose,
    after: PlanarPose,
    size: tuple[int, int] = (1280, 720),
    *,
    failure: Failure | None = None,
    depth: bool = True,
) -> Attempt:
    """An attempt in which a bag was carried from one pose to another; it stayed where it was when it failed."""
    executed = PickPlace(_noisy(before, rng), _noisy(after, rng))
    commanded = PickPlace(_noisy(executed.pick, rng), _noisy(executed.place, rng))
    ends_at = before if failure else after
    exposure = rng.uniform(0.9, 1.1)
    start_s = 20.0 * attempt_id + 1.75e9  # wall clock: far more digits than float32 has
    grasp_m = 0.0 if failure == "missed-grasp" else float(rng.uniform(0.012, 0.025))
    return Attempt(
        attempt_id=attempt_id,
        task=TASK,
        before=_observe(before, rng, size, exposure=exposure, time_s=start_s, depth=depth),
        after=_observe(ends_at, rng, size, exposure=exposure, time_s=start_s + 11.125, depth=depth),
        commanded=commanded,
        outcome=Outcome(
            executed=executed,
            failure=failure,
            grasp_width_m=grasp_m,
            release_width_m=grasp_m * float(rng.uniform(0.9, 1.0)),
            pick_z_m=float(rng.uniform(0.010, 0.014)),
            place_z_m=float(rng.uniform(0.012, 0.018)),
            tries=int(rng.integers(1, 3)),
            timings_s={"pick": float(rng.uniform(4, 6)), "place": float(rng.uniform(5, 7))},
        ),
        box_before=box_corners(before, size),
        box_after=box_corners(ends_at, size),
        cell=0,
        seed=attempt_id,
        time=start_s,
        truth=Truth(before, ends_at),
    )


@dataclass(frozen=True)
class Lying:
    """A bag somewhere, perhaps on others."""

    pose: PlanarPose
    layer: int = 0
    color: tuple[int, int, int] = RED


def observe_bags(
    bags: Sequence[Lying], rng: np.random.Generator, size: tuple[int, int], time_s: float = 0.0
) -> Observation:
    """A picture of several bags, without depth."""
    color = _table(size)[0].copy()
    for bag in sorted(bags, key=lambda each: each.layer):
        _paint_bag(color, bag.pose, size, bag.color, bag.layer)
    return Observation(_exposed(color, rng, rng.uniform(0.9, 1.1)), None, intrinsics(size), time_s)


def make_stacking(count: int, seed: int, size: tuple[int, int], bags: int = 3) -> list[Attempt]:
    """Attempts one after another that lay bags of different colours on each other, and on the table again."""
    rng = np.random.default_rng([9, seed])
    lying: list[Lying] = []
    for color in COLORS[:bags]:
        lying.append(Lying(_free(rng, lying), 0, color))
    return [_stacked(number, rng, lying, size) for number in range(count)]


def _stacked(number: int, rng: np.random.Generator, lying: list[Lying], size: tuple[int, int]) -> Attempt:
    """One attempt; `lying` is as it leaves it then."""
    tops = [bag for bag in lying if not any(_above(other, bag) for other in lying)]
    moved = tops[int(rng.integers(len(tops)))]
    below = [bag for bag in tops if bag is not moved]
    ends = Lying(_free(rng, [bag for bag in lying if bag is not moved]), 0, moved.color)
    if below and rng.random() < 0.6:
        on = below[int(rng.integers(len(below)))]
        ends = Lying(_noisy(on.pose, rng), on.layer + 1, moved.color)
    alone = make_attempt(number, rng, (16, 9), depth=False)  # for all that is not about bags
    executed = PickPlace(_noisy(moved.pose, rng), _noisy(ends.pose, rng))
    before = observe_bags(lying, rng, size, alone.time)
    lying[lying.index(moved)] = ends
    return replace(
        alone,
        before=before,
        after=observe_bags(lying, rng, size, alone.time + 11.0),
        commanded=executed,
        outcome=replace(alone.outcome, executed=executed),
        box_before=box_corners(moved.pose, size, moved.layer),
        box_after=box_corners(ends.pose, size, ends.layer),
        truth=Truth(moved.pose, ends.pose),
        pick_layer=moved.layer,
        place_layer=ends.layer,
    )


def _above(bag: Lying, other: Lying) -> bool:
    return bag.layer > other.layer and bag.pose.distance(other.pose) < BAG_SIDE_M / 2


def _free(rng: np.random.Generator, lying: Sequence[Lying]) -> PlanarPose:
    """A pose apart from all bags; beside two there is room for a third, wherever they lie."""
    for _ in range(1000):
        pose = _random_pose(rng)
        if all(pose.distance(bag.pose) >= 0.15 for bag in lying):
            return pose
    raise ValueError(f"no room beside {len(lying)} bags")


def _random_pose(rng: np.random.Generator) -> PlanarPose:
    x, y = WORKSPACE.sample(rng, margin=0.02)
    return PlanarPose(float(x), float(y), float(rng.uniform(-math.pi / 4, math.pi / 4)))


def _noisy(pose: PlanarPose, rng: np.random.Generator) -> PlanarPose:
    dx, dy = rng.normal(0, LABEL_NOISE_M / math.sqrt(2), 2)
    yaw = wrap_angle(pose.yaw + float(rng.normal(0, 0.03)))
    return PlanarPose(pose.x + float(dx), pose.y + float(dy), yaw)


def _on_table(pose: PlanarPose, points: FloatArray, z: float) -> FloatArray:
    """Points of the bag's own frame `(N, 2)` -> robot base frame `(N, 3)` at height `z`."""
    flat = np.c_[points, np.ones(len(points))] @ pose.matrix().T
    return np.asarray(np.c_[flat[:, :2], np.full(len(points), z)])


def _outline(scale: float) -> FloatArray:
    """A rounded square (superellipse of degree 5): `(64, 2)` metres in the bag's own frame."""
    angle = np.linspace(0, 2 * math.pi, 64, endpoint=False)
    c, s = np.cos(angle), np.sin(angle)
    radius = (np.abs(c) ** 5 + np.abs(s) ** 5) ** (-1 / 5)
    return np.asarray(scale * BAG_SIDE_M / 2 * np.c_[radius * c, radius * s])


@lru_cache(maxsize=4)
def _table(size: tuple[int, int]) -> tuple[Image, FloatArray]:
    """The empty table: a grained grey-brown picture `(H, W, 3)` and its depth `(H, W)` metres."""
    width, height = size
    rng = np.random.default_rng(0)
    grain = cv2.resize(rng.normal(0, 1, (90, 20)), size, interpolation=cv2.INTER_CUBIC)
    shade = np.linspace(0.9, 1.1, width)[None, :] + 0.06 * grain
    color = np.clip(shade[..., None] * np.array([150, 138, 120]), 0, 255).astype(np.uint8)
    u, v = np.meshgrid(np.arange(width, dtype=float), np.arange(height, dtype=float))
    camera = intrinsics(size)
    pixels = np.c_[u.ravel(), v.ravel()][:, None]
    rays = cv2.undistortPoints(pixels, camera.matrix, camera.distortion)[:, 0]
    rotation, translation = _camera_from_base()
    up = cv2.Rodrigues(rotation)[0][
        :, 2
    ]  # the table's normal in the camera frame; the table is up @ p = up @ t
    depth = (up @ translation) / (np.c_[rays, np.ones(len(rays))] @ up)
    return color, depth.reshape(height, width)


def _observe(
    pose: PlanarPose,
    rng: np.random.Generator,
    size: tuple[int, int],
    *,
    exposure: float,
    time_s: float,
    depth: bool,
) -> Observation:
    table, table_depth = _table(size)
    color = table.copy()
    _paint_bag(color, pose, size)
    color = _exposed(color, rng, exposure)
    distance = None
    if depth:
        mask = np.zeros(color.shape[:2], np.uint8)
        polygon = to_pixels(_on_table(pose, _outline(1.0), BAG_HEIGHT_M / 2), size)
        cv2.fillPoly(mask, [np.round(polygon).astype(np.int32)], 1)
        distance = (np.round((table_depth - BAG_HEIGHT_M * mask) * 1000) / 1000).astype(np.float32)
    return Observation(color, distance, intrinsics(size), time_s)


def _paint_bag(
    picture: Image, pose: PlanarPose, size: tuple[int, int], color: tuple[int, int, int] = RED, layer: int = 0
) -> None:
    """Draw a pillow in three steps into the picture itself."""
    for scale, height, tint in ((1.0, 0.5, 0.8), (0.85, 0.8, 1.0), (0.5, 1.0, 1.12)):
        z = layer * LAYER_M + height * BAG_HEIGHT_M
        polygon = to_pixels(_on_table(pose, _outline(scale), z), size)
        fixed = np.round(polygon * 256).astype(np.int32)
        cv2.fillPoly(picture, [fixed], tuple(tint * c for c in color), cv2.LINE_AA, 8)


def _exposed(picture: Image, rng: np.random.Generator, exposure: float) -> Image:
    noise = rng.integers(-3, 4, picture.shape, dtype=np.int8)
    return np.clip(picture * np.float32(exposure) + noise, 0, 255).astype(np.uint8)
