"""What the simulated hand feels of soft things, and how these rest."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from baggie.geometry import FloatArray, PlanarPose, ToolPose
from baggie.robot.primitives import Handling
from baggie.workcell.simulated import SimulatedWorkcell, open_simulated

HANDLING = Handling()


@pytest.fixture(scope="module")
def cell() -> Iterator[SimulatedWorkcell]:
    cell = open_simulated(0)
    yield cell
    cell.close()


def lay_and_come(cell: SimulatedWorkcell, z: float = 0.11) -> float:
    """A bag in the middle and the open hand above it; the height of its top."""
    cell.reset((21,))
    cell.world.put("bag", PlanarPose(0.5, 0.0), undented=True)
    cell.world.advance(1.0)
    cell.arm.move_gripper(HANDLING.open_width_m)
    cell.arm.move_to(ToolPose(0.5, 0.0, z, 0.0), 0.5)
    return cell.world.bodies["bag"].top_m()


def test_the_open_hand_feels_the_top_of_a_bag(cell: SimulatedWorkcell) -> None:
    top = lay_and_come(cell)
    felt = cell.arm.lower_until_contact(0.012, HANDLING.feel_m_s / 3, HANDLING.top_force_n)
    assert top - 0.02 < felt.z < top + 0.01


def test_a_bag_in_the_hand_is_felt_to_stand(cell: SimulatedWorkcell) -> None:
    lay_and_come(cell)
    cell.arm.lower_until_contact(HANDLING.pick_z_m, HANDLING.feel_m_s, HANDLING.touch_force_n)
    cell.arm.grasp(HANDLING.grasp_force_n)
    cell.arm.move_to(ToolPose(0.5, 0.0, 0.2, 0.0), HANDLING.carry_m_s)
    felt = cell.arm.lower_until_contact(0.012, HANDLING.feel_m_s / 3, HANDLING.stand_force_n)
    assert 0.03 < felt.z < 0.07  # as far as it hangs below the hand, and a little less


def test_in_free_air_the_hand_feels_nothing(cell: SimulatedWorkcell) -> None:
    lay_and_come(cell, 0.35)
    assert cell.arm.lower_until_contact(0.15, HANDLING.feel_m_s, HANDLING.top_force_n).z == pytest.approx(
        0.15, abs=0.003
    )


def points(cell: SimulatedWorkcell) -> FloatArray:
    return cell.world.bodies["bag"].points.copy()


def test_a_bag_sleeps_until_it_is_touched(cell: SimulatedWorkcell) -> None:
    lay_and_come(cell)
    asleep = points(cell)
    cell.world.advance(1.0)
    np.testing.assert_array_equal(points(cell), asleep)
    cell.arm.lower_until_contact(HANDLING.pick_z_m, HANDLING.feel_m_s, HANDLING.touch_force_n)
    assert np.abs(points(cell) - asleep).max() > 0.001


def test_a_scene_begins_the_same_whatever_was_before(cell: SimulatedWorkcell) -> None:
    cell.reset((22,))
    first = points(cell)
    lay_and_come(cell)
    cell.arm.lower_until_contact(HANDLING.pick_z_m, HANDLING.feel_m_s, HANDLING.touch_force_n)
    cell.arm.grasp(HANDLING.grasp_force_n)
    cell.reset((22,))
    np.testing.assert_array_equal(points(cell), first)
