"""Points that a robot touches: which ones of a target, the motion between two lists of them, and which agree on one.

The world's frame is a person's who sees the target on the table: its origin is the lowest left point of the print, x
runs right along the print, y up it, z out of the paper.
"""

from __future__ import annotations

from itertools import combinations
from math import comb

import numpy as np
from numpy.typing import NDArray

from baggie.calibration.pose import UncertainTransform
from baggie.geometry import FloatArray, rigid, transform_points
from baggie.vision.targets import Target

_ROUNDING_M = 1e-9
_FLOOR_M = 0.001
"""Points this close agree, however well the others do."""
_FALSE_ALARMS = 0.01
"""How often a point is dropped where all are good."""
_MAX_TRIPLES = 300


def fit_rigid(a: FloatArray, b: FloatArray) -> FloatArray:
    """`T_a_b` `(4, 4)` from points `(N, 3)`: the rotation, never a reflection, with least squared distances.

    Umeyama, "Least-Squares Estimation of Transformation Parameters Between Two Point Patterns", 1991.
    """
    center_a, center_b = a.mean(axis=0), b.mean(axis=0)
    rotation = _rotation(a - center_a, b - center_b)
    return rigid(rotation, center_a - rotation @ center_b)


def distances(T_a_b: FloatArray, a: FloatArray, b: FloatArray) -> FloatArray:
    """`(N,)` metres from where points are in frame a to where the motion puts them."""
    return np.asarray(np.linalg.norm(b @ T_a_b[:3, :3].T + T_a_b[:3, 3] - a, axis=1))


def centroid_size(points: FloatArray) -> float:
    """Root of the summed squared distances from the middle, metres."""
    return float(np.linalg.norm(points - points.mean(axis=0)))


def in_line(points: FloatArray) -> bool:
    """Whether points `(N, 3)` lie so nearly on one line that they leave a turn about it open."""
    sizes = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return bool(sizes[1] <= 0.1 * sizes[0])


