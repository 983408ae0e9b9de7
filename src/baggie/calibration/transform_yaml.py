"""A rigid transform and its uncertainty, as they stand in a calibration file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from baggie.calibration.uncertain import UncertainTransform
from baggie.geometry import FloatArray, is_rigid

_RIGID = 1e-6
"""How far a rotation's rows may be from orthonormal: these files keep all digits."""


def uncertainty_to_yaml(pose: UncertainTransform) -> dict[str, Any]:
    """What stands beside `T_a_b`; the covariance is of rotation (radians) and translation (metres), in frame a."""
    return {"std_mm": pose.std_mm, "std_deg": pose.std_deg, "covariance": pose.covariance}


def pose_from_yaml(content: Mapping[str, Any], name: str) -> UncertainTransform:
    """`T_a_b` called `name`, with its `uncertainty`. Raises `KeyError`, `TypeError` or `ValueError` when damaged."""
    covariance = np.array(content["uncertainty"]["covariance"], float).reshape(6, 6)
    return UncertainTransform(rigid_from_yaml(content, name), covariance)


def rigid_from_yaml(content: Mapping[str, Any], name: str) -> FloatArray:
    """`(4, 4)` called `name`. Raises `KeyError`, `TypeError` or `ValueError` when it is no rigid transform."""
    transform = np.array(content[name], float)
    if not is_rigid(transform, _RIGID):
        raise ValueError(f"{name} is not a rotation and a translation, 4 x 4 numbers")
    return transform
