"""Episodes of the Ravens benchmark (Zeng et al., "Transporter Networks", CoRL 2020): what they hold, checked.

Its three cameras' pictures of one moment are fused to one from straight above.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from baggie.errors import DataError
from baggie.geometry import FloatArray, Grid, PlanarPose, wrap_angle
from baggie.types import Intrinsics, Observation
from baggie.vision.height_map import RAVENS_DEPTH_CAMERAS, fuse

RAVENS_CAMERAS: tuple[tuple[Intrinsics, FloatArray], ...] = tuple(
    (camera.intrinsics, camera.T_base_camera) for camera in RAVENS_DEPTH_CAMERAS
)
"""(intrinsics, `T_base_camera` `(4, 4)`) of the front, left and right camera, in the order of the pictures."""


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


Pictures = Sequence[NDArray[Any]] | NDArray[Any]
"""One of each camera, in the order of `RAVENS_CAMERAS`."""


def fused(color: Pictures, depth: Pictures, grid: Grid) -> Observation:
    """The orthographic observation over `grid`, without a time, which Ravens does not tell.

    `color` 3 x `(480, 640, 3)` uint8 RGB, `depth` 3 x `(480, 640)` float32 metres. Raises `BaggieError` for pictures of
    another size.
    """
    views = [
        Observation(picture, distance, intrinsics)
        for picture, distance, (intrinsics, _) in zip(color, depth, RAVENS_CAMERAS, strict=True)
    ]
    seen = fuse(views, [pose for _, pose in RAVENS_CAMERAS], grid)
    return Observation(seen.color, grid=grid, height=seen.height)


FIELDS = ("action", "reward", "info", "depth", "color")
"""The folders in the order of reading and writing: small files are checked before pictures are read, and Ravens' own
code, which lists `color`, sees no episode that is not complete."""

_PICTURES = (len(RAVENS_CAMERAS), RAVENS_CAMERAS[0][0].height, RAVENS_CAMERAS[0][0].width)
_NORM_WITHIN = 1e-3


def checked_episode(
    number: int, seed: int, paths: Mapping[str, Path], read: Callable[[Path], object]
) -> RavensEpisode:
    """The episode in the files `paths`, by `FIELDS`, of which `read` gives the content.

    Raises `DataError` naming the file where a shape, type or length is wrong, a number is not finite or a quaternion is
    not of norm 1.
    """
    actions = _actions(read(paths["action"]), paths["action"])
    rewards = _rewards(read(paths["reward"]), paths["reward"])
    info = _info(read(paths["info"]), paths["info"])
    moments = len(actions) + 1
    _check_length(len(rewards), moments, paths["reward"])
    _check_length(len(info), moments, paths["info"])
    depth: NDArray[np.float32] = _pictures(read(paths["depth"]), _PICTURES, np.float32, paths["depth"])
    _check_length(len(depth), moments, paths["depth"])
    if not (np.isfinite(depth).all() and (depth >= 0).all()):
        raise _wrong(paths["depth"], "depths must be finite and not negative, metres")
    color: NDArray[np.uint8] = _pictures(read(paths["color"]), (*_PICTURES, 3), np.uint8, paths["color"])
    _check_length(len(color), moments, paths["color"])
    return RavensEpisode(number, seed, color, depth, actions, rewards, info)


def _wrong(path: Path, what: str) -> DataError:
    return DataError(f"{path}: {what}; get the file again, or leave this episode out")


def _check_length(length: int, expected: int, path: Path) -> None:
    if length != expected:
        raise _wrong(path, f"{expected} moments are expected, one more than there are actions, got {length}")


def _pictures(raw: object, shape: tuple[int, ...], dtype: type[np.generic], path: Path) -> NDArray[Any]:
    if not isinstance(raw, np.ndarray):
        raise _wrong(path, f"expected an array, got {_kind(raw)}")
    if raw.shape[1:] != shape or raw.ndim != len(shape) + 1 or raw.dtype != dtype:
        sizes = ", ".join(map(str, shape))
        raise _wrong(
            path, f"expected {np.dtype(dtype)} of shape (moments, {sizes}), got {raw.dtype} of {raw.shape}"
        )
    return raw


def _actions(raw: object, path: Path) -> tuple[RavensAction, ...]:
    if not isinstance(raw, list) or not raw or raw[-1] is not None:
        raise _wrong(path, "expected a list of actions that ends in None")
    return tuple(_action(action, f"action {i}", path) for i, action in enumerate(raw[:-1]))


def _action(raw: object, where: str, path: Path) -> RavensAction:
    if not isinstance(raw, dict) or set(raw) != {"pose0", "pose1"}:
        raise _wrong(path, f"{where} must be a dict of pose0 and pose1, got {_kind(raw)}")
    return RavensAction(*(_pose(raw[name], f"{name} of {where}", path) for name in ("pose0", "pose1")))


def _pose(raw: object, where: str, path: Path) -> RavensPose:
    match raw:
        case (xyz, xyzw):
            return RavensPose(
                _vector(xyz, f"the position in {where}", path),
                _quaternion(xyzw, f"the rotation in {where}", path),
            )
    raise _wrong(path, f"{where} must be (position, quaternion), got {_kind(raw)}")


def _rewards(raw: object, path: Path) -> FloatArray:
    length = len(raw) if isinstance(raw, list) or (isinstance(raw, np.ndarray) and raw.ndim == 1) else 0
    return np.array(_numbers(raw, length, "the list of rewards", path))


def _info(raw: object, path: Path) -> tuple[Mapping[int, RavensObject] | None, ...]:
    if not isinstance(raw, list):
        raise _wrong(path, f"expected a list, got {_kind(raw)}")
    return tuple(_objects(objects, f"moment {i}", path) for i, objects in enumerate(raw))


def _objects(raw: object, where: str, path: Path) -> Mapping[int, RavensObject] | None:
    if raw is None:
        return None
    if not isinstance(raw, dict) or not all(type(key) is int for key in raw):
        raise _wrong(path, f"{where} must be None or a dict by whole numbers, got {_kind(raw)}")
    return {key: _object(value, f"object {key} at {where}", path) for key, value in raw.items()}


def _object(raw: object, where: str, path: Path) -> RavensObject:
    match raw:
        case (position, rotation, dimensions):
            return RavensObject(
                _vector(position, f"the position of {where}", path),
                _quaternion(rotation, f"the rotation of {where}", path),
                _vector(dimensions, f"the dimensions of {where}", path),
            )
    raise _wrong(path, f"{where} must be (position, rotation, dimensions), got {_kind(raw)}")


def _vector(raw: object, where: str, path: Path) -> Vector3:
    x, y, z = _numbers(raw, 3, where, path)
    return x, y, z


def _quaternion(raw: object, where: str, path: Path) -> Quaternion:
    x, y, z, w = _numbers(raw, 4, where, path)
    norm = float(np.linalg.norm((x, y, z, w)))
    if abs(norm - 1) > _NORM_WITHIN:
        raise _wrong(path, f"{where} must be a quaternion of norm 1, got norm {norm:.3f}")
    return x, y, z, w


def _numbers(raw: object, length: int, where: str, path: Path) -> list[float]:
    """`length` finite numbers out of a list, a tuple or an array."""
    values = raw.tolist() if isinstance(raw, np.ndarray) and raw.shape == (length,) else raw
    if isinstance(values, list | tuple) and len(values) == length and all(map(_is_finite, values)):
        return [float(value) for value in values]
    raise _wrong(path, f"{where} must be {length or 'one or more'} finite numbers, got {_kind(raw)}")


def _is_finite(value: object) -> bool:
    # Compared, for `math.isfinite` overflows on the whole numbers a hostile file may hold.
    return type(value) in (int, float) and abs(value) <= sys.float_info.max  # type: ignore[arg-type]


def _kind(raw: object) -> str:
    """What came, in a few words; never its content, which a hostile file may make endless to print."""
    if isinstance(raw, np.ndarray):
        return f"an array of {raw.dtype} {raw.shape}"
    if isinstance(raw, list | tuple | dict):
        return f"a {type(raw).__name__} of {len(raw)}"
    return "None" if raw is None else f"a {type(raw).__name__}"
