"""Where the camera is on the robot: hand-eye calibration, from poses of the hand and views of a printed board.

Two closed forms and our refinements all solve the same views; each view is left out in turn and predicted from the
others, and a method is taken that does this at least as well as the better closed form.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from baggie.calibration.files import Calibration, CameraIdentity
from baggie.calibration.hand_eye.consensus import Agreement, agree, lens_share
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
from baggie.calibration.hand_eye.views import HandEyeViews, Mount
from baggie.calibration.pose import UncertainTransform, pose_from_yaml, rigid_from_yaml, uncertainty_to_yaml
from baggie.errors import CalibrationError
from baggie.geometry import FloatArray
from baggie.pictures import write_figure

REPROJECTION = "reprojection"
_SCALE_OFF = 0.01
_SCALE_STDS = 5.0
_FRAMES: Mapping[Mount, tuple[str, str]] = {
    "hand": ("T_hand_camera", "T_base_board"),
    "fixed": ("T_base_camera", "T_hand_board"),
}
"""What is found, as files have it."""


@dataclass(frozen=True)
class MethodErrors:
    """How far one method leaves the views apart, millimetres."""

    leave_one_out_mm: float
    """Mean over views, each against the others under a fit to the others: what a new view would be off by."""
    median_mm: float
    """Of the same errors."""
    max_mm: float
    """Of the same errors."""
    disagreement_mm: float
    """Mean distance of all views from their mean, under the fit to all: smaller, and never to be trusted alone."""


@dataclass(frozen=True)
class HandEye(Calibration):
    """Where the camera is on the hand, or on the base."""

    KIND = "hand-eye"

    mount: Mount
    transform: UncertainTransform
    """`T_hand_camera`, or `T_base_camera` for a fixed camera."""
    board: FloatArray
    """`(4, 4)`: `T_base_board`, or `T_hand_board` for a fixed camera."""
    method: str
    """The one of `methods` with the least error of views left out."""
    methods: Mapping[str, MethodErrors]
    views: tuple[tuple[str, float], ...]
    """Name of each kept view and its error when left out, millimetres."""
    dropped: tuple[tuple[str, str], ...]
    """Name and why; these are the views to take again."""
    warnings: tuple[str, ...]
    camera: CameraIdentity | None = None

    @property
    def leave_one_out_mm(self) -> float:
        """Mean over kept views, of the chosen method."""
        return self.methods[self.method].leave_one_out_mm

    def summary(self) -> dict[str, Any]:
        """What a person or a script wants to know, ready for JSON; lengths of matrices in metres."""
        transform, board = _FRAMES[self.mount]
        return {
            "mount": self.mount,
            transform: self.transform.transform.tolist(),
            "leave_one_out_mm": self.leave_one_out_mm,
            "dropped": [{"view": name, "why": why} for name, why in self.dropped],
            "warnings": list(self.warnings),
            board: self.board.tolist(),
            "method": self.method,
            "methods": {name: asdict(errors) for name, errors in self.methods.items()},
            "uncertainty": self.transform.summary(),
            "views": [{"name": name, "leave_one_out_mm": error} for name, error in self.views],
        }

    def to_yaml(self) -> dict[str, Any]:
        """Give the content of a file in plain YAML types."""
        return {
            "units": "m",
            **self.summary(),
            "uncertainty": uncertainty_to_yaml(self.transform),
            "camera": self.camera.to_yaml() if self.camera else None,
        }

    @classmethod
    def from_yaml(cls, content: Mapping[str, Any]) -> Self:
        """The inverse of `to_yaml`, whatever methods an earlier version compared."""
        transform, board = _FRAMES[content["mount"]]
        return cls(
            content["mount"],
            pose_from_yaml(content, transform),
            rigid_from_yaml(content, board),
            str(content["method"]),
            {name: MethodErrors(**errors) for name, errors in content["methods"].items()},
            tuple((view["name"], float(view["leave_one_out_mm"])) for view in content["views"]),
            tuple((view["view"], view["why"]) for view in content["dropped"]),
            tuple(content["warnings"]),
            CameraIdentity.from_yaml(content["camera"]) if content["camera"] else None,
        )


@dataclass(frozen=True)
class MethodFit:
    """What a method makes of some views."""

    pair: Pair
    covariance: FloatArray | None = None
    """`(6, 6)` of `T_mount_camera`, where the method tells."""


Solve = Callable[[NDArray[np.int64], Pair], MethodFit]
"""From the views at these indices, starting near the pair."""


@dataclass(frozen=True)
class Candidate:
    """One method's result and what it is worth."""

    fit: MethodFit
    apart_mm: FloatArray
    """`(N,)`: where each view has the board, from where all have it on average."""
    left_out_mm: FloatArray
    """`(N,)`: where each view has the board, from the mean of the others, all under the fit to the others; infinite
    where the others have no solution. `apart_mm` where there are too few views to leave one out."""
    left_out: tuple[FloatArray, ...]
    """`T_mount_camera` without each view; empty where there are too few."""


