"""Which pixel of a height map a small hole takes after.

A hole is small where a closing of what was seen covers it; large unseen areas keep their outline. Most holes lie
between the points of one surface that are further apart than pixels, and the nearest seen pixel is right. Others are
shadows: floor beside a box, which the box hides from every camera. The nearest pixel may then be the box's, and taking
it would make the box wider. But a box there would hide what is behind it: where a camera sees past the point that a
hole would get, the point is not there (space carving: Kutulakos & Seitz, "A Theory of Shape by Space Carving", 2000),
and the lowest pixel near by is taken instead, for what is hidden lies behind what hides it.
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from baggie.geometry import FloatArray, invert_transform, transform_points
from baggie.types import Observation

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
