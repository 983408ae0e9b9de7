"""Where the camera is on the robot: hand-eye calibration, from poses of the hand and views of a printed board.

Seven closed forms and our refinements all solve the same views; each view is left out in turn and predicted from the
others, and a method is taken that does this at least as well as the best closed form.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from baggie.calibration.hand_eye.agree import agree
from baggie.calibration.hand_eye.closed_forms import MIN_VIEWS
from baggie.calibration.hand_eye.compare import Candidate, best_of, compare, uncertainty
from baggie.calibration.hand_eye.lens import lens_share
from baggie.calibration.hand_eye.refine import Pair, refine
from baggie.calibration.hand_eye.result import HandEye, MethodErrors
from baggie.calibration.hand_eye.views import HandEyeViews

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
