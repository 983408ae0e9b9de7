"""The robot that teaches itself to stack knows what lies on what, and gets out of whatever goes wrong."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from baggie.calibration.files import CameraIdentity
from baggie.calibration.image_to_robot.map import ImageToRobot
from baggie.collect.machine import Stopped
from baggie.collect.recording import Recording
from baggie.collect.self_taught import run_sitting
from baggie.collect.stacking import Stacking
from baggie.commissioning.image_to_robot import calibrate, grid
from baggie.errors import BaggieError
from baggie.geometry import PlanarPose
from baggie.operator import Nobody
from baggie.robot.primitives import Handling
from baggie.tasks.bag_stacks import WORKSPACE
from baggie.types import Attempt
from baggie.workcell.simulated import SimulatedWorkcell, open_simulated
from helpers.fake_stacks import SETTINGS, SIZE, FakeStacks

RECORDING = Recording("stack", 0, 0, (320, 180), stacks=True)


@pytest.fixture(scope="module")
def to_robot() -> ImageToRobot:
    robot = grid(WORKSPACE, 0.03, (0.02, 0.12))
    pixels = FakeStacks().camera.project(robot)
    return ImageToRobot.fit(pixels, robot, CameraIdentity("top", *SIZE))


def attempts(
    cell: FakeStacks, to_robot: ImageToRobot, sittings: int = 1, first: int = 0
) -> Iterator[Attempt]:
    for number in range(first, first + sittings):
        yield from run_sitting(cell, to_robot, RECORDING, number, operator=Nobody())


class Watched(FakeStacks):
    """Checks that what is recorded of each move is what was true, and that bags are laid apart."""

    def reset(self, seed) -> None:
        super().reset(seed)
        self.true_layers: list[tuple[int, int]] = []

    def execute(self, action):
        before, places = dict(self.layers), dict(self.poses)
        outcome = super().execute(action)
        assert WORKSPACE.contains(action.place.x, action.place.y)
        moved = [bag for bag in places if self.poses[bag] != places[bag]]
        for bag in moved:
            self.true_layers.append((before[bag], self.layers[bag]))
            beside = [
                self.poses[other].distance(self.poses[bag])
                for other in self.poses
                if other != bag and self.layers[other] == self.layers[bag]
            ]
            assert min(beside, default=1.0) > 0.115
        return outcome


def test_layers_are_recorded_as_they_are_and_all_kinds_come(to_robot: ImageToRobot) -> None:
    cell, seen = Watched(), set()
    for sitting in range(8):
        shown = list(attempts(cell, to_robot, first=sitting))
        assert all(attempt.outcome.success for attempt in shown)
        assert [(attempt.pick_layer, attempt.place_layer) for attempt in shown] == cell.true_layers
        for attempt in shown:
            assert attempt.truth is not None
            assert attempt.truth.after.distance(attempt.commanded.place) < 0.01
            assert attempt.truth.before.distance(attempt.commanded.pick) < 0.006
            assert all(below.distance(attempt.commanded.place) < 0.1 for below in attempt.under)
            assert bool(attempt.under) == bool(attempt.place_layer)
        seen |= {(attempt.pick_layer, attempt.place_layer) for attempt in shown}
    assert {(0, 0), (0, 1), (0, 2), (1, 0), (2, 0)} <= seen


def test_a_bag_that_slid_off_is_noticed_and_picked_up_again(to_robot: ImageToRobot) -> None:
    cell = FakeStacks(["", "slid-off"])
    shown = list(attempts(cell, to_robot))
    upward = [attempt for attempt in shown if attempt.place_layer]
    assert len(upward) > 2
    slid = [attempt for attempt in shown if attempt.outcome.failure == "slid-off"]
    assert len(slid) == (1 if shown[1].place_layer else 0)
    assert all(attempt.outcome.success for attempt in shown if attempt not in slid)


def test_a_grasp_that_missed_is_tried_again(to_robot: ImageToRobot) -> None:
    cell = FakeStacks(["", "missed-grasp"])
    shown = list(attempts(cell, to_robot))
    assert [attempt.outcome.tries for attempt in shown[:3]] == [1, 2, 1]
    assert all(attempt.outcome.success for attempt in shown)


@pytest.mark.parametrize("feels_n", [0.1, 5.0])
def test_piles_that_nobody_knows_of_are_taken_apart_first(to_robot: ImageToRobot, feels_n: float) -> None:
    class Piled(FakeStacks):
        def reset(self, seed) -> None:
            super().reset(seed)
            self.pile(2, 0, 5)
            self.pile(1, 4)

    cell = Piled()
    cell.arm.info = replace(cell.arm.info, feels_n=feels_n)
    shown = list(attempts(cell, to_robot))
    # An arm that cannot feel how high they lie closes on air above them at first.
    assert feels_n > 1 or all(attempt.outcome.success for attempt in shown)
    assert {attempt.outcome.failure for attempt in shown} <= {None, "missed-grasp"}
    assert any(attempt.place_layer for attempt in shown)  # so all were found, and it went on to build


def test_one_that_is_nowhere_is_asked_for(to_robot: ImageToRobot) -> None:
    cell = FakeStacks()
    cell.gone = {3}
    with pytest.raises(
        Stopped, match=r"the bag of colour RGB \(\d+, \d+, \d+\) is not in sight: put it back"
    ):
        list(attempts(cell, to_robot))
    assert {action.place_on_m for action in cell.executed} <= {0.0}  # only looked under the others


def test_what_one_cannot_stack_by_is_refused(to_robot: ImageToRobot) -> None:
    rng = np.random.default_rng(0)
    one_color = replace(SETTINGS, object_colors=SETTINGS.object_colors[:1])
    with pytest.raises(BaggieError, match="expected bags of at least two colours"):
        Stacking(to_robot, one_color, rng)
    robot = grid(WORKSPACE, 0.03, (0.02,))
    flat = ImageToRobot.fit(FakeStacks().camera.project(robot), robot, CameraIdentity("top", *SIZE))
    with pytest.raises(BaggieError, match="knows more than one height"):
        Stacking(flat, SETTINGS, rng)


# in the simulator


@pytest.fixture(scope="module")
def simulated() -> Iterator[SimulatedWorkcell]:
    cell = open_simulated(0, "bag-stack", depth=False)
    yield cell
    cell.close()


def test_the_simulated_robot_lays_bags_on_bags_by_what_it_sees_and_feels(
    simulated: SimulatedWorkcell,
) -> None:
    to_robot = calibrate(simulated, 0)
    shown = list(islice(run_sitting(simulated, to_robot, RECORDING, 0, operator=Nobody()), 3))
    assert sum(attempt.outcome.success for attempt in shown) >= 2
    stacked = [attempt for attempt in shown if attempt.place_layer and attempt.outcome.success]
    assert stacked
    for attempt in stacked:
        assert attempt.truth is not None
        assert attempt.truth.after.distance(attempt.under[0]) < 0.05
        assert attempt.outcome.place_z_m > Handling().place_z_m + 0.01  # felt to stand above the table


def test_bags_that_strayed_are_laid_back_where_there_is_room(simulated: SimulatedWorkcell) -> None:
    simulated.reset((3,))
    assert not simulated.rescue()
    simulated.world.put("bag 2", PlanarPose(0.5, 0.6))
    assert simulated.rescue()
    places = [simulated.truth(color) for color in simulated.settings.object_colors]
    assert WORKSPACE.contains(places[1].x, places[1].y)
    assert min(places[1].distance(other) for n, other in enumerate(places) if n != 1) > 0.1
