"""Views of a board: finding them, how they spread, how exactly corners were found, and which agree on one lens."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from baggie.calibration.files import CameraIdentity
from baggie.calibration.intrinsics.lens import (
    DISTORTION,
    board_pose,
    fit_lens,
    guessed_lens,
    rough_lens,
    search_lens,
    subset,
)
from baggie.calibration.pose import residuals_px
from baggie.errors import CalibrationError
from baggie.geometry import FloatArray
from baggie.types import Image, Intrinsics
from baggie.vision.targets import Target, TargetDetection

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
    seen: TargetDetection


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


def spread(seen: Sequence[TargetDetection], poses: Sequence[FloatArray], size: tuple[int, int]) -> Spread:
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


def warnings_about(
    seen: Sequence[TargetDetection], poses: Sequence[FloatArray], size: tuple[int, int]
) -> list[str]:
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


def is_new(views: Sequence[BoardView], seen: TargetDetection) -> bool:
    """Whether a board just seen is placed differently enough from all those kept to add something."""
    return all(_differs(view.seen, seen) for view in views)


def all_alike(seen: Sequence[TargetDetection]) -> bool:
    """Whether all views are of one pose."""
    return not any(_differs(seen[0], other) for other in seen[1:])


def _differs(a: TargetDetection, b: TargetDetection) -> bool:
    """Whether two views differ: the best similarity between their corners moves, turns or resizes, or is none."""
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


def _rough_poses(seen: Sequence[TargetDetection], size: tuple[int, int]) -> list[FloatArray]:
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


_TIMES = 1 + 9 + 9 + 1
"""The variance of a third difference, over that of what it is of."""
_MEDIAN_SQUARE = 0.4549
"""Of a standard normal distribution: the median of chi squared with one degree of freedom."""


def corner_noise_px(seen: Sequence[TargetDetection], residuals: Sequence[FloatArray]) -> float | None:
    """RMS noise of corners, pixels: of their errors `(N, 2)`, what differs from one corner to the next.

    What a wrong lens or a bent board does goes smoothly over a board, and third differences along its rows and columns
    leave next to nothing of it; noise of independent corners gets twenty times its variance. By their median: a few
    corners may be wrong. None where no four corners lie side by side.
    """
    differences = [_third(view, off) for view, off in zip(seen, residuals, strict=True)]
    squares = np.concatenate(differences) ** 2
    if not squares.size:
        return None
    variance = np.median(squares) / (_MEDIAN_SQUARE * _TIMES)
    return float(np.sqrt(2 * variance))


def _third(view: TargetDetection, residuals: FloatArray) -> FloatArray:
    """`(M,)`: the third differences of what stands side by side, along rows and columns, u and v."""
    steps = [np.unique(view.points[:, axis].round(6), return_inverse=True)[1] for axis in (0, 1)]
    grid = np.full((steps[1].max() + 1, steps[0].max() + 1, 2), np.nan)
    grid[steps[1], steps[0]] = residuals
    found = [np.diff(grid, 3, axis=axis).ravel() if grid.shape[axis] > 3 else np.zeros(0) for axis in (0, 1)]
    every = np.concatenate(found)
    return np.asarray(every[np.isfinite(every)], float)


MIN_VIEWS = 4
"""Three determine a lens, a fourth can contradict."""
MIN_CORNERS = 8
"""So that half of a view's corners say where the board is, and the other half can be compared."""
_MISPLACED = 0.4
"""Of a square: further from the plane's homography than that, a corner was taken for another one."""
_STDS = 4.0
_FLOOR_PX = 0.1
"""Corners and views this good are never dropped, however good the others are."""
_WORSE = 3.0
"""A view so many times as far off as the median view does not agree with it."""
_DRAWS, _DRAWN, _MOST = 40, 4, 0.6
"""Lenses tried, views each is fitted to, and the fraction of all views it should be near to."""
_CONCENTRATIONS, _FEW_TERMS = 4, ("k1", "k2", "p1", "p2")
_ROUNDS = 20


def clean(views: Sequence[BoardView]) -> tuple[list[BoardView], list[tuple[str, str]]]:
    """Drop corners grossly off the plane, and views with hardly any others; kept views, and dropped ones with why.

    No lens is needed: it bends a board by much less than a square.
    """
    kept, dropped = [], []
    for view in views:
        count = len(view.seen.ids)
        homography, near = _plane(view.seen) if count >= MIN_CORNERS else (None, np.zeros(count, np.bool_))
        if count < MIN_CORNERS:
            dropped.append((view.name, f"{count} corners, at least {MIN_CORNERS} are needed"))
        elif homography is None or near.sum() < max(MIN_CORNERS, 0.5 * count):
            dropped.append((view.name, f"only {near.sum()} of {count} corners lie as the board's do"))
        elif np.linalg.det(homography) < 0:
            dropped.append((view.name, "its corners run the wrong way round, as in a mirror"))
        else:
            kept.append(BoardView(view.name, subset(view.seen, near)))
    return kept, dropped


