"""The closed loop where nobody knows the truth: the camera says where the bag ends."""

import functools
import math
import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from baggie.collect.machine import detect
from baggie.commissioning.image_to_robot import calibrate
from baggie.errors import BaggieError, BaggieWarning
from baggie.evaluation import terms as module
from baggie.evaluation.closed_loop import EvaluateOptions
from baggie.evaluation.log import read_episodes
from baggie.evaluation.setup import ObjectFinder, Setup, open_setup
from baggie.geometry import PlanarPose
from baggie.options.evaluating import ReportOptions
from baggie.policies import ColorMaskPolicy, KeypointPolicy
from baggie.policies.keypoint.policy import KeypointNet
from baggie.policies.planning import View
from baggie.report.report import report
from baggie.types import Outcome
from baggie.workcell.workcell import Calibrations, WorkcellSettings, at_outline
from helpers import bag_evaluations as simulated
from helpers.bag_evaluations import evaluate_here
from helpers.fake_workcell import FakeCell

FILE = Path("cell.yaml")


class RealFake(FakeCell):
    """A fake cell whose scene stays as it is, whose truth nobody knows, and which carries out what is planned."""

    looks = 0

    def lay_anew(self, seed):
        super().reset((seed,))

    def reset(self, seed):
        if hasattr(self, "bag"):
            self.arm.park()
        else:
            self.lay_anew(0)

    def state(self):
        return None

    def look(self):
        self.looks += 1
        return super().look()

    def carry_out(self, plan):
        return self.execute(plan.action)


def calibrated(cell):
    cell.calibrations = Calibrations(image_to_robot=calibrate(cell, 0))
    return cell


def setup(cell, options):
    find = ObjectFinder(cell, FILE)
    policy = ColorMaskPolicy(find.image_to_robot, cell.settings.object_color)
    return Setup(cell, policy, find.image_to_robot, find)


def options(tmp_path, **asked):
    return EvaluateOptions(policy="color-mask", out=tmp_path, workcell=FILE, episodes=4, **asked)


@pytest.fixture
def cell():
    return calibrated(RealFake(size=(640, 360)))


def test_what_is_seen_is_where_it_is(cell):
    find = ObjectFinder(cell, FILE)
    for seed in range(5):
        cell.lay_anew(seed)
        assert find(cell.look()).distance(cell.bag) < 0.004


CUBE_M = 0.065


@pytest.fixture
def cube():
    """What is as high as it is wide, and a map that was made for something flat."""
    cell = RealFake(WorkcellSettings(object_size_m=(CUBE_M, CUBE_M, CUBE_M)), size=(1280, 720))
    return calibrated(cell)


def off_mm(cell, settings):
    """The mean distance, millimetres, between where a thing is and where it is found by these settings."""
    to_robot, found = at_outline(cell.calibrations.image_to_robot, settings), []
    for seed in range(8):
        cell.lay_anew(seed)
        _, pose = detect(cell.look(), to_robot, settings)
        found.append(1000 * pose.distance(cell.bag))
    return sum(found) / len(found)


def test_a_high_thing_is_found_where_it_is_once_its_height_is_written_down(cube):
    flat = replace(cube.settings, object_size_m=(CUBE_M, CUBE_M, 0.03))
    assert off_mm(cube, cube.settings) < 2
    assert off_mm(cube, flat) > 4
    assert ObjectFinder(cube, FILE).image_to_robot.height_m == CUBE_M / 2


def test_a_high_thing_is_judged_where_it_is(cube, tmp_path):
    metrics = evaluate_here(options(tmp_path), functools.partial(setup, cube))
    assert metrics["success"]["rate"] == 1.0
    for episode in read_episodes(tmp_path).values():
        assert math.dist(episode.landing.goal[:2], episode.landing.final[:2]) < 0.02


