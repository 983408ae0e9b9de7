"""Cameras of every shape go the whole way: collect, train, validate, evaluate, export, plan."""

import json
from contextlib import closing
from dataclasses import replace
from functools import lru_cache, partial

import numpy as np
import pytest
import torch
import yaml
from hypothesis import given
from hypothesis import strategies as st

from baggie.calibration.files import MAP_FILE, REFERENCE_FILE
from baggie.collect.collect import collect
from baggie.data import DatasetWriter, inspect_dataset, open_dataset
from baggie.data.files import CALIBRATION_FOLDER
from baggie.data.summary import goal_of
from baggie.errors import BaggieError, UsageError
from baggie.evaluation.closed_loop import evaluate
from baggie.evaluation.validate import validate
from baggie.learning import KeypointTraining, train
from baggie.options.collecting import CollectOptions
from baggie.options.commissioning import LabOptions
from baggie.options.evaluating import EvaluateOptions, ExportOptions, ReportOptions, ValidateOptions
from baggie.options.training import TRAININGS
from baggie.pictures import LONGEST_RECORDED, recorded_size, same_shape, write_picture
from baggie.policies import checkpoint, load_policy
from baggie.policies.export import export
from baggie.report.report import report
from baggie.sim.cell import PICTURE_SIZE, draw_cell
from baggie.types import Goal
from baggie.workcell.config import open_workcell
from baggie.workcell.workcell_file import read_workcell_file
from helpers.fake_workcell import FakeCell
from helpers.streaming import Here
from helpers.synthetic import TASK, box_corners, image_to_robot, make_attempt

SHAPES = {(640, 480): (640, 480), (848, 480): (640, 362), (720, 450): (640, 400), (480, 640): (480, 640)}
"""Sizes of cameras' pictures, and those they are recorded at."""
sizes = st.tuples(st.integers(120, 4096), st.integers(120, 4096))


@pytest.fixture(autouse=True)
def _hardly_taught(monkeypatch):
    """Two steps teach no network to be sure of what it sees; where a picture leads is told by any."""
    torch.set_num_threads(1)
    monkeypatch.setattr("baggie.policies.planning._IN_SIGHT", 0.0)


def open_shape(_number, size):
    return FakeCell(size=size, scatter_m=0.002)


def options(data, out, policy="keypoint", **changes):
    given = {"train": 6, "val": 2, "steps": 2, "device": "cpu", "save_every_s": 1e3}
    return TRAININGS[policy](data=data, out=out, **(given | changes))


# --- shapes


@given(sizes)
def test_pictures_are_recorded_in_their_own_shape_and_at_most_640_long(size):
    recorded = recorded_size(size)
    assert max(recorded) == min(max(size), LONGEST_RECORDED)
    assert same_shape(recorded, size)
    assert same_shape(size, recorded)
    assert recorded_size(recorded) == recorded


@given(sizes, sizes)
def test_what_is_more_than_a_pixel_off_is_another_shape(size, other):
    off = abs(size[0] / size[1] - other[0] / other[1]) * min(size[1], other[1])
    assert same_shape(size, other) == same_shape(other, size)
    if off > 2 * max(1.0, size[0] / size[1]):
        assert not same_shape(size, other)


@pytest.mark.parametrize("squeezed", [(640, 360), (320, 480)])
def test_a_map_of_squeezed_pictures_leads_to_the_same_places(squeezed):
    full = image_to_robot()
    pixels = full.to_pixels([[0.4, -0.2], [0.6, 0.1]])
    factors = np.divide(squeezed, full.camera.size)
    there = full.squeezed(squeezed)
    np.testing.assert_allclose(
        there.to_robot((pixels + 0.5) * factors - 0.5), full.to_robot(pixels), atol=1e-9
    )
    np.testing.assert_allclose(there.std_mm_at([[0.5, 0.0]]), full.std_mm_at([[0.5, 0.0]]), rtol=1e-6)


# --- a camera of that shape


@pytest.fixture(scope="module")
def recordings(tmp_path_factory):
    """By the size of the camera's pictures."""

    @lru_cache
    def record(size):
        out = tmp_path_factory.mktemp("recordings") / "night"
        options = CollectOptions(out=out, attempts=10, workers=1)
        collect(options, partial(open_shape, size=size), executor=Here())
        return out

    return record


shapes = pytest.mark.parametrize("size", SHAPES, ids=lambda size: f"{size[0]}x{size[1]}")


@shapes
def test_a_recording_keeps_the_cameras_shape(recordings, size):
    recording = recordings(size)
    dataset = open_dataset(recording)
    assert dataset[0].before.size == dataset.settings.picture_size == SHAPES[size]
    assert dataset.camera_size == size
    assert not dataset.squeezed
    assert "squeezed" not in inspect_dataset(recording)


