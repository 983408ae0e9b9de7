"""Where the camera is on the robot: hand-eye calibration, from poses of the hand and views of a printed board.

Seven closed forms and our refinements all solve the same views; each view is left out in turn and predicted from the
others, and a method is taken that does this at least as well as the best closed form.

Every way to solve a hand-eye recording, judged by the same views: each view in turn left out and then predicted.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from baggie.calibration.hand_eye.agree import Agreement, agree, lens_share
from baggie.calibration.hand_eye.refine import (
    CLOSED_FORMS,
    MIN_VIEWS,
    Noise,
    Pair,
    closed_form,
    mean_board,
    refine,
    reproject,
)
from baggie.calibration.hand_eye.result import HandEye, MethodErrors
from baggie.calibration.hand_eye.views import HandEyeViews
from baggie.calibration.pose import UncertainTransform
from baggie.errors import CalibrationError
from baggie.geometry import FloatArray

_STARTS = 3

REPROJECTION = "reprojection"


@dataclass(frozen=True)
class Fit:
    """What a method makes of some views."""

    pair: Pair
    covariance: FloatArray | None = None
    """`(6, 6)` of `T_mount_camera`, where the method tells."""


Solve = Callable[[NDArray[np.int64], Pair], Fit]
"""From the views at these indices, starting near the pair."""


@dataclass(frozen=True)
class Candidate:
    """One method's result and what it is worth."""

    fit: Fit
    apart_mm: FloatArray
    """`(N,)`: where each view has the board, from where all have it on average."""
    left_out_mm: FloatArray
    """`(N,)`: where each view has the board, from the mean of the others, all under the fit to the others; infinite
    where the others have no solution. `apart_mm` where there are too few views to leave one out."""
    left_out: tuple[FloatArray, ...]
    """`T_mount_camera` without each view; empty where there are too few."""


def compare(agreed: Agreement) -> dict[str, Candidate]:
    """All of OpenCV's closed forms and our refinements, by name."""
    views = agreed.views
    everything = np.arange(len(views))
    candidates = {}
    starts = [agreed.pair]
    for method, solve in _closed_forms(views).items():
        try:
            fit = solve(everything, starts[0])
        except CalibrationError:
            continue
        candidates[method] = _judge(views, solve, fit)
    ranked = sorted(candidates.values(), key=lambda candidate: candidate.apart_mm.mean())
    starts += [best.fit.pair for best in ranked[: _STARTS - 1]]
    for method, solve in _refinements(views).items():
        fits = [solve(everything, start) for start in starts]
        fit = min(fits, key=lambda found: float(_apart_mm(views, found.pair[0]).mean()))
        candidates[method] = _judge(views, solve, fit)
    return candidates


def uncertainty(fit: Fit, shape: FloatArray, left_out: tuple[FloatArray, ...]) -> UncertainTransform:
    """The fit's `T_mount_camera` with its covariance.

    `shape` `(6, 6)` is what the fit's own Jacobian says. Its size is set by how much the fits without one view each
    differ (jackknife: Efron, "The Jackknife, the Bootstrap and Other Resampling Plans", 1982): that counts views, so it
    holds where the errors within a view go together, which corners of one picture do when the arm is off.
    """
    if not left_out:
        return UncertainTransform(fit.pair[0], shape)
    count = len(left_out)
    moves = np.array([UncertainTransform(fit.pair[0], shape).error_of(other) for other in left_out])
    moves -= moves.mean(axis=0)
    spread = (count - 1) / count * moves.T @ moves
    size = float(np.trace(np.linalg.pinv(shape, hermitian=True) @ spread)) / 6
    return UncertainTransform(fit.pair[0], size * shape)


def _closed_forms(views: HandEyeViews) -> dict[str, Solve]:
    stand_mount, camera_board = views.T_stand_mount, views.T_camera_board

    def solve(method: str, which: NDArray[np.int64], start: Pair) -> Fit:
        found = closed_form(method, stand_mount[which], camera_board[which])
        return Fit((found, mean_board(found, stand_mount[which], camera_board[which])))

    return {method: partial(solve, method) for method in CLOSED_FORMS}


def _refinements(views: HandEyeViews) -> dict[str, Solve]:
    stand_mount, camera_board = views.T_stand_mount, views.T_camera_board
    seen, intrinsics = views.seen, views.intrinsics

    def poses(noise: Noise, which: NDArray[np.int64], start: Pair) -> Fit:
        found = refine(start, stand_mount[which], camera_board[which], noise=noise)
        return Fit(found.pair, found.covariance[:6, :6])

    solves: dict[str, Solve] = {
        "poses": partial(poses, "alike"),
        "poses, depth apart": partial(poses, "depth apart"),
    }
    if seen is not None and intrinsics is not None:

        def corners(which: NDArray[np.int64], start: Pair) -> Fit:
            found = reproject(start, stand_mount[which], [seen[i] for i in which], intrinsics)
            return Fit(found.pair, found.covariance[:6, :6])

        solves[REPROJECTION] = corners
    return solves


