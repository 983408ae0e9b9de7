"""What the environments have in common: how an action is carried out."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from baggie.errors import LimitError, ReachError
from baggie.geometry import Rectangle
from baggie.types import PickPlace
from baggie.workcell.workcell import Workcell

ObservationDict = dict[str, Any]


def action_space(area: Rectangle) -> gymnasium.Space[NDArray[np.float32]]:
    """`(6,)` float32: pick x, y, yaw, place x, y, yaw; metres and radians, robot base frame."""
    low = np.array([area.x_min, area.y_min, -np.pi] * 2, np.float32)
    high = np.array([area.x_max, area.y_max, np.pi] * 2, np.float32)
    return spaces.Box(low, high, dtype=np.float32)


def execute(workcell: Workcell, action: NDArray[np.float32]) -> dict[str, Any]:
    """Carry out an action `(6,)`: `outcome` where the arm moved, `refused` and why where it would not."""
    try:
        return {"outcome": workcell.execute(PickPlace.from_array(action))}
    except (LimitError, ReachError) as error:
        return {"refused": str(error)}
