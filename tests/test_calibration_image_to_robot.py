import functools
from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from baggie.calibration.files import CameraIdentity
from baggie.calibration.image_to_robot.map import ImageToRobot, compare_maps
from baggie.calibration.image_to_robot.residuals import draw_comparison, draw_residuals, lattice
from baggie.commissioning.image_to_robot import calibrate, grid
from baggie.errors import BaggieError, CalibrationError, DataError
from baggie.geometry import Rectangle, apply_homography, wrap_angle
from baggie.policies.keypoint.policy import KeypointNet, KeypointPolicy, as_calibration
from baggie.policies.planning import View
from baggie.sim.cell import draw_cell
from baggie.types import Intrinsics
from baggie.vision.color_mask import find_bag
from helpers.fake_workcell import FakeCell

CAMERA = CameraIdentity("top", 1280, 720)
WORKSPACE = Rectangle(0.35, 0.65, -0.30, 0.30)
TWO_HEIGHTS, ONE_HEIGHT = (0.05, 0.15), (0.05,)
ON_TABLE = lattice(WORKSPACE, 5, 9)
PINHOLE = Intrinsics(1280, 720, np.array([[800.0, 0, 650], [0, 800.0, 350], [0, 0, 1]]), np.zeros(0))


def points(heights=TWO_HEIGHTS):
    return grid(WORKSPACE, 0.03, heights)


def seen(number, robot, noise_px=0.0, seed=0):
    return draw_cell(number).project(robot) + np.random.default_rng([number, seed]).normal(
        0, noise_px, (len(robot), 2)
    )


@functools.cache
def fitted(number=0, heights=TWO_HEIGHTS, known=False, noise_px=0.2, height_m=None):
    robot = points(heights)
    lens = draw_cell(number).lens.intrinsics if known else None
    return ImageToRobot.fit(seen(number, robot, noise_px), robot, CAMERA, intrinsics=lens, height_m=height_m)


def errors_m(image_to_robot, number=0, height=0.0):
    """Where the map places points of the table, less where they are: `(N, 2)`."""
    pixels = draw_cell(number).project(np.c_[ON_TABLE, np.full(len(ON_TABLE), height)])
    at = image_to_robot.at_height(height)
    return at.to_robot(pixels) - ON_TABLE


def squared_distance(image_to_robot, number=0):
    """Mahalanobis, of the errors on the table, by the map's own covariance there: `(N,)`."""
    error, covariance = errors_m(image_to_robot, number), image_to_robot.covariance_at(ON_TABLE)
    return np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariance), error)


def rms_mm(errors):
    return 1000 * np.sqrt((errors**2).sum(axis=1).mean())


# recovery of a known truth


@pytest.mark.parametrize("heights", [ONE_HEIGHT, TWO_HEIGHTS])
def test_exact_points_and_a_known_lens_give_an_exact_map_at_every_height(heights):
    for number in range(3):
        exact = fitted(number, heights, known=True, noise_px=0.0)
        assert (exact.lens_origin, exact.height_aware) == ("calibrated", True)
        for height in (0.0, 0.03, 0.2):
            assert np.abs(errors_m(exact, number, height)).max() < 1e-8


@pytest.mark.parametrize(
    ("heights", "known"), [(TWO_HEIGHTS, True), (ONE_HEIGHT, True), (TWO_HEIGHTS, False), (ONE_HEIGHT, False)]
)
def test_noisy_points_give_the_map_to_the_millimetre_in_every_cell(heights, known):
    at = (0.0, 0.015) if known or len(heights) == 2 else ONE_HEIGHT
    for number in range(8):
        noisy = fitted(number, heights, known, noise_px=0.3)
        for height in at:
            assert rms_mm(errors_m(noisy, number, height)) < 1.5


