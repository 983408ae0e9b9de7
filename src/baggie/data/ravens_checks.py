"""The five files of a Ravens episode, plain data by now: whether they hold what they should."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baggie.data.ravens_cameras import RAVENS_CAMERAS
from baggie.data.ravens_episode import (
    Quaternion,
    RavensAction,
    RavensEpisode,
    RavensObject,
    RavensPose,
    Vector3,
)
from baggie.errors import DataError
from baggie.geometry import FloatArray

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
