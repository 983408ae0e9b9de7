"""Is the marker where the hand is said to hold it?

Carried with the hand always turned the same way, a marker that sits 10 mm further forward than stated only shifts the
whole map by 10 mm, and every residual looks perfect. Turned this way and that, it cannot.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from baggie.calibration.image_to_robot.map import ImageToRobot
from baggie.errors import CalibrationError
from baggie.geometry import FloatArray

_LIMIT_M = 0.002
_STDS = 4.0
_MIN_TURN_RAD = 0.15
_STEP_M = 0.01
_ROUNDS = 2
"""The residuals are nearly straight in the offset."""


def check_marker_offset(
    fit: Callable[[FloatArray], ImageToRobot], T_base_hand: FloatArray, marker_in_hand: FloatArray
) -> None:
    """Raise `CalibrationError` when the marker is clearly elsewhere in the hand than `marker_in_hand` `(3,)` metres.

    `fit` makes a map from where the marker was, `(N, 3)` metres in the base frame; `T_base_hand` `(N, 4, 4)`. Nothing
    can be told, and nothing is, when the hand was turned the same way at all points.
    """
    turned = np.arctan2(T_base_hand[:, 1, 0], T_base_hand[:, 0, 0])
    if np.std(turned) < _MIN_TURN_RAD:
        return

    shift, std = np.zeros(2), np.zeros(2)
    for _ in range(_ROUNDS):
        steps = [shift, *(shift + step for step in _STEP_M * np.eye(2))]
        fits = [fit(_each(T_base_hand, marker_in_hand + np.append(step, 0.0))).residuals for step in steps]
        used = np.logical_and.reduce([residuals.kept for residuals in fits])
        here, *beside = ((residuals.error_mm[used] / 1000).ravel() for residuals in fits)
        slopes = np.stack([there - here for there in beside], axis=1) / _STEP_M
        shift = shift - np.linalg.lstsq(slopes, here, rcond=None)[0]
        std = np.sqrt(np.diag(np.linalg.inv(slopes.T @ slopes)) * (here**2).mean())
    off = float(np.linalg.norm(shift))
    if off > max(_LIMIT_M, _STDS * float(np.linalg.norm(std))):
        x, y, z = marker_in_hand + np.append(shift, 0.0)
        raise CalibrationError(
            f"the marker is {1000 * off:.0f} mm from where the hand is said to hold it: as the hand turned, it moved "
            f"as if it were at x {x:.3f}, y {y:.3f} m; measure it, and give --marker-in-hand {x:.3f} {y:.3f} {z:.3f}"
        )


def _each(transforms: FloatArray, point: FloatArray) -> FloatArray:
    """One point `(3,)` through each of `(N, 4, 4)` transforms: `(N, 3)`."""
    return np.asarray(transforms[:, :3, :3] @ point + transforms[:, :3, 3])