def test_a_map_of_another_height_says_what_it_costs(cube):
    one_height = replace(cube.calibrations.image_to_robot, projection=np.eye(3), height_m=0.0)
    with pytest.warns(BaggieWarning, match=r"right 0 m above the table only, the middle .* 0\.0325 m up"):
        assert at_outline(one_height, cube.settings) is one_height


def test_the_marker_passes_over_a_high_thing(cube, monkeypatch):
    heights = []
    monkeypatch.setattr(cube, "settings", replace(cube.settings, object_size_m=(0.1, 0.1, 0.12)))
    monkeypatch.setattr(
        cube.arm, "move_to", lambda to, speed: heights.append(to.z) or setattr(cube.arm, "tool", to) or to
    )
    cube.calibrations = Calibrations()
    calibrate(cube, 0)
    assert min(heights) >= 0.12 + 0.03


def test_what_was_seen_belongs_to_its_picture_and_asking_for_it_moves_nothing(cell):
    asked = setup(cell, None)
    picture, then = asked.cell.look(), cell.bag
    cell.arm.move_to(PlanarPose(0.5, 0.0).at_height(0.2), 0.1)
    cell.bag = PlanarPose(0.5, 0.2)
    assert asked.object_in(picture).distance(then) < 0.004
    assert asked.cell.state() is None
    assert cell.arm.pose() != cell.arm.park()
    assert cell.looks == 1


def test_an_episode_takes_three_pictures(cell, tmp_path):
    in_cell = functools.partial(setup, cell)
    evaluate_here(options(tmp_path), in_cell)
    assert cell.looks == 3 * 4
    for episode in read_episodes(tmp_path).values():
        assert episode.steps[-1].pick_error_cm < 1e-9  # the policy plans from the picture, and so is measured


def test_a_bag_the_policy_puts_out_of_reach_is_its_own_affair(cell, tmp_path):
    far = replace(cell.bag, x=cell.settings.limits.workspace.x_max + 0.03)
    cell.carry_out = lambda plan: setattr(cell, "bag", far) or Outcome(plan.action)
    in_cell = functools.partial(setup, cell)
    assert evaluate_here(replace(options(tmp_path), episodes=1), in_cell)["success"]["rate"] == 0
    with pytest.raises(BaggieError, match="put it back"):
        evaluate_here(replace(options(tmp_path), episodes=2), in_cell)


def test_each_scene_starts_where_the_last_one_ended(cell, tmp_path):
    metrics = evaluate_here(options(tmp_path), functools.partial(setup, cell))
    assert metrics["success"]["rate"] == 1.0
    assert metrics["workcell"] == str(FILE)
    landings = [episode.landing for episode in read_episodes(tmp_path).values()]
    for before, after in pairwise(landings):
        start, end = PlanarPose(*after.start), PlanarPose(*before.final)
        assert start.distance(end) < 0.004


def test_it_is_reported_as_measured_by_the_camera(cell, tmp_path):
    run = tmp_path / "run"
    evaluate_here(replace(options(tmp_path), out=run / "real", film=0), functools.partial(setup, cell))
    text = report(ReportOptions((run,), tmp_path / "report.html")).read_text()
    assert "4 of 4 things to within 2 cm" in text
    assert f"color-mask was tried on a real arm ({FILE})" in text
    assert "Plans against what the camera saw" in text
    assert "truth" not in text


def test_a_simulated_and_a_real_cell_are_two_rows_of_a_report(cell, tmp_path):
    run = tmp_path / "run"
    evaluate_here(replace(options(tmp_path), out=run / "real", film=0), functools.partial(setup, cell))
    evaluate_here(
        simulated.options(run / "simulated", policy="color-mask", film=0), simulated.open_off_by_25_mm
    )
    text = report(ReportOptions((run,), tmp_path / "report.html")).read_text()
    assert f"color-mask, {FILE}" in text
    assert "0 of 5 things to within 2 cm" in text  # the page is about the simulated one
    assert "Plans against the truth or what the camera saw" in text


