"""Orthographic height maps of the table, fused from colour cameras with depth whose poses are known.

Zeng et al., "Transporter Networks: Rearranging the Visual World for Robotic Manipulation", CoRL 2020, on spatially
consistent visual representations: in such a picture an object looks the same wherever it lies, and moving it is moving
its pixels.

Small holes are filled. A hole is small where a closing of what was seen covers it; large unseen areas keep their
outline. Most holes lie between the points of one surface that are further apart than pixels, and the nearest seen pixel
is right. Others are shadows: floor beside a box, which the box hides from every camera. The nearest pixel may then be
the box's, and taking it would make the box wider. But a box there would hide what is behind it: where a camera sees
past the point that a hole would get, the point is not there (space carving: Kutulakos & Seitz, "A Theory of Shape by
Space Carving", 2000), and the lowest pixel near by is taken instead, for what is hidden lies behind what hides it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from baggie.errors import BaggieError
from baggie.geometry import FloatArray, Grid, invert_transform, is_rigid, rigid, transform_points
from baggie.types import Image, Intrinsics, Observation

_WIDEST_PX = 6
"""Holes up to this wide are filled; wherever in one a pixel is, what lies across is no further away."""
_CLOSING = np.ones((_WIDEST_PX + 1,) * 2, np.uint8)
_ACROSS = np.ones((2 * _WIDEST_PX + 1,) * 2, np.uint8)
_PAST_M = 0.01
"""How much further than a point a camera must see, to see past it: well above the noise of depth cameras."""
_SAME_RAY = 1e-3
"""Slopes this near are one: about a pixel."""

TooHigh = Callable[[FloatArray, NDArray[np.float32]], NDArray[np.bool_]]
"""Pixels `(N, 2)` (u, v) and heights that they would get `(N,)`, metres -> where there is nothing that high `(N,)`."""


def fill_sources(
    height: NDArray[np.float32], seen: NDArray[np.bool_], too_high: TooHigh
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """The pixels to fill and the seen one that each takes after: `(N,)` and `(N,)` indices into the flat height map.

    `height` `(rows, columns)` metres, at least 0, and `seen` `(rows, columns)`.
    """
    covered = cv2.morphologyEx(seen.astype(np.uint8), cv2.MORPH_CLOSE, _CLOSING) > 0
    holes = np.flatnonzero(covered & ~seen)
    if not holes.size:
        return holes, holes
    sources = _nearest(seen)[holes]
    v, u = np.divmod(holes, seen.shape[1])
    wrong = too_high(np.c_[u, v].astype(float), height.flat[sources])
    sources[wrong] = _lowest(height, seen)[holes[wrong]]
    return holes, sources


def sees_past(observation: Observation, pose: FloatArray, points: FloatArray) -> NDArray[np.bool_]:
    """Whether a camera at `T_base_camera` `(4, 4)` sees something well behind each of the points `(N, 3)`: `(N,)`.

    It sees past no point where its depth is unknown, nor past what is out of its picture.
    """
    assert observation.depth is not None
    assert observation.intrinsics is not None
    lens = observation.intrinsics
    past = np.zeros(len(points), np.bool_)
    local = transform_points(invert_transform(pose), points)
    ahead = np.flatnonzero(local[:, 2] > 0)
    if not ahead.size:
        return past
    exact = lens.project(local[ahead])
    pixels = np.rint(exact)
    inside = ((pixels >= 0) & (pixels < [lens.width, lens.height])).all(axis=1)
    ahead, exact, (u, v) = ahead[inside], exact[inside], pixels[inside].astype(np.intp).T
    depth = observation.depth[v, u]
    further = np.isfinite(depth) & (depth > local[ahead, 2] + _PAST_M)
    # The polynomial of a bent lens may fold what is far outside the picture back into it.
    there = np.abs(lens.rays(exact) - local[ahead, :2] / local[ahead, 2:]).max(axis=1) < _SAME_RAY
    past[ahead] = further & there
    return past


def _nearest(seen: NDArray[np.bool_]) -> NDArray[np.intp]:
    """The flat index of the seen pixel nearest to each: `(rows * columns,)`."""
    _, labels = cv2.distanceTransformWithLabels(
        (~seen).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL
    )
    index_of = np.zeros(labels.max() + 1, np.intp)
    index_of[labels[seen]] = np.flatnonzero(seen)
    return np.asarray(index_of[labels.ravel()], np.intp)


def _lowest(height: NDArray[np.float32], seen: NDArray[np.bool_]) -> NDArray[np.intp]:
    """The flat index of the lowest seen pixel within the widest hole of each: `(rows * columns,)`."""
    order = np.argsort(np.where(seen, height, np.inf), axis=None, kind="stable")
    rank = np.empty(seen.size)
    rank[order] = np.arange(seen.size)
    least = cv2.erode(rank.reshape(seen.shape), _ACROSS)
    return np.asarray(order[least.ravel().astype(np.intp)], np.intp)


@dataclass(frozen=True)
class DepthCamera:
    """What its pictures are made of and where it looks from. Depth belongs to colour, pixel by pixel."""

    name: str
    intrinsics: Intrinsics
    T_base_camera: FloatArray
    """`(4, 4)`; the camera's frame is OpenCV's: z along the optical axis, x right and y down in the picture."""


_WIDTH, _HEIGHT, _FOCAL_LENGTH = 640, 480, 450.0
_MIDDLE_U, _MIDDLE_V = (_WIDTH - 1) / 2, (_HEIGHT - 1) / 2

_INTRINSICS = Intrinsics(
    _WIDTH,
    _HEIGHT,
    np.array([[_FOCAL_LENGTH, 0, _MIDDLE_U], [0, _FOCAL_LENGTH, _MIDDLE_V], [0, 0, 1]]),
    np.zeros(0),
)


def _ravens_camera(name: str, position: ArrayLike, euler_deg: ArrayLike) -> DepthCamera:
    turn = Rotation.from_euler("xyz", euler_deg, degrees=True).as_matrix()
    return DepthCamera(name, _INTRINSICS, rigid(turn, position))


RAVENS_DEPTH_CAMERAS = (
    _ravens_camera("front", (1.0, 0.0, 0.75), (45, 180, -90)),
    _ravens_camera("left", (0.0, 0.5, 0.75), (40, 180, 45)),
    _ravens_camera("right", (0.0, -0.5, 0.75), (40, 180, 135)),
)
"""Those of the Ravens benchmark (Zeng et al., "Transporter Networks", CoRL 2020), in the order of its pictures.

Measured on an episode of `stack-block-pyramid`, with 27 views of blocks that lie free and still:

- The angles are PyBullet's: turns about the fixed x, then y, then z axis (`R = Rz Ry Rx`).
- Depth is along the optical axis, not along the ray.
- The principal point is the picture's middle, (319.5, 239.5) where pixel centres are at integers. Ravens' own code
  takes (320, 240) with the same pixels, which shifts its clouds by 1.1 to 2.0 mm, those of each camera in another
  direction, and lifts its table by 0.7 mm.

So read, the table lies at 0.00 mm in all three (median; single depths scatter by 0.5 mm), and boxes fitted to the
points of each camera alone lie within 0.04 mm sideways and 0.08 mm in height of where `info` has the blocks. The first
picture of an episode shows blocks that still fall the last millimetre.
"""


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
    pixel near by (which is said above); large ones stay empty.

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