@pytest.mark.parametrize(
    ("policy", "size"),
    [
        *(("keypoint", size) for size in SHAPES),
        ("transporter", (848, 480)),
        pytest.param("regression", (848, 480), marks=pytest.mark.slow),
    ],
)
def test_each_policy_goes_the_whole_way(recordings, size, policy, tmp_path):
    recording = recordings(size)
    train(options(recording, tmp_path / "run", policy=policy), None)
    metrics = validate(ValidateOptions(str(tmp_path / "run"), recording, tmp_path / "validation"))
    assert metrics["held_out"]["attempts"] == 2
    cell, small = open_shape(0, size), open_dataset(recording)[0]
    goal = goal_of(small).scaled(*np.divide(size, SHAPES[size]))
    run = load_policy(tmp_path / "run")
    plans = [run.plan(cell.look(), goal)]
    if policy != "transporter":
        export(ExportOptions(str(tmp_path / "run"), tmp_path / "exported"))
        cell.reset((0,))
        plans.append(load_policy(tmp_path / "exported").plan(cell.look(), goal))
        assert plans[0].action.pick.distance(plans[1].action.pick) < 1e-3
    with pytest.raises(
        BaggieError, match=rf"trained on pictures of {size[0]} x {size[1]} pixels, .* another camera"
    ):
        run.plan(FakeCell(size=(500, 300)).look(), Goal([[200, 100], [220, 100], [220, 120]]))


@shapes
def test_the_colour_mask_is_right_in_every_shape(recordings, size, tmp_path, below):
    metrics = validate(ValidateOptions("color-mask", recordings(size), tmp_path, last=8))
    below("pick (cm)", metrics["truth"]["pick_error_cm"]["max"], 0.6)


def test_another_camera_cannot_go_on_with_a_recording(recordings):
    recording = recordings((640, 480))
    options = CollectOptions(out=recording, attempts=14, workers=1)
    with pytest.raises(BaggieError, match="as when this recording was calibrated, got one of 500 x 300"):
        collect(options, partial(open_shape, size=(500, 300)), executor=Here())


# --- nights that an older version squeezed


@pytest.fixture(scope="module")
def squeezed(tmp_path_factory):
    """Pictures of 640 x 480, recorded at 640 x 360."""
    out, rng = tmp_path_factory.mktemp("recordings") / "squeezed", np.random.default_rng(5)
    with DatasetWriter(out, task=TASK, robot_type="drawn") as writer:
        for number in range(12):
            writer.append(make_attempt(number, rng, (640, 480), depth=False))
    image_to_robot((640, 480)).save(out / CALIBRATION_FOLDER / MAP_FILE)
    return out


def test_a_squeezed_recording_says_so(squeezed):
    assert open_dataset(squeezed).squeezed
    assert inspect_dataset(squeezed)["squeezed"]
    assert inspect_dataset(squeezed)["camera_size"] == [640, 480]


def drawn(size):
    """A picture with a bag in it, and a goal."""
    attempt = make_attempt(3, np.random.default_rng(9), size, depth=False)
    return attempt.before, Goal(box_corners(attempt.truth.after, size))


@pytest.mark.parametrize(
    "policy", ["keypoint", "transporter", pytest.param("regression", marks=pytest.mark.slow)]
)
def test_a_policy_squeezes_as_its_recording_did(squeezed, policy, tmp_path, capsys):
    train(options(squeezed, tmp_path / "run", policy=policy, train=10))
    assert "of 640 x 480 were squeezed to 640 x 360" in " ".join(capsys.readouterr().err.split())
    assert (
        validate(ValidateOptions(str(tmp_path / "run"), squeezed, tmp_path / "out"))["held_out"]["attempts"]
        == 2
    )
    run, (picture, goal) = load_policy(tmp_path / "run"), drawn((640, 480))
    recorded = replace(picture.resized(640, 360), intrinsics=None)
    native, alike = run.plan(picture, goal), run.plan(recorded, goal.scaled(1.0, 0.75))
    np.testing.assert_allclose(native.action.to_array(), alike.action.to_array(), atol=1e-9)
    with pytest.raises(BaggieError, match="another camera"):
        run.plan(*drawn((1280, 720)))


def test_an_older_policy_squeezes_as_the_picture_beside_it_says(squeezed, tmp_path):
    """Of older versions: nothing in the config tells the camera's size, but what a watch compares with is kept."""
    picture, goal = drawn((640, 480))
    train(options(squeezed, tmp_path))
    then = load_policy(tmp_path).plan(picture, goal)
    config = yaml.safe_load((tmp_path / checkpoint.CONFIG).read_text())
    del config["camera_size"]
    (tmp_path / checkpoint.CONFIG).write_text(yaml.safe_dump(config))
    with pytest.raises(
        BaggieError, match="trained on pictures of 640 x 360 pixels, but got one of 640 x 480"
    ):
        load_policy(tmp_path).plan(picture, goal)
    write_picture(tmp_path / REFERENCE_FILE, picture.color)
    assert load_policy(tmp_path).plan(picture, goal).action == then.action
    assert train(options(squeezed, tmp_path))["steps"] == 2  # taken for the same training


