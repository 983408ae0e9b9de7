"""Many pictures of a target by a camera that stands still, averaged corner by corner."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from baggie.errors import CalibrationError
from baggie.geometry import FloatArray
from baggie.vision.targets import Seen

_MOVED_PX = 1.0


@dataclass(frozen=True)
class StillFrames:
    """Where the corners are in most frames."""

    points: FloatArray
    """`(N, 3)` metres, target frame: those seen in at least half of the frames used."""
    pixels: FloatArray
    """`(N, 2)`, the medians over these frames."""
    moved_px: FloatArray
    """`(F,)`: the median distance of each frame's corners from there."""
    used: NDArray[np.bool_]
    """`(F,)`: frames in which camera and target stood where they stand in most; the others are in no median."""


@dataclass(frozen=True)
class _Corner:
    point: FloatArray
    pixel: FloatArray
    seen: int
    """In how many frames."""


def average(frames: Sequence[Seen], needed: int) -> StillFrames:
    """Average frames, leaving out those in which the corners moved by more than a pixel.

    Raises `CalibrationError` when half of them or more moved, or fewer than `needed` corners, or only corners on one
    line, are seen in most.
    """
    used = np.ones(len(frames), np.bool_)
    for _ in range(3):  # frames that moved have a part in the first medians only
        middle = _medians([frame for frame, kept in zip(frames, used, strict=True) if kept])
        moved = np.array([_moved(frame, middle) for frame in frames])
        used = moved <= _MOVED_PX
        if 2 * used.sum() <= len(frames):
            raise CalibrationError(
                f"expected the camera and the target to stand still, but the corners moved in {(~used).sum()} of "
                f"{len(frames)} frames, by up to {moved.max():.1f} px; fix both in place and take the pictures again"
            )
    least = used.sum() / 2
    kept = [corner for corner in middle.values() if corner.seen >= least]
    points = np.array([corner.point for corner in kept]).reshape(-1, 3)
    if len(kept) < needed:
        raise CalibrationError(
            f"expected at least {needed} corners that most frames show, got {len(kept)}; show more of it, nearer"
        )
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if spread[1] < 0.05 * spread[0]:
        raise CalibrationError(
            f"expected corners spread over the target, got {len(kept)} on one line; show more of its other side"
        )
    return StillFrames(points, np.array([corner.pixel for corner in kept]), moved, used)


def _medians(frames: Sequence[Seen]) -> dict[int, _Corner]:
    ids = np.concatenate([frame.ids for frame in frames])
    points = np.concatenate([frame.points for frame in frames])
    pixels = np.concatenate([frame.pixels for frame in frames])
    corners = {}
    for number in np.unique(ids):
        here = ids == number
        corners[int(number)] = _Corner(points[here][0], np.median(pixels[here], axis=0), int(here.sum()))
    return corners


def _moved(frame: Seen, middle: dict[int, _Corner]) -> float:
    """Pixels; infinite where a frame shows none of the others' corners."""
    shared = [
        np.linalg.norm(pixel - middle[int(number)].pixel)
        for number, pixel in zip(frame.ids, frame.pixels, strict=True)
        if int(number) in middle
    ]
    return float(np.median(shared)) if shared else float("inf")
