"""Orthographic height maps: the table as seen from straight above, whatever cameras looked at it from where.

Zeng et al., "Transporter Networks: Rearranging the Visual World for Robotic Manipulation", CoRL 2020, on spatially
consistent visual representations: in such a picture an object looks the same wherever it lies, and moving it is moving
its pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from baggie.errors import BaggieError
from baggie.geometry import FloatArray, is_rigid
from baggie.grid import Grid
from baggie.types import Image, Intrinsics, Observation
from baggie.vision.holes import fill_sources, sees_past

_BELOW_M = 0.01
"""Points this far below the grid still count, at height 0: they are the table's own, which noise, an imperfect pose or
rounding alone spreads to both sides of its true height. Dropping the lower half would thin out the table."""
_LEVEL_M = 1e-5
"""Points whose heights differ by less are equally high: the rounding of depth alone makes such differences, and they
must not decide which of the points on a flat table gives a pixel its colour."""
_RIGID = 1e-4
"""How far a rotation's rows may be from orthonormal: written down with five digits, it still passes."""


@dataclass(frozen=True)
class HeightMap:
    """Colour and height of the highest surface in each pixel of a grid."""

    color: Image
    """`(rows, columns, 3)` uint8, RGB; black where nothing is known."""
    height: NDArray[np.float32]
    """`(rows, columns)` metres above the grid's lower bound of z, never negative; 0 where nothing is known."""
    seen: NDArray[np.bool_]
    """`(rows, columns)`: whether a camera truly saw something in the pixel. Holes that were filled are False here."""
    grid: Grid


def fuse(
    observations: Sequence[Observation], poses: Sequence[ArrayLike], grid: Grid | None = None
) -> HeightMap:
    """What cameras with depth see, from straight above; `poses` are `T_base_camera` `(4, 4)`, one an observation.

    The colour of an observation belongs to its depth, pixel by pixel. Each pixel of depth is one point, where its
    centre looks; depth that is 0 or no finite number is unknown. A pixel of the map takes the highest of the points
    that fall into it, whichever camera it is from, and that very point's colour (among equally high points, that
    nearest to its middle); the order of the cameras makes no difference. Small holes take the height and colour of a
    pixel near by (`holes.py` says which); large ones stay empty.

    Raises `BaggieError` where depth or intrinsics are missing or of another size than the picture, poses are not rigid,
    or there are not as many as observations. `grid` is that of Ravens unless given.
    """
    grid = grid or Grid()
    transforms = _checked(observations, poses)
    rows, columns = grid.shape
    best = np.full(rows * columns, -1, np.int64)
    for observation, pose in zip(observations, transforms, strict=True):
        _add_points(best, observation, pose, grid)
    seen = (best >= 0).reshape(rows, columns)
    color, above = _unpacked(best)
    height = np.maximum(above - np.float32(_BELOW_M), 0).reshape(rows, columns)

    def too_high(pixels: FloatArray, heights: NDArray[np.float32]) -> NDArray[np.bool_]:
        points = np.c_[grid.to_robot(pixels), heights + grid.z[0]]
        past = [sees_past(each, pose, points) for each, pose in zip(observations, transforms, strict=True)]
        return np.asarray(np.any(past, axis=0))

    holes, sources = fill_sources(height, seen, too_high)
    color[holes] = color[sources]
    height.flat[holes] = height.flat[sources]
    return HeightMap(color.reshape(rows, columns, 3), height, seen, grid)


def _add_points(best: NDArray[np.int64], observation: Observation, pose: FloatArray, grid: Grid) -> None:
    """Let the points of one camera compete for the pixels: `best` `(rows * columns,)` holds the winners, packed."""
    assert observation.depth is not None
    assert observation.intrinsics is not None
    depth = np.asarray(observation.depth, np.float32).ravel()
    turned = pose[:3, :3].astype(np.float32) @ _rays(observation.intrinsics)
    with np.errstate(invalid="ignore"):  # an infinite depth may become no number; either falls out below
        x, y, z = turned * depth + pose[:3, 3:].astype(np.float32)
    rows, columns = grid.shape
    # Counted from the edge of the grid, so that the floor is the pixel.
    u, v = ((along - low) / grid.pixel_m for along, (low, _) in ((x, grid.x), (y, grid.y)))
    above = z - np.float32(grid.z[0] - _BELOW_M)
    inside = (depth > 0) & (u >= 0) & (u < columns) & (v >= 0) & (v < rows)
    inside &= (above >= 0) & (z <= grid.z[1])
    at = np.flatnonzero(inside)
    place = np.stack([u[at], v[at]])
    pixel = np.floor(place)
    column, row = pixel.astype(np.intp)
    packed = _packed(observation.color.reshape(-1, 3)[at], above[at], place - pixel - np.float32(0.5))
    np.maximum.at(best, row * columns + column, packed)


