"""What touches a body, and how hard: rigid things and cloth alike.

MuJoCo's own force sensors leave out contacts with cloth and bags (flexes), so contacts are added up here.
"""

from __future__ import annotations

from collections.abc import Container

import mujoco
import numpy as np


def upward_touch(model: mujoco.MjModel, data: mujoco.MjData, bodies: Container[int]) -> float:
    """Newtons with which all else pushes these bodies up; a load that hangs on them pulls them down."""
    total, wrench = 0.0, np.zeros(6)
    for number, (first, second) in enumerate(data.contact.geom[: data.ncon]):
        ours = [geom >= 0 and model.geom_bodyid[geom] in bodies for geom in (first, second)]
        if ours[0] == ours[1]:
            continue
        mujoco.mj_contactForce(model, data, number, wrench)
        upward = float(
            data.contact.frame[number].reshape(3, 3)[:, 2] @ wrench[:3]
        )  # of the first on the second
        total += upward if ours[1] else -upward
    return total
