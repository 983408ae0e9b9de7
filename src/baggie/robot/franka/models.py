"""Franka's arms: their links, which are the same, and how far and how fast the joints of each turn."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from baggie.errors import BaggieError
from baggie.geometry import FloatArray
from baggie.robot.arm import ArmInfo

if TYPE_CHECKING:
    import mujoco

    from baggie.robot.kinematics import Kinematics

ModelName = Literal["fr3", "panda"]

_JOINTS = 7
_MUJOCO = 4  # the first with soft bodies that take dents
HOME = np.array([0.0, -0.5, 0.0, -2.2, 0.0, 1.7, 0.7853])
"""Joint angles of a raised, bent elbow with the tool pointing down, radians."""
PARK = np.array([0.0, -1.1, 0.0, -2.75, 0.0, 1.75, 0.7853])
"""Joint angles of an arm drawn back, so that a camera sees the table, radians."""
TOOL_OFFSET_M = 0.1034
"""From the hand's frame to the point between the fingertips (Franka's hand, data sheet)."""
MAX_SPEED_M_S = 1.7
JOINT_MARGIN_RAD = 0.05
"""Kept from the ends of every joint: near them the robot brakes by itself, which ends as an error."""


@dataclass(frozen=True)
class FrankaModel:
    """Joint limits of one arm, from Franka's data sheets. Radians, seconds; `(7,)`, from the base to the wrist."""

    title: str
    lower_rad: FloatArray
    upper_rad: FloatArray
    speed_rad_s: FloatArray

    def info(self, host: str) -> ArmInfo:
        """What such an arm with Franka's hand can do, at the address `host`."""
        name = f"{self.title} at {host}"
        return ArmInfo(name, max_width_m=0.08, max_speed_m_s=MAX_SPEED_M_S, max_force_n=70.0)

    def kinematics(self) -> Kinematics:
        """Of the point between the fingertips of Franka's hand, within these limits less a margin."""
        from baggie.robot.kinematics import Kinematics  # noqa: PLC0415 -- the limits are read without MuJoCo, too

        spec = links()
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


def links() -> mujoco.MjSpec:
    """The links of the FR3 with its hand, as `franky-sim` ships them, and a site `tool` between the fingertips.

    z points out of the tool. Raises `BaggieError` where MuJoCo is too old.
    """
    require_mujoco()
    import mujoco  # noqa: PLC0415 -- as above

    assets = Path(str(files("franky_sim"))) / "assets"
    spec = mujoco.MjSpec.from_file(str(assets / "fr3.xml"))
    spec.meshdir = str(assets / "meshes")
    spec.delete(spec.keys[0])
    spec.body("hand").add_site(name="tool", pos=[0, 0, TOOL_OFFSET_M])
    return spec


def require_mujoco() -> None:
    """Raise `BaggieError` where something else has had an older MuJoCo installed."""
    import mujoco  # noqa: PLC0415 -- as above

    if int(mujoco.__version__.split(".")[0]) < _MUJOCO:
        raise BaggieError(
            f"MuJoCo {_MUJOCO} is needed, and {mujoco.__version__} is installed here, which something else may need: "
            "give Baggie an environment of its own (python3 -m venv)"
        )