def _packed(color: Image, above: NDArray[np.float32], offset: NDArray[np.float32]) -> NDArray[np.int64]:
    """Points of `color` `(N, 3)`, heights of at least 0 `(N,)` and `offset` `(2, N)` from the middle of their pixel, in
    [-0.5, 0.5], as numbers `(N,)` of which the largest is the point that a pixel shows: the highest one, and among
    equally high ones that nearest to the middle. (The colour comes last, for what is left to be equal.)
    """
    below = np.empty((len(color), 4), np.uint8)
    below[:, :3] = color
    below[:, 3] = 255 * (1 - 2 * np.abs(offset).max(axis=0))
    levels = (above / np.float32(_LEVEL_M) + np.float32(0.5)).astype(np.int64)
    return np.asarray(levels << 32 | below.view("<u4")[:, 0], np.int64)


def _unpacked(packed: NDArray[np.int64]) -> tuple[Image, NDArray[np.float32]]:
    """Colours `(N, 3)` and heights `(N,)` of packed points; for -1, which is no point, black and 0."""
    known = np.maximum(packed, 0)
    color = (known & 0xFFFFFFFF).astype("<u4").view(np.uint8).reshape(-1, 4)[:, :3].copy()
    return color, ((known >> 32) * _LEVEL_M).astype(np.float32)


def _rays(intrinsics: Intrinsics) -> NDArray[np.float32]:
    """`(3, H * W)`: x/z, y/z and 1 of what each pixel's centre sees, row by row."""
    matrix, distortion = (np.asarray(each, float) for each in (intrinsics.matrix, intrinsics.distortion))
    return _rays_of(intrinsics.width, intrinsics.height, matrix.tobytes(), distortion.tobytes())


@lru_cache(maxsize=8)
def _rays_of(width: int, height: int, matrix: bytes, distortion: bytes) -> NDArray[np.float32]:
    """Undoing a lens takes longer than all else together, and a camera keeps its lens."""
    lens = Intrinsics(width, height, np.frombuffer(matrix).reshape(3, 3), np.frombuffer(distortion))
    v, u = np.divmod(np.arange(width * height), width)
    rays = np.vstack([lens.rays(np.c_[u, v]).T, np.ones(width * height)]).astype(np.float32)
    rays.setflags(write=False)
    return rays


def _checked(observations: Sequence[Observation], poses: Sequence[ArrayLike]) -> list[FloatArray]:
    """The poses as `(4, 4)` arrays, or one line that says what is wrong."""
    if len(observations) != len(poses) or not len(poses):
        raise BaggieError(
            f"expected one camera pose for each of one or more observations, got {len(poses)} poses for "
            f"{len(observations)} observations; give both in the same order"
        )
    for number, observation in enumerate(observations):
        _check_observation(observation, f"observation {number}")
    transforms = [np.asarray(pose, float) for pose in poses]
    for number, transform in enumerate(transforms):
        if not is_rigid(transform, _RIGID):
            raise BaggieError(
                f"expected pose {number} to be a rigid transform T_base_camera (4, 4): a rotation and a translation in "
                f"metres above a row 0 0 0 1, got {np.array2string(transform, precision=3).replace(chr(10), '')}; "
                "take it from a calibration"
            )
    return transforms


def _check_observation(observation: Observation, name: str) -> None:
    depth, intrinsics = observation.depth, observation.intrinsics
    if depth is None:
        raise BaggieError(f"expected depth, got {name} without any; height maps need a depth camera")
    if intrinsics is None:
        raise BaggieError(f"expected intrinsics, got {name} without any; calibrate the camera first")
    width, height = observation.size
    if depth.shape != (height, width) or (intrinsics.width, intrinsics.height) != (width, height):
        raise BaggieError(
            f"expected depth and intrinsics of {width} x {height} pixels, as the picture of {name}, got depth of "
            f"{' x '.join(str(side) for side in depth.shape[::-1])} and intrinsics of {intrinsics.width} x "
            f"{intrinsics.height}; register depth to colour, and resize both with Observation.resized"
        )
