"""Which views of a hand-eye recording agree with each other, what is wrong where too few do, and the lens's share.

The lens's own uncertainty is the same error in every view, which no view shows, and so is added to the fit's.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from baggie.calibration.hand_eye.refine import (
    MIN_VIEWS,
    Pair,
    closed_form,
    mean_board,
    refine,
    reproject,
    view_errors,
)
from baggie.calibration.hand_eye.views import HandEyeViews, Mount
from baggie.calibration.pose import UncertainTransform, both_planar_poses
from baggie.errors import CalibrationError
from baggie.geometry import FloatArray, invert_transform
from baggie.types import Intrinsics

_MOST = 0.65
"""This part of the views must agree."""
_SUBSET = 4
_SUBSETS = 100
"""With a third of the views wrong, one subset of four in five or six is good: none of them with odds of 1e-8."""
_ARM_M = 0.1
"""A radian of rotation counts as this many metres when views are compared: about half a board."""
_STDS = 5.0
_FLOOR_M, _FLOOR_RAD = 0.002, np.radians(0.5)
"""Closer than this a view does no harm, however exact the others are."""
_BAD_M = 0.010
"""Views that usually differ by more are not merely noisy."""
_BETTER = 5.0
_HOPELESS_M = 0.030
_POOR_RAD, _WEAK_RAD = np.radians(3.0), np.radians(8.0)
_ADVICE = (
    "check that nothing slips between hand, camera and board, that poses and pictures belong together, that lengths "
    "are in one unit, and record again"
)


@dataclass(frozen=True)
class Agreement:
    """The views that agree, and a first fit to them."""

    views: HandEyeViews
    """The kept ones; `dropped` names the others."""
    pair: Pair
    warnings: tuple[str, ...]


def agree(views: HandEyeViews, keep_all: bool = False) -> Agreement:
    """Find what most views agree on (random sample consensus) and drop those that do not.

    A view is dropped when its board is more than five robust standard deviations (and 2 mm, or 0.5 degrees) from
    where the others have it; with `keep_all` none is. Raises `CalibrationError` for too few views, for motion about
    fewer than two axes, and when over a third would go or another reading of the poses fits far better.
    """
    _check_count(views)
    _check_motion(views)
    consensus, spread = _consensus(views)
    if spread > _BAD_M:
        _check_reading(views, spread)
    if spread > _HOPELESS_M and not keep_all:
        raise CalibrationError(
            f"two thirds of the {len(views)} views agree to {spread * 1000:.0f} mm only; {_ADVICE}"
        )
    views, kept, errors, pair = _settle(views, consensus)
    if keep_all:
        kept = np.ones(len(views), bool)
    elif kept.mean() < _MOST:
        worst = ", ".join(views.names[i] for i in np.flatnonzero(~kept)[:6])
        raise CalibrationError(
            f"only {kept.sum()} of {len(views)} views agree with each other (not {worst}); {_ADVICE}"
        )
    dropped = [(views.names[i], _why(errors[i])) for i in np.flatnonzero(~kept)]
    chosen = replace(views.select(kept), dropped=(*views.dropped, *dropped))
    _check_count(chosen)
    return Agreement(chosen, pair, (*_check_motion(chosen), *_check_front(chosen)))


def _settle(views: HandEyeViews, pair: Pair) -> tuple[HandEyeViews, NDArray[np.bool_], FloatArray, Pair]:
    """Fit and choose in turns: the views (boards seen the wrong way round put right), which agree, errors, fit."""
    distance = _distance(view_errors(pair, views.T_stand_mount, views.T_camera_board))
    kept = distance <= np.sort(distance)[_quorum(len(views)) - 1]
    for _ in range(10):
        pair = refine(pair, views.T_stand_mount[kept], views.T_camera_board[kept]).pair
        errors = view_errors(pair, views.T_stand_mount, views.T_camera_board)
        within = _within(errors, int(kept.sum()))
        views, turned = _unflipped(views, ~within, pair)
        if turned:
            continue
        if np.array_equal(within, kept) or within.sum() < MIN_VIEWS:
            break
        kept = within
    return views, within, errors, pair


def _consensus(views: HandEyeViews) -> tuple[Pair, float]:
    """The fit to a few views that most agree with, and within how many metres they do."""
    stand_mount, camera_board = views.T_stand_mount, views.T_camera_board
    rng = np.random.default_rng(0)
    quorum = _quorum(len(views))
    best, best_spread = None, np.inf
    for _ in range(_SUBSETS):
        some = rng.choice(len(views), min(_SUBSET, len(views)), replace=False)
        try:
            x = closed_form("park", stand_mount[some], camera_board[some])
        except CalibrationError:
            continue
        pair = x, mean_board(x, stand_mount[some], camera_board[some])
        distance = _distance(view_errors(pair, stand_mount, camera_board))
        spread = float(np.partition(distance, quorum - 1)[quorum - 1])
        if spread < best_spread:
            best, best_spread = pair, spread
    if best is None:
        raise CalibrationError(
            "no few views give a hand-eye transform; turn the hand about several axes and record again"
        )
    return best, best_spread


def _within(errors: FloatArray, fitted: int) -> NDArray[np.bool_]:
    # Rousseeuw & Leroy, "Robust Regression and Outlier Detection", 1987: the median is on the small side where much was
    # fitted to few. A view has as many numbers as a transform, so two transforms use up two views, and one is spare.
    few = 1 + 5 / max(fitted - 3, 1)
    within = np.ones(len(errors), bool)
    for part, floor in ((errors[:, :3], _FLOOR_RAD), (errors[:, 3:], _FLOOR_M)):
        size = np.linalg.norm(part, axis=1)
        std = few * float(np.median(size)) / np.sqrt(chi2.median(3))
        within &= size <= max(_STDS * std, floor)
    return within


def _unflipped(views: HandEyeViews, suspects: NDArray[np.bool_], pair: Pair) -> tuple[HandEyeViews, bool]:
    """Views whose board was taken for its mirror image (a small or distant one may be), put right."""
    if views.seen is None or views.intrinsics is None:
        return views, False
    boards, turned = views.T_camera_board.copy(), False
    for i in np.flatnonzero(suspects):
        expected = invert_transform(views.T_stand_mount[i] @ pair[0]) @ pair[1]
        candidates = [
            pose
            for pose, _ in both_planar_poses(views.seen[i].points, views.seen[i].pixels, views.intrinsics)
        ]
        nearest = min(candidates, key=lambda pose: _apart(pose, expected))
        if _apart(nearest, expected) < 0.5 * _apart(boards[i], expected):
            boards[i], turned = nearest, True
    return replace(views, T_camera_board=boards), turned


def _check_reading(views: HandEyeViews, spread: float) -> None:
    """Raise where a usual mix-up explains what the poses as given do not.

    An inverted `T_base_hand`, an inverted `T_camera_board` and the wrong mount are one and the same to the fit; which
    it is shows in whether the board is in front of the camera.
    """
    other: Mount = "fixed" if views.mount == "hand" else "hand"
    _, other_spread = _consensus(replace(views, mount=other))
    times = spread / max(other_spread, 1e-9)
    if times < _BETTER:
        return
    if _behind(views).mean() > 0.5:
        words = (
            "T_camera_board inverted (as given, the board is behind the camera); give the board in the camera's "
            "frame"
        )
    else:
        words = f"T_base_hand inverted; give the hand in the base's frame, or mount {other!r} if that is what it is"
    raise CalibrationError(
        f"the views differ by {spread * 1000:.0f} mm as given and fit {min(times, 999):.0f} times better with {words}"
    )


def _check_front(views: HandEyeViews) -> tuple[str, ...]:
    """With both kinds of pose inverted every view fits as well, the two unknown transforms in each other's place."""
    behind = int(_behind(views).sum())
    if 2 * behind < len(views):
        return ()
    return (
        f"the board is behind the camera in {behind} of {len(views)} views; check that T_camera_board and "
        "T_base_hand are not both inverted, and that z of the camera points forward",
    )