def agreeing_views(
    views: Sequence[BoardView], size: tuple[int, int], board: FloatArray
) -> tuple[list[BoardView], list[tuple[str, str]], Intrinsics]:
    """The views, without outlying corners, that agree on one lens; those that do not, with why; and that lens.

    `board` `(M, 3)` are all its corners, flat. From the lens that most views are near to, found by drawing a few at a
    time (Fischler & Bolles, "Random Sample Consensus", 1981), the lens with all terms and the board's sag are fitted
    again and again to what lies within four standard deviations of them. Raises `CalibrationError` where no lens is
    determined.
    """
    seen = [view.seen for view in views]
    lens, bent = _near_most(seen, size), list(seen)
    masks = [np.ones(len(view.ids), np.bool_) for view in seen]
    good = np.ones(len(seen), np.bool_)
    for number in range(_ROUNDS):
        distances = [_distances(view, mask, lens) for view, mask in zip(bent, masks, strict=True)]
        before = [*masks, good]
        masks = _inliers(distances)
        errors = np.array([_rms(d[mask]) for d, mask in zip(distances, masks, strict=True)])
        limit = max(_WORSE * float(np.median(errors)), _FLOOR_PX)
        enough = np.array([mask.sum() >= max(MIN_CORNERS, 0.5 * len(mask)) for mask in masks])
        good = enough & (errors <= limit)
        kept = [subset(view, mask) for view, mask, agrees in zip(seen, masks, good, strict=True) if agrees]
        # The first lens is rough and its board flat: beside that, nothing may stand out.
        if len(kept) < MIN_VIEWS or (number and all(map(np.array_equal, before, [*masks, good]))):
            break
        fit = fit_lens(kept, size, DISTORTION, lens, board)
        lens = fit.intrinsics
        bent = [replace(view, points=fit.sag.bend(view.points, board)) for view in seen]
    names = [view.name for view, agrees in zip(views, good, strict=True) if agrees]
    dropped = [
        (views[i].name, _why(masks[i], float(errors[i]), float(np.median(errors))))
        for i in np.flatnonzero(~good).tolist()
    ]
    return [BoardView(name, view) for name, view in zip(names, kept, strict=True)], dropped, lens


def _plane(seen: TargetDetection) -> tuple[FloatArray | None, NDArray[np.bool_]]:
    """The homography `(3, 3)` from the board to the picture, pixels, and which corners `(N,)` it maps."""
    apart = np.linalg.norm(seen.pixels[:, None] - seen.pixels, axis=2)
    square = float(np.median(np.sort(apart, axis=1)[:, 1]))
    limit = max(_MISPLACED * square, 1.0)
    homography, near = cv2.findHomography(seen.points[:, :2], seen.pixels, cv2.RANSAC, limit)
    if homography is None:
        return None, np.zeros(len(seen.ids), np.bool_)
    return np.asarray(homography, float), near.ravel().astype(np.bool_)


def _near_most(seen: Sequence[TargetDetection], size: tuple[int, int]) -> Intrinsics:
    """Find the rough lens, of those fitted to a few random views each, that most views are nearest to."""
    rng = np.random.default_rng(0)
    drawn = {tuple(sorted(rng.choice(len(seen), _DRAWN, replace=False).tolist())) for _ in range(_DRAWS)}
    most = max(MIN_VIEWS, int(np.ceil(_MOST * len(seen))))
    best, found = np.inf, None
    for draw in sorted(drawn):
        try:
            lens = rough_lens([seen[i] for i in draw], size)
            errors = [float(np.median(_distances(view, slice(None), lens))) for view in seen]
        except CalibrationError:
            continue
        error = float(np.sort(errors)[:most].mean())
        if error < best:
            best, found = error, lens
    if found is None:
        raise CalibrationError(
            f"no {_DRAWN} of these {len(seen)} views determine a lens; tilt the board by 30 to 45 degrees in both "
            "directions and show it all over the picture"
        )
    # Concentration (Rousseeuw & Van Driessen, "Computing LTS Regression for Large Data Sets", 2006): a lens with more
    # terms for the nearest views, and again, so that a view is not judged by a lens that is itself rough.
    for _ in range(_CONCENTRATIONS):
        errors = [float(np.median(_distances(view, slice(None), found))) for view in seen]
        nearest = np.argsort(errors)[:most].tolist()
        found, _ = search_lens([seen[i] for i in nearest], size, _FEW_TERMS, found)
    return found


def _distances(seen: TargetDetection, placed_by: NDArray[np.bool_] | slice, lens: Intrinsics) -> FloatArray:
    """`(N,)` pixels: how far all corners are off, the board's pose fitted to some."""
    pose = board_pose(subset(seen, placed_by), lens)
    return np.asarray(np.linalg.norm(residuals_px(pose, seen.points, seen.pixels, lens), axis=1), float)


def _inliers(distances: Sequence[FloatArray]) -> list[NDArray[np.bool_]]:
    """Corners within four standard deviations, those of their own view or of all views, whichever is more."""
    # The median of a two-dimensional normal distribution's length is 1.18 standard deviations.
    usual = float(np.median(np.concatenate(distances)))
    return [d <= max(_STDS * max(float(np.median(d)), usual) / 1.18, _FLOOR_PX) for d in distances]


def _rms(distances: FloatArray) -> float:
    return float(np.sqrt((distances**2).mean()))


def _why(mask: NDArray[np.bool_], error: float, usual: float) -> str:
    if mask.sum() < max(MIN_CORNERS, 0.5 * len(mask)):
        return f"only {mask.sum()} of {len(mask)} corners agree with the other views"
    return f"corners are {error:.2f} px off (RMS), those of the median view {usual:.2f}"
