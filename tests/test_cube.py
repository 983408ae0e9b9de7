"""A hard cube on a table, by an arm and a camera of one's own that a workcell file names: the whole way."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import baggie
from baggie.calibration.files import CameraIdentity
from baggie.calibration.image_to_robot.map import ImageToRobot
from baggie.collect import CollectOptions, collect
from baggie.collect.machine import detect
from baggie.commissioning.image_to_robot import grid
from baggie.data import open_dataset
from baggie.evaluation.closed_loop import EvaluateOptions, evaluate
from baggie.geometry import PlanarPose, Rectangle
from baggie.types import PickPlace
from baggie.workcell.workcell import at_outline
from helpers import cube_world
from helpers.streaming import Here

WORKSPACE = Rectangle(0.35, 0.65, -0.30, 0.30)
CUBE = "bag: {length_m: 0.065, width_m: 0.065, height_m: 0.065, hard: true}\n"


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """A workcell file, and a map that is right on the table, made at two heights."""
    camera = cube_world.CubeCamera(cube_world.CubeWorld())
    robot = grid(WORKSPACE, 0.03, (0.05, 0.15))
    identity = CameraIdentity(camera.name, *camera.size)
    ImageToRobot.fit(camera.project(robot), robot, identity, height_m=0.0).save(tmp_path / "map.yaml")
    path = tmp_path / "cell.yaml"
    path.write_text(
        "arm: {kind: python, factory: 'helpers.cube_world:open_arm'}\n"
        "camera: {kind: python, factory: 'helpers.cube_world:open_camera'}\n"
        f"calibrations: {{image_to_robot: map.yaml}}\n{CUBE}"
    )
    return path


def test_it_is_collected_and_evaluated(file: Path, tmp_path: Path) -> None:
    out = tmp_path / "data"
    summary = collect(CollectOptions(out=out, workcell=file, attempts=12, seed=1, workers=1), executor=Here())
    recorded = open_dataset(out)
    assert summary["succeeded"] == 12
    assert recorded.settings.robot_type == "cube arm"
    first = recorded[0].outcome
    assert first.tries == 2, "at 45 degrees a hand that stays square misses once"
    assert max(cube_world.WORLD.landed) < 0.06, "it is set down gently"
    assert not cube_world.WORLD.in_hand
    for attempt in list(recorded)[1:]:
        assert attempt.outcome.tries == 1
        assert attempt.outcome.grasp_width_m == pytest.approx(0.065)

    metrics = evaluate(
        EvaluateOptions(policy="color-mask", out=tmp_path / "judged", workcell=file, episodes=5, film=0),
        executor=Here(),
    )
    assert metrics["success"]["rate"] == 1.0
    assert metrics["distance_cm"]["max"] < 1
    assert metrics["robot"] == "cube arm"


def test_it_is_found_where_it_is(file: Path) -> None:
    cell = baggie.open_workcell(file)
    known = cell.calibrations.image_to_robot
    assert known is not None
    to_robot = at_outline(known, cell.settings)
    rng, off = np.random.default_rng(0), []
    for _ in range(20):
        x, y = WORKSPACE.sample(rng, 0.04)
        cube_world.WORLD.cube = PlanarPose(float(x), float(y), rng.uniform(-math.pi, math.pi))
        found = detect(cell.look(), to_robot, cell.settings)
        assert found is not None
        off.append(found[1].distance(cube_world.WORLD.cube))
    assert np.mean(off) < 0.002
    cell.close()


def test_a_run_that_was_ended_with_it_in_the_hand_puts_it_down(file: Path) -> None:
    cell = baggie.open_workcell(file)
    world = cube_world.WORLD
    for pose in (cube_world.CubeWorld().cube, world.cube):
        cell.arm.move_to(pose.at_height(0.145), 0.3)
    cell.arm.lower_until_contact(cell.settings.handling.pick_z_m, 0.05, 10.0)
    cell.arm.grasp(10.0)
    cell.arm.move_to(world.cube.at_height(0.2), 0.3)
    assert world.in_hand
    cell.reset((0,))
    assert not world.in_hand
    assert world.bottom == 0.0
    outcome = cell.execute(PickPlace(world.cube, PlanarPose(0.45, -0.15)))
    assert outcome.success
    cell.close()
