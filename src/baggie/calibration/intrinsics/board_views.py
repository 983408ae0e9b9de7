"""Views of a board: finding them, how they spread over the picture and over tilts, and what to show next."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from baggie.calibration.files import CameraIdentity
from baggie.calibration.intrinsics.opencv_lens import board_pose, guessed_lens, rough_lens
from baggie.errors import CalibrationError
from baggie.geometry import FloatArray
from baggie.types import Image, Intrinsics
from baggie.vision.targets import Seen, Target

ENOUGH_VIEWS = 20
_MIN_VIEWS = 10
_REGIONS = (
    "top left",
    "top",
    "top right",
    "left",
    "middle",
    "right",
    "bottom left",
    "bottom",
    "bottom right",
)
_SIDES = ("left", "right", "top", "bottom")
_TILT = math.radians(20)
"""From here on a tilt tells the focal length apart from the distance."""
_SPAN = 1.5
"""The farthest view should be so many times as far as the nearest."""


@dataclass(frozen=True)
class BoardView:
    """A board found in a picture."""

    name: str
    seen: Seen


@dataclass(frozen=True)
class Spread:
    """What a set of views shows of a camera."""

    empty: tuple[str, ...]
    """The ninths of the picture in which no corner was seen, "top left" to "bottom right"."""
    tilts: dict[str, float]
    """Radians by side of the board as seen in the picture: how far it was tilted away at most."""
    distances: FloatArray
    """`(N,)` metres."""
    largest: float
    """Of all views the largest fraction of the picture's area between the board's outermost corners."""


def find_views(
    pictures: Iterable[tuple[str, Image]], target: Target
) -> tuple[list[BoardView], list[tuple[str, str]]]:
    """The board in each named picture `(H, W, 3)`; and the names of those without, each with the reason why."""
    views, skipped = [], []
    for name, image in pictures:
        seen = target.detect(image)
        if seen is None:
            skipped.append((name, target.why_not(image)))
        else:
            views.append(BoardView(name, seen))
    return views, skipped


def spread(seen: Sequence[Seen], poses: Sequence[FloatArray], size: tuple[int, int]) -> Spread:
    """How boards with `T_camera_target` `poses` spread over pictures of `size` (width, height)."""
    corners = np.concatenate([view.pixels for view in seen])
    cells = np.clip((corners + 0.5) / size * 3, 0, 2.999).astype(int)
    empty = set(range(9)) - set((cells[:, 1] * 3 + cells[:, 0]).tolist())
    # The board's z axis points away from the camera.
    normals = np.array([pose[:3, 2] for pose in poses])
    leaning = np.stack([-normals[:, 0], normals[:, 0], -normals[:, 1], normals[:, 1]])
    # On the plane n . x = const: its right side is farther where the normal leans left.
    right, left, bottom, top = np.arcsin(np.clip(leaning, 0, 1)).max(axis=1).tolist()
    tilts = dict(zip(_SIDES, (left, right, top, bottom), strict=True))
    areas = [cv2.contourArea(cv2.convexHull(view.pixels.astype(np.float32))) for view in seen]
    distances = np.array([float(np.linalg.norm(pose[:3, 3])) for pose in poses])
    return Spread(
        tuple(_REGIONS[i] for i in sorted(empty)), tilts, distances, max(areas) / (size[0] * size[1])
    )


def warnings_about(seen: Sequence[Seen], poses: Sequence[FloatArray], size: tuple[int, int]) -> list[str]:
    """One line for each thing these views lack."""
    found = []
    shown = spread(seen, poses, size)
    if len(seen) < _MIN_VIEWS:
        found.append(f"only {len(seen)} views; take {_MIN_VIEWS} or more, {ENOUGH_VIEWS} are good")
    if shown.empty:
        where = " and ".join(", ".join(shown.empty).rsplit(", ", 1))
        found.append(f"no board in the {where} of the picture; the lens is extrapolated there")
    across, along = (max(shown.tilts[a], shown.tilts[b]) for a, b in (("left", "right"), ("top", "bottom")))
    if max(across, along) < _TILT:
        most = math.degrees(max(across, along))
        found.append(
            f"all boards within {most:.0f} degrees of face-on; tilt it by 30 to 45 degrees in both directions"
        )
    elif min(across, along) < _TILT:
        way, least = ("left or right", across) if across < along else ("top or bottom", along)
        found.append(
            f"no board's {way} side is tilted away by more than {math.degrees(least):.0f} degrees; tilt it by 30 to 45"
        )
    return found


def next_view(views: Sequence[BoardView], camera: CameraIdentity, target: Target) -> str | None:
    """What whoever holds the board should show next, in one line; None when there is enough.

    Enough is a corner in each ninth of the picture, each side tilted away once, near and far, and 20 views in all.
    """
    if not views:
        return "show the board in the middle of the picture, facing the camera"
    seen = [view.seen for view in views]
    shown = spread(seen, _rough_poses(seen, camera.size), camera.size)
    untilted = [side for side in _SIDES if shown.tilts[side] < _TILT]
    if shown.empty:
        return f"show the board in the {shown.empty[0]} of the picture"
    if untilted:
        return f"tilt the board by 30 to 45 degrees, its {untilted[0]} side farther away"
    if shown.distances.max() < _SPAN * shown.distances.min():
        # Corners cover less than the board: a tenth of the picture is a board about half as high and wide.
        nearer = "nearer, so that it fills half of the picture" if shown.largest < 0.1 else "farther away"
        return f"hold the board {nearer}"
    if len(views) < ENOUGH_VIEWS:
        return f"{ENOUGH_VIEWS - len(views)} more: show the board anywhere, each time turned and tilted another way"
    return None


def is_new(views: Sequence[BoardView], seen: Seen) -> bool:
    """Whether a board just seen is placed differently enough from all those kept to add something."""
    return all(_differs(view.seen, seen) for view in views)


def all_alike(seen: Sequence[Seen]) -> bool:
    """Whether all views are of one pose."""
    return not any(_differs(seen[0], other) for other in seen[1:])


def _differs(a: Seen, b: Seen) -> bool:
    """By the similarity that takes one's corners nearest to the other's: moved, turned, resized, or not similar."""
    _, in_a, in_b = np.intersect1d(a.ids, b.ids, return_indices=True)
    if len(in_a) < 4:
        return True
    before, after = _complex(a.pixels[in_a]), _complex(b.pixels[in_b])
    shift = after.mean() - before.mean()
    before, after = before - before.mean(), after - after.mean()
    radius = float(np.sqrt(np.mean(np.abs(before) ** 2)))
    grow = np.vdot(before, after) / np.vdot(before, before)
    rest = float(np.sqrt(np.mean(np.abs(after - grow * before) ** 2))) / max(abs(grow) * radius, 1e-9)
    moved = abs(shift) > 0.5 * radius
    resized = abs(math.log(max(abs(grow), 1e-9))) > math.log(1.25)
    turned = abs(np.angle(grow)) > math.radians(20)
    # Tilting a board that faces the camera by 25 degrees narrows it by a tenth: each half by 0.05.
    return bool(moved or resized or turned or rest > 0.05)


def _complex(pixels: FloatArray) -> NDArray[np.complex128]:
    return np.asarray(pixels[:, 0] + 1j * pixels[:, 1], np.complex128)


def _rough_poses(seen: Sequence[Seen], size: tuple[int, int]) -> list[FloatArray]:
    """Good enough to tell tilts: by a lens fitted to these few views, or guessed where they do not tell it."""
    lens: Intrinsics = guessed_lens(size)
    if len(seen) >= 5:
        try:
            fitted = rough_lens(seen, size)
            # A view or two with wrong corners must not turn the advice into nonsense.
            if 0.5 < fitted.matrix[0, 0] / lens.matrix[0, 0] < 3:
                lens = fitted
        except CalibrationError:
            pass
    return [board_pose(view, lens) for view in seen]