def fit_all_methods(agreed: Agreement) -> dict[str, Candidate]:
    """The closed forms, and the refinements, each from the best of these starts, by name."""
    views = agreed.views
    everything = np.arange(len(views))
    candidates, starts = {}, [agreed.pair]
    for method in CLOSED_FORMS:
        solve: Solve = partial(_closed_form, views, method)
        try:
            fit = solve(everything, agreed.pair)
        except CalibrationError:
            continue
        candidates[method] = _judge(views, solve, fit)
        starts.append(fit.pair)
    for method, solve in _refinements(views).items():
        fits = [solve(everything, start) for start in starts]
        fit = min(fits, key=lambda found: float(_apart_mm(views, found.pair[0]).mean()))
        candidates[method] = _judge(views, solve, fit)
    return candidates


def uncertainty(fit: MethodFit, shape: FloatArray, left_out: tuple[FloatArray, ...]) -> UncertainTransform:
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


def _closed_form(views: HandEyeViews, method: str, which: NDArray[np.int64], start: Pair) -> MethodFit:
    stand_mount, camera_board = views.T_stand_mount[which], views.T_camera_board[which]
    found = closed_form(method, stand_mount, camera_board)
    return MethodFit((found, mean_board(found, stand_mount, camera_board)))


def _refinements(views: HandEyeViews) -> dict[str, Solve]:
    stand_mount, camera_board = views.T_stand_mount, views.T_camera_board
    seen, intrinsics = views.seen, views.intrinsics

    def poses(noise: Noise, which: NDArray[np.int64], start: Pair) -> MethodFit:
        found = refine(start, stand_mount[which], camera_board[which], noise=noise)
        return MethodFit(found.pair, found.covariance[:6, :6])

    solves: dict[str, Solve] = {
        "poses": partial(poses, "alike"),
        "poses, depth apart": partial(poses, "depth apart"),
    }
    if seen is not None and intrinsics is not None:

        def corners(which: NDArray[np.int64], start: Pair) -> MethodFit:
            found = reproject(start, stand_mount[which], [seen[i] for i in which], intrinsics)
            return MethodFit(found.pair, found.covariance[:6, :6])

        solves[REPROJECTION] = corners
    return solves


def _judge(views: HandEyeViews, solve: Solve, fit: MethodFit) -> Candidate:
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


def solve_hand_eye(views: HandEyeViews, keep_all: bool = False) -> HandEye:
    """`T_hand_camera` (camera on the hand) or `T_base_camera` (fixed camera) from at least three views.

    Views that disagree with the rest are dropped unless `keep_all`. Raises `CalibrationError`, in one line, for too
    few views, motion about fewer than two axes, views most of which disagree, and poses that fit far better when read
    another way round.
    """
    agreed = agree(views, keep_all)
    views = agreed.views
    candidates = fit_all_methods(agreed)
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


_FULL = 4.0
"""Bars end at this many times the best method's error; the number beside one says the rest."""


def draw_views(result: HandEye, path: Path) -> None:
    """Save each view's error when left out, with the dropped ones marked, above every method's mean.

    Raises `WriteError`.
    """
    from matplotlib.figure import Figure  # noqa: PLC0415 -- worker processes start without it

    names = [name for name, _ in (*result.views, *result.dropped)]
    errors = [error for _, error in result.views] + [0.0] * len(result.dropped)
    dropped = np.arange(len(names)) >= len(result.views)
    order = sorted(range(len(names)), key=lambda i: _in_order(names[i]))
    places = np.arange(len(names))
    figure = Figure(figsize=(7.5, 6.5), layout="constrained")
    above, below = figure.subplots(2, 1)
    gone = dropped[order]
    above.bar(
        places[~gone], np.array(errors)[order][~gone], color="tab:blue", label="left out, against the others"
    )
    above.axhline(
        result.leave_one_out_mm, color="0.4", linestyle="--", label=f"mean {result.leave_one_out_mm:.2f} mm"
    )
    above.scatter(
        places[gone],
        np.zeros(gone.sum()),
        s=40,
        color="tab:red",
        marker="x",
        clip_on=False,
        label="dropped: take again",
    )
    above.set_xticks(places, [names[i] for i in order], rotation=90, fontsize=7)
    above.set_ylabel("error of the view (mm)")
    above.set_title(f"{len(result.views)} views kept, {len(result.dropped)} dropped, by {result.method}")
    above.legend(frameon=False, fontsize=8)

    methods = sorted(result.methods, key=lambda name: result.methods[name].leave_one_out_mm)
    means = np.array([result.methods[name].leave_one_out_mm for name in methods])
    end = _FULL * max(result.leave_one_out_mm, 1e-6)
    below.barh(
        methods, np.minimum(means, end), color=["tab:green" if m == result.method else "0.7" for m in methods]
    )
    for row, mean in enumerate(means):
        below.text(min(mean, end), row, f" {mean:.2f}", va="center", fontsize=8)
    below.set_xlim(0, 1.1 * end)
    below.invert_yaxis()
    below.set_xlabel("mean error of views left out (mm)")
    write_figure(path, figure)


def _in_order(name: str) -> list[tuple[int, str]]:
    """Sorts "view 9" before "view 10"."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", name)]