def test_a_lens_is_estimated_where_points_justify_it_and_nowhere_else():
    robot, T_camera_base = points(), draw_cell(0).T_camera_base
    in_camera = (np.c_[robot, np.ones(len(robot))] @ T_camera_base.T)[:, :3]
    bent = replace(PINHOLE, distortion=np.array([0.15, 0.0, 0.0, 0.0]))
    origins = []
    for seed in range(6):
        noise = np.random.default_rng([1, seed]).normal(0, 0.2, (len(robot), 2))
        straight = ImageToRobot.fit(PINHOLE.project(in_camera) + noise, robot, CAMERA)
        estimated = ImageToRobot.fit(bent.project(in_camera) + noise, robot, CAMERA)
        assert estimated.lens_origin == "estimated"
        assert estimated.residuals.leave_one_out_mm < 1.2 * straight.residuals.leave_one_out_mm
        origins.append(straight.lens_origin)
    assert origins.count("none") >= 5


def test_wrong_detections_are_dropped_and_cost_little():
    clean, dirty = [], []
    for number in range(5):
        robot, rng = points(), np.random.default_rng([number, 5])
        pixels = seen(number, robot, 0.2)
        clean.append(rms_mm(errors_m(ImageToRobot.fit(pixels, robot, CAMERA), number)))
        wrong = rng.choice(len(robot), 5, replace=False)
        pixels[wrong] += rng.uniform(10, 60, (5, 2)) * rng.choice([-1, 1], (5, 2))
        spoiled = ImageToRobot.fit(pixels, robot, CAMERA)
        assert not spoiled.residuals.kept[wrong].any()
        assert spoiled.residuals.kept.sum() >= len(robot) - 6
        dirty.append(rms_mm(errors_m(spoiled, number)))
    assert np.mean(dirty) < 2 * np.mean(clean)


@pytest.mark.parametrize("known", [True, False])
def test_the_order_of_the_points_makes_no_difference(known):
    robot, order = points(), np.random.default_rng(3).permutation(24)
    pixels = seen(0, robot, 0.2)
    pixels[4] += 30
    lens = draw_cell(0).lens.intrinsics if known else None
    a = ImageToRobot.fit(pixels, robot, CAMERA, intrinsics=lens)
    b = ImageToRobot.fit(pixels[order], robot[order], CAMERA, intrinsics=lens)
    assert np.allclose(a.to_robot(pixels), b.to_robot(pixels), atol=1e-9, rtol=0)
    assert np.array_equal(a.residuals.kept[order], b.residuals.kept)
    assert np.allclose(a.residuals.left_out_mm[order], b.residuals.left_out_mm, atol=1e-6)


# what it says of itself


@pytest.mark.parametrize(("heights", "known"), [(TWO_HEIGHTS, True), (ONE_HEIGHT, False)])
def test_left_out_residuals_are_those_of_fits_to_the_other_points(heights, known):
    full, robot = fitted(0, heights, known), points(heights)
    pixels, lens = seen(0, robot, 0.2), full.lens if known else None
    for i in (0, 5, 10):
        others = np.arange(len(robot)) != i
        refit = ImageToRobot.fit(pixels[others], robot[others], CAMERA, intrinsics=lens)
        error = 1000 * (refit.at_height(robot[i, 2]).to_robot(pixels[i])[0] - robot[i, :2])
        assert refit.lens.distortion.shape == full.lens.distortion.shape
        assert np.allclose(full.residuals.left_out_mm[i], error, atol=0.05 + 0.05 * np.abs(error).max())


@pytest.mark.parametrize("known", [True, False])
def test_the_truth_is_in_the_95_percent_ellipse_about_as_often_as_it_says(known):
    inside, squared, stated = [], [], []
    for number in range(25):
        image_to_robot = fitted(number, TWO_HEIGHTS, known, height_m=0.0)
        inside.append(squared_distance(image_to_robot, number) < chi2.ppf(0.95, 2))
        squared.append((errors_m(image_to_robot, number) ** 2).sum(axis=1))
        stated.append((image_to_robot.std_mm_at(ON_TABLE) / 1000) ** 2)
    assert 0.90 < np.mean(inside) < 0.995
    assert 0.7 < np.mean(squared) / np.mean(stated) < 1.5


