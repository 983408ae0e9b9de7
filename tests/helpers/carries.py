"""Whatever may be asked of a workcell's arm, and that it gets there without turning more than it must."""

from __future__ import annotations

import math

from hypothesis import strategies as st

from baggie.geometry import PlanarPose, Rectangle
from baggie.robot.primitives import least_turn, rehearse
from baggie.types import PickPlace
from baggie.workcell.workcell import Workcell

SLACK_RAD = math.pi / 2 + 0.01
"""By so much more at most does a hand turn whose limits make it begin with the other half turn: up to half a turn
instead of a quarter, and a hundredth that arms foresee less exactly."""


def carries_in(area: Rectangle) -> st.SearchStrategy[PickPlace]:
    """From anywhere to anywhere at any yaw: the action space of the environments."""
    poses = st.builds(
        PlanarPose,
        st.floats(area.x_min, area.x_max),
        st.floats(area.y_min, area.y_max),
        st.floats(-math.pi, math.pi),
    )
    return st.builds(PickPlace, poses, poses)


def check_reached(cell: Workcell, action: PickPlace, symmetry: int) -> None:
    """Raise `AssertionError`, or what stops it, unless the arm, at rest at yaw 0, foresees to carry this out."""
    handling = cell.settings.handling
    chosen = least_turn(cell.arm, action, handling, symmetry)
    turned = cell.arm.foresee(rehearse(cell.arm, chosen, handling))
    alike = 2 * math.pi / symmetry
    assert turned <= min(alike, math.pi) / 2 + alike / 2 + SLACK_RAD
