"""What every arm must do, whoever made it. Call this from the tests of a new one."""

from __future__ import annotations

import numpy as np
import pytest

from baggie.errors import LimitError, ReachError
from baggie.geometry import PlanarPose, ToolPose
from baggie.workcell.arm import Arm
from baggie.workcell.workcell import Workcell

POSITION_TOLERANCE_M = 0.002


def check_arm(cell: Workcell) -> None:
    """Motions end where they were sent, report where they ended, and refuse what they must."""
    arm = cell.arm
    assert isinstance(arm, Arm)
    middle = cell.settings.workspace
    center = PlanarPose((middle.x_min + middle.x_max) / 2, (middle.y_min + middle.y_max) / 2, 0.3)
    target = center.at_height(0.25)

    reached = arm.move_to(target, 0.5)
    np.testing.assert_allclose(reached.xyz, target.xyz, atol=POSITION_TOLERANCE_M)
    assert reached.yaw == pytest.approx(target.yaw, abs=0.02)
    np.testing.assert_allclose(arm.pose().xyz, reached.xyz, atol=POSITION_TOLERANCE_M)

    lowered = arm.lower_until_contact(0.15, 0.3, 20.0)
    assert lowered.z == pytest.approx(0.15, abs=POSITION_TOLERANCE_M), "nothing there to touch"
    assert arm.move_gripper(0.03) == pytest.approx(0.03, abs=0.002)
    assert arm.grasp(10.0) == pytest.approx(0.0, abs=0.002), "nothing between the fingers"
    assert arm.move_gripper(arm.info.max_width_m) == pytest.approx(arm.info.max_width_m, abs=0.003)

    before = arm.pose()
    for bad in (ToolPose(2.0, 0.0, 0.3), ToolPose(0.5, 0.0, -0.1), ToolPose(float("nan"), 0.0, 0.3)):
        with pytest.raises((LimitError, ReachError)):
            arm.move_to(bad, 0.2)
    with pytest.raises(LimitError):
        arm.move_to(target, 100.0)
    with pytest.raises(LimitError):
        arm.grasp(1e4)
    with pytest.raises(LimitError):
        arm.move_gripper(-0.01)
    np.testing.assert_allclose(arm.pose().xyz, before.xyz, atol=1e-3)  # nothing was moved