def test_doubt_about_the_lens_becomes_doubt_about_the_map():
    robot, lens = points(), draw_cell(0).lens.intrinsics
    doubt = np.diag([1.0, 1.0, 1.5, 1.5, 4e-3, 4e-3, 3e-4, 3e-4, 2e-3]) ** 2
    rng = np.random.default_rng(0)
    surely, unsurely = [], []
    for _ in range(20):
        wrong = rng.multivariate_normal(np.zeros(9), doubt)
        matrix = lens.matrix.copy()
        matrix[[0, 1, 0, 1], [0, 1, 2, 2]] += wrong[:4]
        used = replace(lens, matrix=matrix, distortion=lens.distortion + wrong[4:])
        pixels = draw_cell(0).project(robot) + rng.normal(0, 0.05, (24, 2))
        sure = ImageToRobot.fit(pixels, robot, CAMERA, intrinsics=used, height_m=0.0)
        unsure = ImageToRobot.fit(
            pixels, robot, CAMERA, intrinsics=used, intrinsics_covariance=doubt, height_m=0.0
        )
        for image_to_robot, squares in ((sure, surely), (unsure, unsurely)):
            squares.append(squared_distance(image_to_robot).mean())
    assert np.mean(surely) > 6  # of the 2 that chi squared has on average
    assert 1 < np.mean(unsurely) < 3


def test_residuals_tell_the_size_of_the_noise():
    robot = np.column_stack(
        [np.random.default_rng(0).uniform([0.35, -0.3], [0.65, 0.3], (200, 2)), np.zeros(200)]
    )
    fine, coarse = (ImageToRobot.fit(seen(0, robot, noise), robot, CAMERA).residuals for noise in (0.2, 0.8))
    assert coarse.rms_mm == pytest.approx(4 * fine.rms_mm, rel=0.2)
    assert fine.rms_mm < fine.leave_one_out_mm < 1.2 * fine.rms_mm
    assert fine.max_mm > fine.rms_mm


# laws of the map


@given(st.floats(0, 1279), st.floats(0, 719), st.floats(0.0, 0.2), st.booleans())
@settings(max_examples=40, deadline=None)
def test_pixel_to_robot_to_pixel_is_the_identity(u, v, height, known):
    at = fitted(0, TWO_HEIGHTS, known).at_height(height)
    assert np.allclose(at.to_pixels(at.to_robot([u, v])), [[u, v]], atol=1e-6)


@given(st.floats(300, 1000), st.floats(150, 600), st.floats(-0.7, 0.7))
@settings(max_examples=40, deadline=None)
def test_yaw_agrees_with_a_small_square_mapped_corner_by_corner(u, v, yaw):
    image_to_robot = fitted()
    steps = np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]]) * 0.01
    edges = image_to_robot.to_robot(steps + np.array([u, v])) - image_to_robot.to_robot([u, v])
    angles = np.arctan2(edges[:, 1], edges[:, 0])
    expected = wrap_angle(float(np.angle(np.exp(4j * angles).sum())) / 4, np.pi / 2)
    assert abs(wrap_angle(image_to_robot.yaw_to_robot([u, v], yaw) - expected, np.pi / 2)) < 1e-3


@pytest.mark.parametrize("heights", [ONE_HEIGHT, TWO_HEIGHTS])
def test_a_resized_picture_gives_the_same_positions_and_doubts(heights):
    full = fitted(0, heights)
    half, pixels = full.for_size((640, 360)), seen(0, points(heights))
    assert half.camera == CameraIdentity("top", 640, 360)
    assert np.allclose(half.to_robot((pixels + 0.5) / 2 - 0.5), full.to_robot(pixels), atol=1e-9)
    assert np.allclose(half.covariance_at(ON_TABLE), full.covariance_at(ON_TABLE), rtol=1e-6)
    with pytest.raises(CalibrationError, match="1280 x 720"):
        full.for_size((640, 480))


