import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from baggie.calibration.homography import HeightOffset, ImageToRobot, offset_to_height
from baggie.collect.calibrate import calibrate
from baggie.collect.points import collect_points, grid
from baggie.errors import BaggieError, DataError
from baggie.geometry import apply_homography, wrap_angle
from baggie.vision.color_mask import find_bag
from baggie.workcell.workcell import WorkcellSettings
from fake_workcell import FakeCamera, FakeCell

SIZE = (640, 360)
TRUE = np.array([[2e-5, 9e-4, 0.31], [9.5e-4, -3e-5, -0.33], [1e-5, 6e-5, 1.0]])
WORKSPACE = WorkcellSettings().workspace


def pixels(count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform([100, 40], [540, 320], (count, 2))


def fitted() -> ImageToRobot:
    points = pixels(20)
    return ImageToRobot.fit(points, apply_homography(TRUE, points), SIZE, 0.07)


def test_recovers_a_known_homography():
    new = pixels(50, seed=1)
    assert np.allclose(fitted().to_robot(new), apply_homography(TRUE, new), atol=1e-9)
    assert fitted().residuals.leave_one_out_mm < 1e-3


def test_outliers_are_dropped_and_counted():
    points = pixels(20)
    robot = apply_homography(TRUE, points)
    robot[[3, 11]] += [0.05, -0.04]
    fit = ImageToRobot.fit(points, robot, SIZE, 0.07)
    assert fit.residuals.dropped == 2
    assert np.allclose(fit.to_robot(points), apply_homography(TRUE, points), atol=1e-6)


def test_residuals_tell_the_size_of_the_noise():
    points = pixels(200)
    robot = apply_homography(TRUE, points) + np.random.default_rng(2).normal(0, 0.001, (200, 2))
    residuals = ImageToRobot.fit(points, robot, SIZE, 0.07).residuals
    assert residuals.rms_mm == pytest.approx(1.414, rel=0.15)
    assert residuals.rms_mm < residuals.leave_one_out_mm < 1.2 * residuals.rms_mm
    assert residuals.max_mm > residuals.rms_mm


@given(st.floats(100, 540), st.floats(40, 320), st.floats(-0.1, 0.1), st.floats(-0.02, 0.02))
@settings(max_examples=40, deadline=None)
def test_pixel_to_robot_to_pixel_is_the_identity(u, v, scale, shift):
    offset = HeightOffset(np.array([shift, -shift]), scale, np.array([0.5, 0.0]), 0.015)
    image_to_robot = fitted().with_offset(offset)
    assert np.allclose(image_to_robot.to_pixels(image_to_robot.to_robot([[u, v]])), [[u, v]], atol=1e-6)


@given(st.floats(150, 500), st.floats(60, 300), st.floats(-0.7, 0.7))
@settings(max_examples=40, deadline=None)
def test_yaw_agrees_with_a_small_square_mapped_corner_by_corner(u, v, yaw):
    image_to_robot = fitted()
    steps = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]]) * 0.01
    center = image_to_robot.to_robot([[u, v]])
    edges = image_to_robot.to_robot(steps + np.array([u, v])) - center
    angles = np.arctan2(edges[:, 1], edges[:, 0])
    expected = wrap_angle(float(np.angle(np.exp(4j * angles).sum())) / 4, np.pi / 2)
    found = image_to_robot.yaw_to_robot([u, v], yaw)
    assert abs(wrap_angle(found - expected, np.pi / 2)) < 1e-3


def test_a_resized_picture_gives_the_same_positions():
    image_to_robot = fitted()
    half = image_to_robot.for_size((320, 180))
    points = pixels(10)
    assert np.allclose(half.to_robot((points + 0.5) / 2 - 0.5), image_to_robot.to_robot(points), atol=1e-12)
    with pytest.raises(BaggieError, match="640 x 360"):
        image_to_robot.for_size((640, 480))


@pytest.mark.parametrize(
    ("points", "match"),
    [(pixels(5), "at least 6"), (np.c_[np.arange(12.0), 2 * np.arange(12.0)], "one line")],
)
def test_too_few_or_collinear_points_are_refused(points, match):
    with pytest.raises(BaggieError, match=match):
        ImageToRobot.fit(points, apply_homography(TRUE, points), SIZE, 0.07)


