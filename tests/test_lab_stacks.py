"""The virtual lab with the bags of a task that stacks them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

import baggie
from baggie.errors import BaggieError
from baggie.geometry import PlanarPose
from baggie.lab.lab import Lab, draw_scene
from baggie.lab.web import LabControl
from baggie.registry import TASKS
from baggie.sim.cell import draw_cell
from baggie.tasks.bag_stacks import WORKSPACE
from baggie.tasks.pattern import Pattern
from baggie.tasks.stacked import NEAR_M, ON_TABLE_M, Stacked
from baggie.types import LAYER_M, PickPlace
from baggie.workcell.workcell import Workcell
from helpers.lab_process import control_of, running_lab

pytest.importorskip("franky", reason='needs franky-control: pip install ".[franka]"')
NAMES = ("bag 1", "bag 2", "bag 3")
LOOSE = dict(zip(NAMES, (PlanarPose(0.5, y) for y in (-0.2, 0.0, 0.2)), strict=True))
ASIDE = PlanarPose(0.5, 0.8)


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    with running_lab(tmp_path_factory.mktemp("lab"), "--task", "bag-tower") as path:
        yield path


@pytest.fixture(scope="module")
def control(file: Path) -> LabControl:
    return control_of(file)


@pytest.fixture(scope="module")
def opened(file: Path) -> Iterator[Workcell]:
    cell = baggie.open_workcell(file)
    yield cell
    cell.close()


@pytest.fixture
def cell(opened: Workcell, control: LabControl) -> Workcell:
    """With the bags in a row, and the arm parked."""
    control.reset(0)
    control.lay_aside(ASIDE)
    for name, pose in LOOSE.items():
        control.lay_bag(pose, name=name)
    return opened


def test_each_bag_is_told_where_it_lies_and_the_scene_is_its_seeds(control: LabControl) -> None:
    control.reset(3)
    _, scene = draw_scene(TASKS["bag-tower"], draw_cell(0), 3)
    first = control.state()
    assert tuple(first.places) == NAMES
    for name, pose in scene.poses.items():
        assert first.places[name].distance(pose) < 0.002
        assert 0.0 < first.poses[name][2, 3] < ON_TABLE_M
    control.reset(4)
    assert control.state().places["bag 2"].distance(first.places["bag 2"]) > 0.01
    control.reset(3)
    again = control.state().places
    assert all(again[name].distance(first.places[name]) < 1e-6 for name in NAMES)


def test_bags_are_laid_by_their_names_and_on_no_other(control: LabControl) -> None:
    control.reset(0)
    control.lay_aside(ASIDE)
    assert all(pose.y > ASIDE.y - 0.01 for pose in control.state().places.values())
    control.lay_bag(PlanarPose(0.5, 0.1, 0.3), name="bag 2")
    assert control.state().places["bag 2"].distance(PlanarPose(0.5, 0.1)) < 1e-6
    with pytest.raises(BaggieError, match="beside all other bags, got it on bag 2; lay that"):
        control.lay_bag(PlanarPose(0.5, 0.15))
    with pytest.raises(BaggieError, match="a bag among bag 1, bag 2, bag 3, got 'bag 4'"):
        control.lay_bag(PlanarPose(0.5, -0.1), name="bag 4")
    with pytest.raises(BaggieError, match="expected a block beside the bag, got one on it"):
        control.lay_block(PlanarPose(0.5, 0.1), 0.04)


def test_its_file_says_what_stacking_needs(opened: Workcell) -> None:
    settings = opened.settings
    assert settings.workspace == WORKSPACE
    assert settings.object_symmetry == 2
    assert settings.object_colors == tuple(bag.color for bag in TASKS["bag-tower"].things)


def test_a_lab_of_one_bag_draws_the_scenes_that_it_always_drew() -> None:
    exposure, scene = draw_scene(TASKS["bag-place"], draw_cell(0), 0)
    assert list(scene.poses) == ["bag"]
    pose = scene.poses["bag"]
    assert (pose.x, pose.y, pose.yaw) == pytest.approx((0.461234, -0.042127, -0.181047), abs=1e-6)
    assert exposure.gain == pytest.approx(1.039079, abs=1e-6)


def test_what_is_no_task_of_bags_makes_no_lab() -> None:
    with pytest.raises(
        BaggieError, match="expected a task of bags and a hand for the lab, got block-pyramid"
    ):
        Lab(TASKS["block-pyramid"], 0, seed=0, host="127.0.0.1", pace=0.0)


@pytest.mark.slow
def test_a_bag_is_laid_on_another_and_stays_there(cell: Workcell, control: LabControl) -> None:
    site = LOOSE["bag 2"]
    outcome = cell.execute(PickPlace(LOOSE["bag 1"], site, place_on_m=LAYER_M, tallest_m=LAYER_M))
    assert outcome.success
    control.wait(1.0)
    state = control.state()
    stacked = Stacked(NAMES, Pattern.parse("tower:2").at(site))
    assert stacked.filled(state) == {0: "bag 2", 1: "bag 1"}
    assert state.places["bag 3"].distance(LOOSE["bag 3"]) < NEAR_M