def test_a_homography_stays_at_its_height():
    flat = fitted(0, ONE_HEIGHT)
    assert not flat.height_aware
    assert flat.at_height(0.0501) is flat
    with pytest.raises(CalibrationError, match=r"one height only.*second height"):
        flat.at_height(0.0)
    with pytest.raises(CalibrationError, match="one height only"):
        fitted(0, ONE_HEIGHT, height_m=0.015)


def test_a_line_of_sight_that_misses_the_table_leads_nowhere():
    robot = points()
    level = np.array([[0, -1.0, 0, 0], [0, 0, -1.0, 0.3], [1.0, 0, 0, 1.0]])  # looks along the table
    pixels = PINHOLE.project(np.c_[robot, np.ones(len(robot))] @ level.T)
    image_to_robot = ImageToRobot.fit(pixels, robot, CAMERA, intrinsics=PINHOLE, height_m=0.0)
    assert np.isnan(image_to_robot.to_robot([[640.0, 300.0]])).all()
    assert np.isfinite(image_to_robot.to_robot([[640.0, 400.0]])).all()


# refusals


def few(pixels, robot):
    return pixels[:5], robot[:5]


def few_for_two_heights(pixels, robot):
    chosen = [0, 3, 8, 12, 15, 20, 23]
    return pixels[chosen], robot[chosen]


def on_one_line_of_the_workspace(pixels, robot):
    return pixels, np.c_[robot[:, 0], robot[:, 0], robot[:, 2]]


def on_one_line_of_the_picture(pixels, robot):
    return np.c_[pixels[:, 0], pixels[:, 0]], robot


def mirrored(pixels, robot):
    return [1279, 0] + pixels * [-1, 1], robot


def swapped(pixels, robot):
    return pixels, robot[:, [1, 0, 2]]


def shuffled(pixels, robot):
    return np.random.default_rng(0).permutation(pixels), robot


def with_nan(pixels, robot):
    return np.where(np.arange(24)[:, None] == 3, np.nan, pixels), robot


def at_heights_too_close(pixels, robot):
    return pixels, robot * [1, 1, 0.1]


def on_a_slope(pixels, robot):
    return pixels, np.c_[robot[:, :2], robot[:, 0]]


@pytest.mark.parametrize(
    ("spoil", "match"),
    [
        (few, "at least 6 pairs.*collect more"),
        (few_for_two_heights, "at least 8 pairs.*collect more"),
        (on_one_line_of_the_workspace, "one line.*sideways"),
        (on_one_line_of_the_picture, "one line.*sideways"),
        (mirrored, "mirrored"),
        (swapped, "swapped"),
        (shuffled, "agree|mirrored"),
        (with_nan, "NaN"),
        (at_heights_too_close, "3 cm apart"),
        (on_a_slope, "3 cm apart"),
    ],
)
def test_points_that_cannot_tell_are_refused_in_one_line(spoil, match):
    robot = points()
    with pytest.raises(CalibrationError, match=match) as caught:
        ImageToRobot.fit(*spoil(seen(0, robot, 0.2), robot), CAMERA)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("heights", [ONE_HEIGHT, TWO_HEIGHTS])
@pytest.mark.parametrize("spoil", [mirrored, swapped])
def test_a_known_lens_does_not_hide_a_mirrored_picture(spoil, heights):
    robot = points(heights)
    pixels, robot = spoil(seen(0, robot), robot)
    with pytest.raises(CalibrationError, match="mirrored"):
        ImageToRobot.fit(pixels, robot, CAMERA, intrinsics=draw_cell(0).lens.intrinsics)


def test_points_that_hardly_agree_are_refused_by_the_limit():
    robot = points()
    pixels = seen(0, robot, 6.0)
    with pytest.raises(CalibrationError, match=r"within 5\.0 mm.*check"):
        ImageToRobot.fit(pixels, robot, CAMERA)
    assert ImageToRobot.fit(pixels, robot, CAMERA, limit_mm=50).residuals.leave_one_out_mm > 5


def test_intrinsics_of_another_size_are_refused():
    robot, small = points(), draw_cell(0).lens.intrinsics.scaled(640, 360)
    with pytest.raises(CalibrationError, match=r"1280 x 720.*640 x 360"):
        ImageToRobot.fit(seen(0, robot), robot, CAMERA, intrinsics=small)


