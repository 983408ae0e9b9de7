"""A recording plays through the same loop as a live table."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from baggie.calibration.intrinsics.camera_calibration import CameraCalibration
from baggie.cameras.camera import check_camera
from baggie.data import Dataset, DatasetWriter, open_dataset
from baggie.errors import BaggieError, CalibrationError, CameraError, LimitError, ReachError
from baggie.evaluation.setup import open_setup
from baggie.geometry import PlanarPose, Rectangle
from baggie.options.evaluating import EvaluateOptions
from baggie.robot.arm import Arm
from baggie.types import PickPlace, Plan
from baggie.workcell.config import open_workcell
from baggie.workcell.replay import ReplayWorkcell
from baggie.workcell.workcell import Workcell
from helpers.synthetic import (
    BAG_HEIGHT_M,
    BAG_SIDE_M,
    TASK,
    box_corners,
    image_to_robot,
    intrinsics,
    make_attempt,
)

SIZE = (64, 36)
COUNT = 3
SOMEWHERE = PickPlace(PlanarPose(0.5, 0.1), PlanarPose(0.4, -0.1))


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    root = tmp_path_factory.mktemp("replay") / "recording"
    rng = np.random.default_rng(0)
    with DatasetWriter(root, task=TASK, robot_type="drawn", picture_size=SIZE, collection={}) as writer:
        for i in range(COUNT):
            writer.append(make_attempt(i, rng, SIZE, failure="missed-grasp" if i == 1 else None))
    return open_dataset(root)


@pytest.fixture
def cell(recording: Dataset) -> ReplayWorkcell:
    return ReplayWorkcell(recording)


def test_its_camera_keeps_the_contract(cell: ReplayWorkcell) -> None:
    assert isinstance(cell, Workcell)
    assert isinstance(cell.arm, Arm)
    check_camera(cell.camera, live=False)


def test_pictures_and_outcomes_come_as_they_were_recorded(cell: ReplayWorkcell, recording: Dataset) -> None:
    for recorded in recording:
        observation = cell.look()
        np.testing.assert_array_equal(observation.color, recorded.before.color)
        np.testing.assert_array_equal(cell.look().color, recorded.before.color)
        assert cell.clock() == observation.time == recorded.before.time
        assert cell.attempt.attempt_id == recorded.attempt_id
        assert cell.carry_out(Plan(SOMEWHERE)) == recorded.outcome
    with pytest.raises(CameraError, match="all 3 attempts were played"):
        cell.look()


def test_what_no_workcell_does_it_does_not_either(cell: ReplayWorkcell) -> None:
    first = cell.attempt.attempt_id
    with pytest.raises(LimitError):
        cell.execute(PickPlace(PlanarPose(5.0, 0.0), SOMEWHERE.place))
    with pytest.raises(ReachError, match="replayed arm"):
        cell.arm.move_to(SOMEWHERE.pick.at_height(0.3), 0.2)
    assert cell.attempt.attempt_id == first


def test_an_empty_recording_is_refused(recording: Dataset) -> None:
    with pytest.raises(BaggieError, match="got an empty one"):
        ReplayWorkcell(recording[:0])


def test_a_workcell_file_may_name_a_recording(recording: Dataset) -> None:
    path = recording.root.parent / "cell.yaml"
    path.write_text("arm:\n  kind: replay\n  recording: recording\nworkspace:\n  x: [0.3, 0.6]\n")
    cell = open_workcell(path)
    assert cell.settings.workspace == Rectangle(0.3, 0.6, -0.3, 0.3)
    np.testing.assert_array_equal(cell.look().color, recording[0].before.color)


def test_calibrations_of_the_camera_that_took_the_pictures_are_good_for_them(
    recording: Dataset, tmp_path: Path
) -> None:
    """It had larger pictures than are recorded."""
    root = Path(shutil.copytree(recording.root, tmp_path / "recording"))
    own = image_to_robot()
    own.save(root / "calibration" / "image-to-robot.yaml")
    lens = CameraCalibration(own.camera, intrinsics(), None, (), None, None, (), (), (), "", "drawn")
    lens.save(tmp_path / "lens.yaml")
    path = tmp_path / "cell.yaml"
    calibrations = "image_to_robot: recording/calibration/image-to-robot.yaml, intrinsics: lens.yaml"
    path.write_text(
        f"arm: {{kind: replay, recording: recording}}\ncalibrations: {{{calibrations}}}\n"
        f"bag: {{length_m: {BAG_SIDE_M}, width_m: {BAG_SIDE_M}, height_m: {BAG_HEIGHT_M}}}\n"
    )
    cell = open_workcell(path)
    seen = cell.look().intrinsics
    assert seen is not None
    np.testing.assert_allclose(seen.matrix, intrinsics(SIZE).matrix)
    outline = np.roll(cell.outline(SOMEWHERE.pick), 2, axis=0)  # from the same corner on
    np.testing.assert_allclose(outline, box_corners(SOMEWHERE.pick, SIZE), atol=1e-3)

    replace(own, camera=replace(own.camera, name="another")).save(tmp_path / "another.yaml")
    path.write_text(path.read_text().replace("recording/calibration/image-to-robot", "another"))
    with pytest.raises(CalibrationError, match="of camera 'another' at 1280 x 720 pixels, not of 'drawn'"):
        open_workcell(path)


def test_no_policy_is_tried_in_a_recording(recording: Dataset, tmp_path: Path) -> None:
    path = tmp_path / "cell.yaml"
    path.write_text(f"arm: {{kind: replay, recording: {recording.root}}}\n")
    with pytest.raises(BaggieError, match=r"a real arm in .*, got a recording"):
        open_setup(EvaluateOptions("color-mask", tmp_path / "out", workcell=path))