def _behind(views: HandEyeViews) -> NDArray[np.bool_]:
    return np.asarray(views.T_camera_board[:, 2, 3] < 0)


def _check_count(views: HandEyeViews) -> None:
    if len(views) < MIN_VIEWS:
        lost = "; ".join(f"{name}: {why}" for name, why in views.dropped[:3])
        raise CalibrationError(
            f"expected at least {MIN_VIEWS} views of the board, got {len(views)}; record 10 to 15 from all sides"
            + (f" ({lost})" if lost else "")
        )


def _check_motion(views: HandEyeViews) -> tuple[str, ...]:
    """Raise where the hand turns about one axis only: the camera's place along it then has no effect on any view."""
    turns = Rotation.from_matrix(views.T_base_hand[:, :3, :3])
    first, second = np.triu_indices(len(views), 1)
    between = (turns[first].inv() * turns[second]).as_rotvec()
    usual = np.linalg.svd(between, compute_uv=False) / np.sqrt(len(between))
    advice = "turn the hand about other axes, too, by 20 degrees or more, and record again"
    if usual[1] < _POOR_RAD:
        raise CalibrationError(
            f"the hand turns about fewer than two axes (by {np.degrees(usual[0]):.1f} degrees about one, "
            f"{np.degrees(usual[1]):.1f} about any other), which leaves the camera's place open; {advice}"
        )
    if usual[1] < _WEAK_RAD:
        return (f"the hand turns little about a second axis ({np.degrees(usual[1]):.1f} degrees); {advice}",)
    return ()


