"""What Ravens' three cameras see at one moment, as one picture from straight above."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from numpy.typing import NDArray

from baggie.data.ravens_cameras import RAVENS_CAMERAS
from baggie.grid import Grid
from baggie.types import Observation
from baggie.vision.height_map import fuse

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