def inliers(a: FloatArray, b: FloatArray) -> NDArray[np.bool_]:
    """`(N,)`: which of N points agree on one motion and one scale; all of them where N is below five.

    Least trimmed squares (Rousseeuw & Van Driessen, "Computing LTS Regression for Large Data Sets", 2006) from triples
    of points finds a good half; then points come back, the nearest first, until an F test says that one is no part of
    the rest. The scale is free, or a wrongly printed board would make the points furthest out look wrong.
    """
    from scipy.special import fdtrc  # noqa: PLC0415 -- who only reads a calibration does not wait for it

    count = len(a)
    if count < 5:
        return np.ones(count, np.bool_)
    kept = _trimmed(a, b, count - (count - 3) // 2)
    while not kept.all():
        off = _off(a, b, np.flatnonzero(kept))
        nearest = int(np.argmin(np.where(kept, np.inf, off)))
        wider = kept | (np.arange(count) == nearest)
        within = float((off[kept] ** 2).sum())
        together = float((_off(a, b, np.flatnonzero(wider))[wider] ** 2).sum())
        spare = 3 * int(kept.sum()) - 7
        ratio = ((together - within) / 3) / max(within / spare, _ROUNDING_M**2)
        if off[nearest] > _FLOOR_M and count * fdtrc(3, spare, ratio) < _FALSE_ALARMS:
            break
        kept = wider
    return kept


def from_axes(touched: FloatArray) -> FloatArray:
    """`T_base_world` from origin, point on x, point near y `(3, 3)`, by Gram and Schmidt."""
    x = touched[1] - touched[0]
    x /= np.linalg.norm(x)
    y = touched[2] - touched[0]
    y -= (y @ x) * x
    y /= np.linalg.norm(y)
    return rigid(np.column_stack([x, y, np.cross(x, y)]), touched[0])


def axes_covariance(touched: FloatArray, touch_std_m: float) -> FloatArray:
    """`(6, 6)` of `T_base_world`, by finite differences of its nine coordinates."""
    here, step = UncertainTransform(from_axes(touched), np.zeros((6, 6))), 1e-6
    jacobian = [here.error_of(from_axes(touched + move.reshape(3, 3))) / step for move in step * np.eye(9)]
    return np.asarray(touch_std_m**2 * np.transpose(jacobian) @ jacobian, float)


def rigid_covariance(T_a_b: FloatArray, b: FloatArray, std_m: float) -> FloatArray:
    """`(6, 6)` of `fit_rigid` to points `(N, 3)` of frame b, each coordinate off by `std_m`."""
    normal = np.zeros((6, 6))
    for x, y, z in b @ T_a_b[:3, :3].T:
        by_error = np.array([[0, z, -y, 1, 0, 0], [-z, 0, x, 0, 1, 0], [y, -x, 0, 0, 0, 1.0]])
        normal += by_error.T @ by_error
    return np.asarray(std_m**2 * np.linalg.inv(normal))


def _trimmed(a: FloatArray, b: FloatArray, most: int) -> NDArray[np.bool_]:
    """`(N,)`: the `most` points with the least sum of squared distances that some motion and scale leave."""
    chosen = _triples(len(a))
    for _ in range(3):
        off = _off(a, b, chosen)
        chosen = np.argsort(off, axis=1)[:, :most]
    totals = np.take_along_axis(_off(a, b, chosen), chosen, axis=1)
    best = chosen[np.argmin((totals**2).sum(axis=1))]
    return np.isin(np.arange(len(a)), best)


def _off(a: FloatArray, b: FloatArray, chosen: NDArray[np.int64]) -> FloatArray:
    """Distances of all points `(N, 3)` under the motion and scale that fit the chosen: `(..., M)` -> `(..., N)`."""
    some_a, some_b = a[chosen], b[chosen]  # (..., M, 3)
    center_a, center_b = some_a.mean(axis=-2, keepdims=True), some_b.mean(axis=-2, keepdims=True)
    some_a, some_b = some_a - center_a, some_b - center_b
    scale = np.linalg.norm(some_a, axis=(-2, -1)) / np.linalg.norm(some_b, axis=(-2, -1))
    turn = scale[..., None, None] * _rotation(some_a, some_b)
    moved = (b - center_b) @ np.swapaxes(turn, -2, -1) + center_a
    return np.asarray(np.linalg.norm(moved - a, axis=-1))


def _rotation(a: FloatArray, b: FloatArray) -> FloatArray:
    """`(..., 3, 3)`: the rotation that takes points `(..., N, 3)` about the origin b nearest to a."""
    u, _, vt = np.linalg.svd(np.swapaxes(a, -2, -1) @ b)
    u[..., 2] *= np.linalg.det(u @ vt)[..., None]  # a rotation, whatever the points
    return np.asarray(u @ vt)


def _triples(count: int) -> NDArray[np.int64]:
    """`(T, 3)` indices: all there are, or many of them."""
    if comb(count, 3) <= _MAX_TRIPLES:
        return np.array(list(combinations(range(count), 3)))
    rng = np.random.default_rng(0)
    return np.array([rng.choice(count, 3, replace=False) for _ in range(_MAX_TRIPLES)])


def T_world_target(target: Target) -> FloatArray:
    """`(4, 4)`: the target's own frame (y down the print, z into the paper) in the world's."""
    rotation = np.diag([1.0, -1.0, -1.0])
    low_left = np.array([target.points[:, 0].min(), target.points[:, 1].max(), 0.0])
    return rigid(rotation, -rotation @ low_left)


def points_to_touch(target: Target, axes_only: bool) -> list[tuple[str, FloatArray]]:
    """Points of a target worth touching, with words for where each is: `(3,)` metres, world frame.

    The origin, the far ends of the x axis and of the y axis; unless `axes_only`, the opposite corner and, of a board,
    the middle of each side as well: then a wrong touch shows, and the others make up for one another. Of a board that
    sags, these are not in the plane of the corners.
    """
    points = transform_points(T_world_target(target), target.points)
    width, height = points[:, 0].max(), points[:, 1].max()
    corner = "corner of the black square" if len(points) == 4 else "inner corner"
    wanted = [
        (f"the world's origin: the lower left {corner}", (0.0, 0.0, 0.0)),
        (f"a point on the x axis: the lower right {corner}", (width, 0.0, 0.0)),
        (f"a point on the y axis: the upper left {corner}", (0.0, height, 0.0)),
    ]
    if not axes_only:
        wanted.append((f"the upper right {corner}", (width, height, 0.0)))
    if not axes_only and len(points) > 4:
        middles = {
            "lower": (width / 2, 0.0),
            "right": (width, height / 2),
            "upper": (width / 2, height),
            "left": (0.0, height / 2),
        }
        for side, middle in middles.items():
            x, y, z = points[np.argmin(np.linalg.norm(points[:, :2] - middle, axis=1))]
            wanted.append(
                (f"the {corner} on the {side} side at {1000 * x:.0f}, {1000 * y:.0f} mm", (x, y, z))
            )
    return [(words, np.array(point)) for words, point in wanted]