def test_what_a_workcell_file_says_is_part_of_what_is_evaluated_and_where_its_camera_is_is_not(tmp_path):
    file, lens = tmp_path / "cell.yaml", tmp_path / "camera.yaml"
    lens.write_text("made: once")
    text = "arm: {kind: franka, host: 10.0.0.2}\ncamera: 0\ncalibrations: {intrinsics: camera.yaml}\n"

    def says(written):
        file.write_text(written)
        return module._says(file)

    first = says(text)
    assert (
        says(f"# at night\n{text.replace('10.0.0.2', '10.0.0.3').replace('camera: 0', 'camera: 2')}") == first
    )
    assert says(f"{text}bag: {{length_m: 0.13}}\n") != first
    lens.write_text("made: again")
    assert says(text) != first


def test_metrics_say_which_arm_moved(cell, tmp_path):
    file = tmp_path / "cell.yaml"
    file.write_text("arm: {kind: franka, host: 10.0.0.2, model: panda}\ncamera: 0\n")
    asked = replace(options(tmp_path / "out"), episodes=1, workcell=file)
    assert evaluate_here(asked, functools.partial(setup, cell))["robot"] == "Panda"


def test_a_lost_bag_ends_it_with_one_line_and_nothing_is_lost(cell, tmp_path):
    cell.script = [None, "lost-bag"]
    with pytest.raises(BaggieError, match="bring it back into view") as raised:
        evaluate_here(options(tmp_path), functools.partial(setup, cell))
    assert "\n" not in str(raised.value)
    assert len(read_episodes(tmp_path)) == 1
    cell.script, cell.hidden = [], False  # a person has put it back
    assert evaluate_here(options(tmp_path), functools.partial(setup, cell))["success"]["n"] == 4


def test_a_bag_out_of_reach_is_not_counted_against_the_policy(cell, tmp_path):
    cell.bag = replace(cell.bag, x=cell.settings.limits.workspace.x_max + 0.02, y=0.0)
    with pytest.raises(BaggieError, match="put it back"):
        evaluate_here(options(tmp_path), functools.partial(setup, cell))
    assert not (tmp_path / "episodes.jsonl").exists()


def test_without_a_map_nobody_can_measure():
    with pytest.raises(BaggieError, match=re.escape("image_to_robot below `calibrations` in cell.yaml")):
        ObjectFinder(RealFake(), FILE)


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"goal": "card"}, "virtual or turned"),
        ({"scenery": "light"}, "virtual or turned"),
        ({"workers": 2}, "one arm"),
        ({"policy": "oracle"}, "nobody knows the truth"),
        ({"task": "block-pyramid"}, "no --workcell"),
    ],
)
def test_what_a_real_cell_cannot_do_is_refused(tmp_path, asked, said):
    with pytest.raises(BaggieError, match=said):
        replace(options(tmp_path), **asked).check()


def test_a_policy_of_another_camera_is_refused_before_the_first_episode(tmp_path, monkeypatch):
    network = KeypointNet(8, 4, "small")
    view = View((640, 360), 0, 0, 640, 360, (160, 88))
    KeypointPolicy(network, view, 0).save_pretrained(tmp_path / "run")
    opened = calibrated(RealFake(size=(640, 480)))
    monkeypatch.setattr("baggie.workcell.config.open_workcell", lambda _: opened)
    monkeypatch.setattr("baggie.workcell.config.RealWorkcell", RealFake)
    asked = replace(options(tmp_path / "out"), policy=str(tmp_path / "run"))
    with pytest.raises(
        BaggieError, match="trained on pictures of 640 x 360 pixels, but got one of 640 x 480"
    ):
        open_setup(asked)


def test_a_simulated_cell_in_a_file_is_no_real_one(tmp_path):
    file = tmp_path / "cell.yaml"
    file.write_text("arm: sim\n")
    with pytest.raises(BaggieError, match="--cell N"):
        open_setup(replace(options(tmp_path / "out"), workcell=file))