def _quorum(count: int) -> int:
    return max(int(np.ceil(_MOST * count)), MIN_VIEWS)


def _distance(errors: FloatArray) -> FloatArray:
    turn, shift = np.linalg.norm(errors[:, :3], axis=1), np.linalg.norm(errors[:, 3:], axis=1)
    return np.asarray(np.hypot(_ARM_M * turn, shift), float)


def _apart(a: FloatArray, b: FloatArray) -> float:
    return float(Rotation.from_matrix(a[:3, :3].T @ b[:3, :3]).magnitude())


def _why(error: FloatArray) -> str:
    turn, shift = np.degrees(np.linalg.norm(error[:3])), np.linalg.norm(error[3:]) * 1000
    return f"{shift:.1f} mm and {turn:.1f} degrees from where the other views have the board; take it again"


def lens_share(views: HandEyeViews, pair: Pair) -> FloatArray:
    """`(6, 6)`: the part of the covariance of `T_mount_camera` that is the lens's; zero where that is not known.

    Each parameter is moved by its standard deviation and the transforms are fitted again.
    """
    lens, covariance = views.intrinsics, views.intrinsics_covariance
    if lens is None or covariance is None or views.seen is None:
        return np.zeros((6, 6))
    start = reproject(pair, views.T_stand_mount, views.seen, lens).pair
    still = UncertainTransform(start[0], np.zeros((6, 6)))
    stds = np.sqrt(np.diag(covariance))
    moves = np.zeros((6, len(stds)))
    for k in np.flatnonzero(stds):
        fitted = reproject(start, views.T_stand_mount, views.seen, _moved(lens, int(k), stds[k])).pair
        moves[:, k] = still.error_of(fitted[0]) / stds[k]
    return np.asarray(moves @ covariance @ moves.T)


def _moved(lens: Intrinsics, parameter: int, by: float) -> Intrinsics:
    """Move one parameter of a lens: fx, fy, cx, cy, then the distortion."""
    matrix, distortion = lens.matrix.copy(), lens.distortion.copy()
    distortion.resize(max(5, distortion.size))  # zeros, where `np.resize` would begin again
    if parameter < 4:
        matrix[[(0, 0), (1, 1), (0, 2), (1, 2)][parameter]] += by
    else:
        distortion[parameter - 4] += by
    return replace(lens, matrix=matrix, distortion=distortion)
