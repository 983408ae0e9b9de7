"""The table's top, which can be knocked."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from baggie.geometry import PlanarPose
from baggie.sim.soft_body import SoftBody


def bump_table(
    model: mujoco.MjModel, data: mujoco.MjData, motion: PlanarPose, bags: Sequence[SoftBody]
) -> None:
    """Move the top for good, and with it the bags, the card and the sheet: what was at `pose` is at `motion @ pose`.

    The world's `update_fixed` has to follow.
    """
    turn = Rotation.from_euler("z", motion.yaw)
    quaternion, shift = turn.as_quat(scalar_first=True), np.array([motion.x, motion.y, 0.0])
    top = model.geom("table_top")
    for position, orientation in (
        (top.pos, top.quat),
        *zip(data.mocap_pos, data.mocap_quat, strict=True),
    ):
        position[:] = turn.apply(position) + shift
        mujoco.mju_mulQuat(orientation, quaternion, orientation.copy())
    for bag in bags:
        bag.carry_along(turn, shift)
