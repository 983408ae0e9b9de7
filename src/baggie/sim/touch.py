"""What touches a body, and how hard: rigid things and cloth alike.

MuJoCo's own force sensors leave out contacts with cloth and bags (flexes), so contacts are added up here.
"""

from __future__ import annotations

from collections.abc import Collection

import mujoco
import numpy as np


def upward_touch(model: mujoco.MjModel, data: mujoco.MjData, bodies: Collection[int]) -> float:
    """Newtons with which all else pushes these bodies up; a load that hangs on them pulls them down."""
    geoms = data.contact.geom[: data.ncon]
    ours = np.isin(model.geom_bodyid[geoms], list(bodies)) & (geoms >= 0)  # -1 is cloth
    total, wrench = 0.0, np.zeros(6)
    for number in np.flatnonzero(ours[:, 0] != ours[:, 1]):
        mujoco.mj_contactForce(model, data, number, wrench)
        upward = float(
            data.contact.frame[number].reshape(3, 3)[:, 2] @ wrench[:3]
        )  # of the first on the second
        total += upward if ours[number, 1] else -upward
    return total