def test_the_colour_mask_is_right_on_squeezed_pictures(squeezed, tmp_path, below):
    from baggie.policies.baselines import ColorMaskPolicy

    ColorMaskPolicy(image_to_robot((640, 480)), (200, 40, 40)).save(squeezed / CALIBRATION_FOLDER)
    metrics = validate(ValidateOptions("color-mask", squeezed, tmp_path))
    below("pick (cm)", metrics["truth"]["pick_error_cm"]["max"], 0.6)


def test_an_older_recording_goes_on_as_it_was_begun(tmp_path, capsys):
    """Squeezed as before: pictures of two shapes in one recording would be of no use."""
    options, opened = (
        CollectOptions(out=tmp_path, attempts=1, workers=1),
        partial(open_shape, size=(640, 480)),
    )
    collect(options, opened, executor=Here())
    settings = json.loads((tmp_path / "attempts/collection.json").read_text())
    assert settings["picture_size"] == [640, 480]
    (tmp_path / "attempts/collection.json").write_text(json.dumps(settings | {"picture_size": [640, 360]}))
    for part in ("attempts/chunk-000", "data", "meta"):  # as if it had just been begun
        for path in (tmp_path / part).rglob("*.*"):
            path.unlink()
    collect(options, opened, executor=Here())
    assert open_dataset(tmp_path)[0].before.size == (640, 360)
    assert "are squeezed to 640 x 360, as they were when this" in " ".join(capsys.readouterr().err.split())


# --- the simulator's


def test_a_simulated_camera_of_another_shape_sees_as_wide():
    usual, other = draw_cell(7), draw_cell(7, (640, 480))
    assert usual.lens.size == PICTURE_SIZE
    assert other.lens.size == (640, 480)
    np.testing.assert_array_equal(other.T_camera_base, usual.T_camera_base)
    np.testing.assert_array_equal(other.lens.intrinsics.distortion, usual.lens.intrinsics.distortion)
    assert other.lens.intrinsics.matrix[0, 0] == pytest.approx(usual.lens.intrinsics.matrix[0, 0] / 2)
    corners = np.array([[0.35, -0.3, 0.0], [0.65, 0.3, 0.0]])
    assert other.project(corners)[:, 0] == pytest.approx(usual.project(corners)[:, 0] / 2, abs=0.5)


@pytest.mark.parametrize("size", [(100, 480), (640, 5000)])
def test_a_simulated_camera_has_bounds(size):
    with pytest.raises(BaggieError, match=rf"sides of 120 to 4096 pixels, got {size[0]} x {size[1]}"):
        draw_cell(0, size)


@pytest.mark.parametrize(("known", "camera"), [([2048, 1536], (2048, 1536)), ([640, 360], PICTURE_SIZE)])
def test_a_policy_is_evaluated_with_its_own_camera(known, camera, tmp_path):
    from baggie.evaluation.setup import camera_size

    config = {"policy": "keypoint", "cell": 0, "picture_size": [640, 360], "camera_size": known}
    (tmp_path / checkpoint.CONFIG).write_text(yaml.safe_dump(config))
    assert camera_size(EvaluateOptions(str(tmp_path), tmp_path)) == camera


def test_a_workcell_file_says_how_large_a_simulated_cameras_pictures_are(tmp_path):
    path = tmp_path / "cell.yaml"
    path.write_text("cell: 3\ncamera: {width: 320, height: 240}\n")
    with closing(open_workcell(path)) as cell:
        assert cell.camera.size == cell.look().size == (320, 240)
    path.write_text("cell: 3\n")
    assert read_workcell_file(path).picture_size == PICTURE_SIZE


@pytest.mark.parametrize("words", ["640", "640x", "640x480x3", "x480", "-640x480", "640 x 480", "wide"])
def test_a_labs_camera_is_so_many_pixels_wide_and_high(words):
    assert LabOptions(size="848x480").picture_size() == (848, 480)
    with pytest.raises(
        UsageError, match=rf"expected --size WIDTHxHEIGHT, in pixels, got {words}; try 640x480"
    ):
        LabOptions(size=words).check()


@pytest.mark.slow
@pytest.mark.parametrize("size", [(640, 480), (848, 480), (1280, 800), (2048, 1536)])
def test_a_night_in_the_simulator_is_worth_as_much_in_every_shape(size, tmp_path, below, monkeypatch):
    monkeypatch.undo()
    workcell, night, run = tmp_path / "cell.yaml", tmp_path / "night", tmp_path / "run"
    workcell.write_text(f"cell: 7\ncamera: {{width: {size[0]}, height: {size[1]}}}\n")
    collect(CollectOptions(out=night, attempts=75, cell=7, workcell=workcell))
    train(KeypointTraining(data=night, out=run, train=50, val=15, device="cpu"))
    metrics = validate(ValidateOptions(str(run), night, run / "validation"))
    below("pick (cm)", metrics["truth"]["pick_error_cm"]["mean"], 0.5)
    metrics = evaluate(EvaluateOptions(str(run), run / "evaluation", episodes=6, cell=7))
    below("median distance (cm)", metrics["distance_cm"]["median"], 1.5)
    assert report(ReportOptions((run,), tmp_path / "report.html")).exists()