# on disk


@pytest.mark.parametrize(
    ("heights", "known"), [(TWO_HEIGHTS, True), (TWO_HEIGHTS, False), (ONE_HEIGHT, False)]
)
def test_save_and_load_keep_every_bit(tmp_path, heights, known):
    path, saved = tmp_path / "calibration" / "map.yaml", fitted(1, heights, known)
    saved = replace(saved, pictures=("000.png", "001.png"), made_on="2024-02-03")
    saved.save(path)
    loaded = ImageToRobot.load(path, CAMERA)
    for name in ("camera", "lens_origin", "height_m", "heights_m", "area", "pictures", "made_on"):
        assert getattr(loaded, name) == getattr(saved, name)
    for name in ("projection", "covariance"):
        assert np.array_equal(getattr(loaded, name), getattr(saved, name))
    for name in ("points", "error_mm", "left_out_mm", "kept"):
        assert np.array_equal(getattr(loaded.residuals, name), getattr(saved.residuals, name))
    pixels = seen(1, points(heights))
    assert np.array_equal(loaded.to_robot(pixels), saved.to_robot(pixels))
    assert loaded.summary() == saved.summary()
    for word in (
        "frame",
        "units",
        "made_on",
        "camera",
        "std_mm",
        "projection" if len(heights) == 2 else "homography",
    ):
        assert f"\n{word}:" in path.read_text()


@pytest.mark.parametrize("other", [CameraIdentity("side", 1280, 720), CameraIdentity("top", 640, 360)])
def test_a_map_of_another_camera_or_size_is_refused(tmp_path, other):
    fitted().save(tmp_path / "map.yaml")
    with pytest.raises(CalibrationError, match=r"map\.yaml"):
        ImageToRobot.load(tmp_path / "map.yaml", other)


@pytest.mark.parametrize(
    "content", [None, "", "kind: something else", "kind: image-to-robot\nhomography: [1, 2]", "a: [b"]
)
def test_a_missing_or_broken_file_is_one_clear_line(tmp_path, content):
    path = tmp_path / "map.yaml"
    if content is not None:
        path.write_text(content)
    with pytest.raises(DataError, match=r"map\.yaml") as caught:
        ImageToRobot.load(path)
    assert "\n" not in str(caught.value)


# two maps


def shifted(by_m, heights=TWO_HEIGHTS, robot_area=WORKSPACE):
    robot = grid(robot_area, 0.03, heights)
    return ImageToRobot.fit(draw_cell(0).project(robot), robot + np.array([*by_m, 0.0]), CAMERA)


def test_a_comparison_tells_what_was_shifted():
    a, b = shifted((0.0, 0.0)), shifted((0.002, -0.001))
    same, other = compare_maps(a, a), compare_maps(a, b, WORKSPACE)
    assert same.max_mm < 1e-6
    assert np.allclose(other.shift_mm, [2.0, -1.0], atol=0.05)
    assert other.rms_mm == pytest.approx(np.sqrt(5), abs=0.05)
    assert other.area == WORKSPACE


def test_maps_are_compared_at_a_height_both_know_and_in_pictures_of_any_size():
    space, flat = fitted(known=True), fitted(heights=ONE_HEIGHT)
    for a, b in ((space.at_height(0.2), flat), (flat, space.at_height(0.2))):
        comparison = compare_maps(a.for_size((640, 360)), b)
        assert comparison.height_m == 0.05
        assert comparison.rms_mm < 0.6
    with pytest.raises(CalibrationError, match="one height only"):
        compare_maps(flat, fitted(heights=(0.15,)))
    elsewhere = shifted((0.0, 0.0), robot_area=Rectangle(0.7, 0.9, -0.3, 0.3))
    with pytest.raises(CalibrationError, match="one area"):
        compare_maps(space, elsewhere)


