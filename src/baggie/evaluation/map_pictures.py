"""Pictures of height maps: the table from straight above, and over it a plan and its heat maps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from baggie.evaluation.pictures import Region, arrow, heat_over, save_jpeg
from baggie.types import Image, Observation, Plan

_WHITE_M = 0.15
"""What is as high as a pyramid of three rows is white."""


def shaded(height: NDArray[np.float32]) -> Image:
    """Heights `(H, W)` metres as shades of grey, the table dark: `(H, W, 3)`."""
    shades = 30 + 225 * np.clip(height / _WHITE_M, 0, 1)
    return np.repeat(shades.astype(np.uint8)[..., None], 3, axis=2)


def backdrop(seen: Observation) -> Image:
    """What heat maps are laid over, `(H, W, 3)`: the heights, where they are known, else the picture."""
    return seen.color if seen.height is None else shaded(seen.height)


def save_map(path: Path, seen: Observation) -> None:
    """The colours of a height map."""
    save_jpeg(path, _whole(seen).cut(seen.color))


def save_step(path: Path, seen: Observation, plan: Plan) -> None:
    """The plan as an arrow from pick to place over the colours, and beside it its heat maps over the heights.

    `seen` is orthographic. A plan without heat maps is shown alone.
    """
    assert seen.grid is not None
    whole = _whole(seen)
    start, end = seen.grid.to_pixels([plan.action.pick.xy, plan.action.place.xy])
    shown = [arrow(whole.cut(seen.color), whole.to_shown(start), whole.to_shown(end))]
    if plan.views:
        shown.append(heat_over(backdrop(seen), whole, plan.views))
    save_jpeg(path, np.hstack(shown))


def _whole(seen: Observation) -> Region:
    return Region(0, 0, *seen.size)