def test_points_that_do_not_agree_are_refused():
    robot = np.random.default_rng(5).uniform(0.3, 0.6, (12, 2))
    with pytest.raises(BaggieError, match="agree"):
        ImageToRobot.fit(pixels(12), robot, SIZE, 0.07)


def test_save_and_load_keep_every_bit(tmp_path):
    offset = HeightOffset(np.array([0.1 / 3, -1e-3]), 0.05, np.array([0.5, 0.0]), 0.015)
    saved = fitted().with_offset(offset)
    saved.save(tmp_path / "calibration" / "map.yaml")
    loaded = ImageToRobot.load(tmp_path / "calibration" / "map.yaml")
    assert np.array_equal(loaded.matrix, saved.matrix)
    assert (loaded.size, loaded.height_m, loaded.area) == (saved.size, saved.height_m, saved.area)
    assert loaded.residuals == saved.residuals
    assert loaded.offset is not None
    assert loaded.offset.height_m == 0.015
    text = (tmp_path / "calibration" / "map.yaml").read_text()
    assert "height_m" in text
    assert "frame" in text


@pytest.mark.parametrize(
    "content", [None, "", "kind: something else", "kind: image-to-robot\nhomography: [1, 2]"]
)
def test_a_missing_or_broken_file_is_one_clear_line(tmp_path, content):
    path = tmp_path / "map.yaml"
    if content is not None:
        path.write_text(content)
    with pytest.raises(DataError, match=r"map\.yaml") as caught:
        ImageToRobot.load(path)
    assert "\n" not in str(caught.value)


def test_points_collected_with_an_arm_give_a_fit_below_a_millimetre():
    cell = FakeCell(size=SIZE)
    cell.show_paddle(True)
    marker = cell.settings.marker
    found, robot = collect_points(cell.arm, cell.camera, grid(WORKSPACE, 0.03), 0.07, marker)
    assert len(found) == 12
    fit = ImageToRobot.fit(found, robot, cell.camera.size, 0.07)
    assert fit.residuals.leave_one_out_mm < 1.0
    at_height = np.c_[robot, np.full(len(robot), 0.07)]
    assert np.linalg.norm(cell.camera.project(at_height) - fit.to_pixels(robot), axis=1).max() < 1.5


def test_positions_without_a_visible_marker_are_passed_over():
    cell = FakeCell(size=SIZE)  # the paddle is not in the hand
    found, robot = collect_points(
        cell.arm, cell.camera, grid(WORKSPACE, 0.03)[:3], 0.07, cell.settings.marker
    )
    assert found.shape == robot.shape == (0, 2)


def plane_of(camera: FakeCamera, height: float) -> ImageToRobot:
    robot = grid(WORKSPACE, 0.03)
    return ImageToRobot.fit(
        camera.project(np.c_[robot, np.full(len(robot), height)]), robot, camera.size, height
    )


def errors_at(camera: FakeCamera, image_to_robot: ImageToRobot, height: float) -> np.ndarray:
    spots = grid(WORKSPACE, 0.05)
    seen = camera.project(np.c_[spots, np.full(len(spots), height)])
    return np.linalg.norm(image_to_robot.to_robot(seen) - spots, axis=1)


@given(st.floats(0.0, 0.05))
@settings(max_examples=10, deadline=None)
def test_two_heights_tell_the_offset_of_a_third(height):
    camera = FakeCell(size=SIZE).camera
    low, high = plane_of(camera, 0.07), plane_of(camera, 0.20)
    offset = offset_to_height(low, high, height)
    assert np.median(errors_at(camera, low, height)) > 0.002
    assert errors_at(camera, low.with_offset(offset), height).max() < 0.001


def test_a_calibrated_cell_finds_its_bag_to_three_millimetres():
    cell = FakeCell(size=SIZE)
    image_to_robot = calibrate(cell, seed=0)
    errors = []
    for scene in range(12):
        cell.reset((7, scene))
        found = find_bag(cell.look().color, cell.settings.object_color)
        assert found is not None
        errors.append(np.linalg.norm(image_to_robot.to_robot(found.center)[0] - cell.bag.xy))
    assert np.median(errors) < 0.003
    again = calibrate(cell, seed=0)
    assert np.array_equal(again.matrix, image_to_robot.matrix)


def test_a_cell_without_its_marker_cannot_be_calibrated():
    cell = FakeCell(size=SIZE)
    cell.show_paddle = lambda shown: None
    with pytest.raises(BaggieError, match="at least 6"):
        calibrate(cell, seed=0)