def test_pictures_are_drawn_and_show_dropped_points(tmp_path):
    def red(path):
        picture = cv2.imread(str(path)).astype(int)
        return int(((picture[..., 2] > 190) & (picture[..., :2].max(axis=2) < 70)).sum())

    robot, pixels = points(), seen(0, points(), 0.2)
    draw_residuals(fitted(), tmp_path / "clean.png")
    pixels[[3, 17]] += 25
    draw_residuals(ImageToRobot.fit(pixels, robot, CAMERA), tmp_path / "dropped.png")
    assert red(tmp_path / "dropped.png") > red(tmp_path / "clean.png") == 0
    draw_comparison(compare_maps(fitted(), fitted(known=True)), tmp_path / "comparison.png")
    assert cv2.imread(str(tmp_path / "comparison.png")).shape[1] > 500
    with pytest.raises(DataError, match="cannot be written"):
        draw_residuals(fitted(), tmp_path / "clean.png" / "below.png")


# a policy's map


def keypoint_policy(number=0):
    size, cell = (640, 360), draw_cell(number)
    robot = np.c_[lattice(WORKSPACE, 12, 20), np.full(240, 0.015)]
    pixels = (cell.project(robot) + 0.5) / 2 - 0.5
    policy = KeypointPolicy(KeypointNet(8), View.around(pixels, size), cell=number)
    normalized = apply_homography(policy.view.normalize(), pixels)
    policy.network.to_robot.fit(normalized, robot[:, :2])
    return policy


def test_a_learned_map_becomes_a_calibration_and_can_be_compared():
    policy = keypoint_policy()
    learned = as_calibration(policy, 0.015)
    pixels = seen(0, np.c_[ON_TABLE, np.full(len(ON_TABLE), 0.015)]) / 2 - 0.25
    with torch.no_grad():
        normalized = apply_homography(policy.view.normalize(), pixels)
        own = policy.network.to_robot(torch.from_numpy(normalized).float()).double().numpy()
    assert np.abs(learned.to_robot(pixels) - own).max() < 2e-4
    assert (learned.height_m, learned.camera.size) == (0.015, (640, 360))
    true = fitted(known=True, noise_px=0.0)
    assert compare_maps(true, learned).rms_mm < 0.5
    with torch.no_grad():
        policy.network.to_robot.lift.copy_(torch.tensor([0.01, 0.002, 0.022]))
    from_stacks = as_calibration(policy, 0.015)
    np.testing.assert_array_equal(from_stacks.to_robot(pixels), learned.to_robot(pixels))  # on the table


def test_an_untrained_map_is_no_calibration():
    size = (640, 360)
    policy = KeypointPolicy(KeypointNet(8), View(size, 100, 50, 500, 300, (160, 96)), cell=0)
    with pytest.raises(CalibrationError):
        as_calibration(policy, 0.015)


# the collector's


@pytest.mark.parametrize("known", [True, False])
def test_a_calibrated_cell_finds_its_bag_to_three_millimetres(known):
    cell = FakeCell(size=(640, 360))
    camera = cell.camera
    cell.camera = SimpleNamespace(
        name="top", size=camera.size, look=camera.look, intrinsics=camera.intrinsics if known else None
    )
    image_to_robot = calibrate(cell, seed=0)
    assert image_to_robot.height_aware
    assert image_to_robot.height_m == cell.settings.object_size_m[2] / 2
    assert image_to_robot.residuals.leave_one_out_mm < 1.0
    errors = []
    for scene in range(8):
        cell.reset((7, scene))
        found = find_bag(cell.look().color, cell.settings.object_color)
        assert found is not None
        errors.append(np.linalg.norm(image_to_robot.to_robot(found.center)[0] - cell.bag.xy))
    assert np.median(errors) < 0.003
    again = calibrate(cell, seed=0)
    assert np.array_equal(again.projection, image_to_robot.projection)


def test_a_cell_without_its_marker_cannot_be_calibrated():
    cell = FakeCell(size=(640, 360))
    cell.show_paddle = lambda shown: None
    with pytest.raises(
        BaggieError, match=r"marker in most of 24 places .* saw it in 0: see that the hand has it"
    ):
        calibrate(cell, seed=0)