def _judge(views: HandEyeViews, solve: Solve, fit: Fit) -> Candidate:
    apart = _apart_mm(views, fit.pair[0])
    if len(views) <= MIN_VIEWS:
        return Candidate(fit, apart, apart, ())
    errors, fits = np.full(len(views), np.inf), []
    for i in range(len(views)):
        others = np.delete(np.arange(len(views)), i)
        try:
            without = solve(others, fit.pair).pair[0]
        except CalibrationError:
            continue
        positions = _positions(views, without)
        errors[i] = 1000 * np.linalg.norm(positions[i] - positions[others].mean(axis=0))
        fits.append(without)
    return Candidate(fit, apart, errors, tuple(fits))


def _apart_mm(views: HandEyeViews, mount_camera: FloatArray) -> FloatArray:
    positions = _positions(views, mount_camera)
    return np.asarray(1000 * np.linalg.norm(positions - positions.mean(axis=0), axis=1), float)


def _positions(views: HandEyeViews, mount_camera: FloatArray) -> FloatArray:
    return np.asarray((views.T_stand_mount @ mount_camera @ views.T_camera_board)[:, :3, 3], float)


def best_of(candidates: Mapping[str, Candidate]) -> str:
    """The method to trust: no closed form has a smaller mean error of views left out.

    Reprojection where that is so, for it weighs every corner as it should be: a view left out is placed by its own
    corners alone, which err by more than good methods differ, so the least error is often a matter of luck. Else the
    method with the least.
    """
    errors = {method: float(candidate.left_out_mm.mean()) for method, candidate in candidates.items()}
    closed = min((errors[method] for method in CLOSED_FORMS if method in errors), default=np.inf)
    if errors.get(REPROJECTION, np.inf) <= closed:
        return REPROJECTION
    return min(errors, key=lambda method: errors[method])


_SCALE_OFF = 0.01
_SCALE_STDS = 5.0


def solve_hand_eye(views: HandEyeViews, keep_all: bool = False) -> HandEye:
    """`T_hand_camera` (camera on the hand) or `T_base_camera` (fixed camera) from at least three views.

    Views that disagree with the rest are dropped unless `keep_all`. Raises `CalibrationError`, in one line, for too
    few views, motion about fewer than two axes, views most of which disagree, and poses that fit far better when read
    another way round.
    """
    agreed = agree(views, keep_all)
    views = agreed.views
    candidates = compare(agreed)
    method = best_of(candidates)
    best = candidates[method]
    by_poses = candidates["poses"].fit
    shape = best.fit.covariance if best.fit.covariance is not None else by_poses.covariance
    assert shape is not None
    found = uncertainty(best.fit, shape, best.left_out)
    return HandEye(
        views.mount,
        replace(found, covariance=found.covariance + lens_share(views, best.fit.pair)),
        best.fit.pair[1],
        method,
        {name: _errors(candidate) for name, candidate in candidates.items()},
        tuple(zip(views.names, best.left_out_mm.tolist(), strict=True)),
        views.dropped,
        (*agreed.warnings, *_few(views), *_wrong_scale(views, by_poses.pair)),
        views.camera,
    )


def _errors(candidate: Candidate) -> MethodErrors:
    left_out = candidate.left_out_mm
    return MethodErrors(
        float(left_out.mean()),
        float(np.median(left_out)),
        float(left_out.max()),
        float(candidate.apart_mm.mean()),
    )


def _few(views: HandEyeViews) -> tuple[str, ...]:
    if len(views) > MIN_VIEWS:
        return ()
    return (
        f"only {len(views)} views: none can be left out, so the error given is how far they are apart, which is "
        "too good; record 10 to 15",
    )


def _wrong_scale(views: HandEyeViews, pair: Pair) -> tuple[str, ...]:
    """Whether a board of another size than stated explains the views better."""
    fit = refine(pair, views.T_stand_mount, views.T_camera_board, with_scale=True)
    off = fit.scale - 1
    if abs(off) < _SCALE_OFF or abs(off) < _SCALE_STDS * np.sqrt(fit.covariance[12, 12]):
        return ()
    return (
        f"the board seems to be printed at {fit.scale * 100:.0f}% of its stated size; measure a square (or the focal "
        "length is off by as much)",
    )
