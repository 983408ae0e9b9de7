"""What differs between Franka's arms: how far and how fast their joints turn. Their links are the same."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from baggie.geometry import FloatArray

if TYPE_CHECKING:
    from baggie.sim.kinematics import Kinematics

ModelName = Literal["fr3", "panda"]

_JOINTS = 7
JOINT_MARGIN_RAD = 0.05
"""Kept from the ends of every joint: near them the robot brakes by itself, which ends as an error."""


@dataclass(frozen=True)
class FrankaModel:
    """Joint limits of one arm, from Franka's data sheets. Radians, seconds; `(7,)`, from the base to the wrist."""

    title: str
    lower_rad: FloatArray
    upper_rad: FloatArray
    speed_rad_s: FloatArray

    def kinematics(self) -> Kinematics:
        """Of the point between the fingertips of Franka's hand, within these limits less a margin."""
        from baggie.sim.kinematics import Kinematics  # noqa: PLC0415 -- the limits are read without MuJoCo, too
        from baggie.sim.scene import HOME, arm_spec  # noqa: PLC0415

        spec = arm_spec()
        limits = zip(self.lower_rad + JOINT_MARGIN_RAD, self.upper_rad - JOINT_MARGIN_RAD, strict=True)
        for number, limit in enumerate(limits, start=1):
            spec.joint(f"fr3_joint{number}").range = limit
        return Kinematics(spec.compile(), HOME)


def _model(
    title: str, lower: tuple[float, ...], upper: tuple[float, ...], speed: tuple[float, ...]
) -> FrankaModel:
    assert len(lower) == len(upper) == len(speed) == _JOINTS
    return FrankaModel(title, np.array(lower), np.array(upper), np.array(speed))


MODELS: dict[ModelName, FrankaModel] = {
    "fr3": _model(
        "FR3",
        (-2.7437, -1.7837, -2.9007, -3.0421, -2.8065, 0.5445, -3.0159),
        (2.7437, 1.7837, 2.9007, -0.1518, 2.8065, 4.5169, 3.0159),
        (2.62, 2.62, 2.62, 2.62, 5.26, 4.18, 5.26),
    ),
    "panda": _model(
        "Panda",
        (-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973),
        (2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973),
        (2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61),
    ),
}
