import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image as Pillow
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from baggie.calibration.files import CameraIdentity
from baggie.calibration.intrinsics.camera_calibration import (
    CameraCalibration,
    draw_corner_errors,
    import_intrinsics,
)
from baggie.calibration.intrinsics.fit import (
    CANDIDATES,
    BoardView,
    calibrate_intrinsics_from,
    find_views,
    fit_intrinsics,
    held_out_error,
    is_new,
    next_view,
)
from baggie.calibration.intrinsics.lens import DISTORTION, fit_lens, guessed_lens
from baggie.errors import BaggieError, CalibrationError, DataError
from baggie.geometry import rigid, transform_points
from baggie.pictures import read_pictures
from baggie.types import Intrinsics
from baggie.vision.targets import TargetDetection, parse_target
from helpers.board_pictures import lens_error_px, random_pose, render_board

BOARD = parse_target("charuco:7x5:0.030:0.021:DICT_4X4_50")
SIZE = (1280, 720)
CAMERA = CameraIdentity("bench", *SIZE)
MATRIX = np.array([[950.0, 0, 655], [0, 945, 350], [0, 0, 1]])
TRUE = Intrinsics(*SIZE, MATRIX, np.array([0.08, -0.05, 5e-4, -4e-4, 0.01]))


def parameters(lens):
    return np.concatenate([lens.matrix[[0, 1, 0, 1], [0, 1, 2, 2]], lens.distortion])


def seen_at(pose, rng, noise, lens=TRUE):
    pixels = lens.project(transform_points(pose, BOARD.points))
    return TargetDetection(np.arange(len(pixels)), pixels + rng.normal(0, noise, pixels.shape), BOARD.points)


def views(count, noise=0.1, seed=0, lens=TRUE, tilt=0.6):
    rng = np.random.default_rng(seed)
    poses = [random_pose(BOARD, lens, rng, tilt) for _ in range(count)]
    return [BoardView(f"{i:03d}.png", seen_at(pose, rng, noise, lens)) for i, pose in enumerate(poses)]


def moved(view, pixels):
    return BoardView(view.name, replace(view.seen, pixels=pixels))


def holds(calibration, true):
    free = np.diag(calibration.covariance) > 0
    scale = np.sqrt(np.diag(calibration.covariance)[free])
    error = (parameters(calibration.intrinsics) - parameters(true))[free] / scale
    region = calibration.covariance[np.ix_(free, free)] / np.outer(scale, scale)
    return error @ np.linalg.solve(region, error) < chi2.ppf(0.95, free.sum())


@pytest.fixture(scope="module")
def calibration():
    return fit_intrinsics(views(14), CAMERA, BOARD)


# Recovery


def test_exact_corners_give_the_exact_lens():
    fit = fit_intrinsics(views(8, noise=0), CAMERA, BOARD)
    assert fit.terms == DISTORTION
    assert np.allclose(parameters(fit.intrinsics), parameters(TRUE), atol=1e-6)
    assert fit.held_out_rms_px < 1e-4


@given(
    st.floats(0.6, 1.5),
    st.floats(-0.03, 0.03),
    st.floats(-0.3, 0.1),
    st.floats(-2e-3, 2e-3),
    st.integers(0, 99),
)
@settings(max_examples=8, deadline=None)
def test_any_lens_is_recovered_from_exact_corners(focal, center, k1, p, seed):
    matrix = np.array([[focal * 1280, 0, 640 + center * 1280], [0, focal * 1279, 360], [0, 0, 1]])
    lens = Intrinsics(*SIZE, matrix, np.array([k1, -k1 / 3, p, -p / 2, 0.0]))
    seen = [view.seen for view in views(7, 0, seed, lens)]
    fit = fit_lens(seen, SIZE, DISTORTION, guessed_lens(SIZE), BOARD.points)
    assert lens_error_px(fit.intrinsics, lens) < 1e-4


def test_a_view_with_little_more_than_one_row_does_not_decide_about_the_lens():
    good = views(18, seed=300)
    cut = []
    for view in views(3, seed=10):
        row = np.isin(view.seen.ids, [0, 1, 2, 3, 4, 5, 6, 8])  # a whole row of six and two more
        seen = replace(
            view.seen, ids=view.seen.ids[row], pixels=view.seen.pixels[row], points=view.seen.points[row]
        )
        cut.append(replace(view, name=f"cut {view.name}", seen=seen))
    found = fit_intrinsics([*good, *cut], CAMERA, BOARD)
    without = fit_intrinsics(good, CAMERA, BOARD)
    assert found.terms == without.terms
    assert lens_error_px(found.intrinsics, TRUE) < 2 * lens_error_px(without.intrinsics, TRUE)


def test_the_size_of_the_board_plays_no_part(calibration):
    larger = [BoardView(v.name, replace(v.seen, points=3 * v.seen.points)) for v in views(14)]
    fit = fit_intrinsics(larger, CAMERA, BOARD)
    assert np.allclose(parameters(fit.intrinsics), parameters(calibration.intrinsics), rtol=1e-6, atol=1e-6)


def test_errors_tell_the_size_of_the_noise(calibration):
    assert calibration.rms_px == pytest.approx(0.1 * np.sqrt(2), rel=0.15)
    assert calibration.rms_px < calibration.held_out_rms_px < 1.5 * calibration.rms_px
    assert [view.corners for view in calibration.views] == [24] * 14
    assert not calibration.dropped


# Terms


def test_terms_that_are_not_there_are_not_fitted():
    plain = Intrinsics(*SIZE, MATRIX, np.zeros(5))
    fit = fit_intrinsics(views(14, 0.2, lens=plain), CAMERA, BOARD)
    assert fit.terms == ()
    assert not fit.intrinsics.distortion.any()
    assert not fit.covariance[4:].any()
    assert (np.diag(fit.covariance)[:4] > 0).all()


@pytest.mark.slow
def test_no_fixed_choice_of_terms_does_clearly_better_on_new_views():
    for lens in (TRUE, replace(TRUE, distortion=np.array([-0.2, 0, 0, 0, 0]))):
        old, new = views(12, 0.2, 1, lens), [view.seen for view in views(25, 0.2, 2, lens)]
        seen = [view.seen for view in old]
        fixed = [
            fit_lens(seen, SIZE, terms, guessed_lens(SIZE), BOARD.points).intrinsics for terms in CANDIDATES
        ]
        ours = fit_intrinsics(old, CAMERA, BOARD).intrinsics
        errors = [np.mean([held_out_error(view, each) for view in new]) for each in (ours, *fixed)]
        assert errors[0] < 1.02 * min(errors[1:])
        assert max(errors[1:]) > 1.5 * min(errors[1:])


# Uncertainty


def test_the_covariance_of_a_fit_is_that_of_many_fits():
    rng = np.random.default_rng(3)
    poses = [random_pose(BOARD, TRUE, rng) for _ in range(10)]
    fits = [
        fit_lens([seen_at(p, rng, 0.2) for p in poses], SIZE, DISTORTION, TRUE, BOARD.points)
        for _ in range(60)
    ]
    inverse = np.linalg.pinv(np.mean([fit.covariance[:9, :9] for fit in fits], axis=0), rcond=1e-30)
    errors = np.array([parameters(fit.intrinsics) - parameters(TRUE) for fit in fits])
    distances = np.einsum("ni,ij,nj->n", errors, inverse, errors)
    assert 0.85 < distances.mean() / 9 < 1.15
    assert 0.88 <= (distances < chi2.ppf(0.95, 9)).mean() <= 1


def drawn_camera(seed):
    rng = np.random.default_rng([5, seed])
    matrix = MATRIX * np.array([[rng.uniform(0.8, 1.6)] * 2 + [1], [1, 1, 1], [1, 1, 1]])
    matrix[1, 1] = matrix[0, 0] * rng.uniform(0.995, 1.005)
    p1, p2 = rng.normal(0, 6e-4, 2)
    lens = Intrinsics(*SIZE, matrix, np.array([rng.uniform(-0.2, 0.1), rng.uniform(-0.07, 0.07), p1, p2, 0]))
    return lens, views(int(rng.integers(8, 16)), rng.uniform(0.05, 0.4), seed, lens)


@pytest.mark.slow
def test_the_true_lens_is_inside_the_stated_region():
    inside = [holds(fit_intrinsics(old, CAMERA, BOARD), lens) for lens, old in map(drawn_camera, range(3))]
    assert sum(inside) >= 2


@pytest.mark.slow
def test_the_region_holds_the_true_lens_as_often_as_it_says():
    inside = [holds(fit_intrinsics(old, CAMERA, BOARD), lens) for lens, old in map(drawn_camera, range(80))]
    assert 0.9 <= np.mean(inside) <= 0.99


# Wrong corners and views


def scrambled(view, rng):
    return moved(view, view.seen.pixels[rng.permutation(24)])


def shifted(view, rng):
    return moved(view, view.seen.pixels + rng.normal(0, 4, (24, 2)))


def squashed(view, rng):
    middle = view.seen.pixels.mean(axis=0)
    return moved(view, middle + (view.seen.pixels - middle) * [1, 0.85])


def test_a_fifth_of_the_views_may_be_wrong(calibration):
    rng = np.random.default_rng(4)
    good = views(14)
    wrong = [spoil(view, rng) for spoil, view in zip((scrambled, shifted, squashed), good, strict=False)]
    fit = fit_intrinsics(wrong + good[3:], CAMERA, BOARD)
    assert [name for name, _ in fit.dropped] == ["000.png", "001.png", "002.png"]
    assert all(why for _, why in fit.dropped)
    assert lens_error_px(fit.intrinsics, TRUE) < 2 * lens_error_px(calibration.intrinsics, TRUE)


def test_single_wrong_corners_cost_no_view(calibration):
    rng = np.random.default_rng(5)
    spoiled = []
    for view in views(14):
        pixels = view.seen.pixels.copy()
        pixels[rng.choice(24, 2, replace=False)] += [[40, -25], [1.5, 2.5]]
        spoiled.append(moved(view, pixels))
    fit = fit_intrinsics(spoiled, CAMERA, BOARD)
    assert not fit.dropped
    assert [view.corners for view in fit.views] == [22] * 14
    assert lens_error_px(fit.intrinsics, TRUE) < 2 * lens_error_px(calibration.intrinsics, TRUE)


def test_a_mirrored_view_is_dropped():
    good = views(8)
    middle = good[0].seen.pixels.mean(axis=0)
    mirrored = moved(good[0], middle + (good[0].seen.pixels - middle) * [-1, 1])
    [(name, why)] = fit_intrinsics([mirrored, *good[1:]], CAMERA, BOARD).dropped
    assert name == "000.png"
    assert "as in a mirror" in why


# What cannot be trusted


def test_too_few_views_are_refused():
    with pytest.raises(CalibrationError, match=r"at least 4 views that agree on one lens, got 3 of 3"):
        fit_intrinsics(views(3), CAMERA, BOARD)


def test_views_that_do_not_show_the_board_are_refused():
    rng = np.random.default_rng(6)
    with pytest.raises(CalibrationError, match=r"got 0 of 8 \(000.png: only \d+ of 24 corners"):
        fit_intrinsics([scrambled(view, rng) for view in views(8)], CAMERA, BOARD)


def test_one_place_is_refused():
    rng = np.random.default_rng(7)
    pose = random_pose(BOARD, TRUE, rng)
    with pytest.raises(CalibrationError, match="all 8 views show the board in the same place"):
        fit_intrinsics([BoardView(f"{i}", seen_at(pose, rng, 0.2)) for i in range(8)], CAMERA, BOARD)


def test_boards_that_only_face_the_camera_are_refused():
    with pytest.raises(
        CalibrationError, match=r"do not determine the lens.*tilt the board by 30 to 45 degrees"
    ):
        fit_intrinsics(views(5, 0.2, tilt=0.0), CAMERA, BOARD)


def test_a_board_of_other_proportions_does_not_pass_unnoticed():
    def stretched(by):
        return [BoardView(v.name, replace(v.seen, points=v.seen.points * [by, 1, 1])) for v in views(8)]

    with pytest.raises(CalibrationError, match="check the board's stated rows, columns and sizes"):
        fit_intrinsics(stretched(1.4), CAMERA, BOARD)
    warnings = fit_intrinsics(stretched(1.1), CAMERA, BOARD).warnings
    assert any("is the board as stated" in line for line in warnings)


def test_what_the_views_lack_is_said(calibration):
    assert not calibration.warnings
    flat = fit_intrinsics(views(8, 0.05, tilt=0.2), CAMERA, BOARD).warnings
    assert any("only 8 views" in line for line in flat)
    assert any("degrees of face-on; tilt it by 30 to 45 degrees in both directions" in line for line in flat)
    right = [view for view in views(60) if view.seen.pixels[:, 0].min() > SIZE[0] / 3]
    lacking = fit_intrinsics(right[:6], CAMERA, BOARD).warnings
    assert any(
        line.startswith("no board in the top left, left and bottom left of the picture") for line in lacking
    )


# Live


def placed(where, turn=(0.0, 0.0), distance=0.4):
    """The middle of the board at `where` of the picture, tilted about the camera's x and y axes."""
    rotation = Rotation.from_euler("xy", turn, degrees=True).as_matrix()
    ray = np.append(TRUE.rays(np.array([where]) * SIZE)[0], 1.0)
    pose = rigid(rotation, ray * distance - rotation @ BOARD.points.mean(axis=0))
    return BoardView("live", seen_at(pose, np.random.default_rng(0), 0.1))


def test_following_the_advice_ends_with_enough():
    done = {
        "in the middle": {"where": (0.5, 0.5)},
        "top left": {"where": (0.17, 0.17)},
        "the top of": {"where": (0.5, 0.17)},
        "top right": {"where": (0.83, 0.17)},
        "the left of": {"where": (0.17, 0.5)},
        "the right of": {"where": (0.83, 0.5)},
        "bottom left": {"where": (0.17, 0.83)},
        "the bottom of": {"where": (0.5, 0.83)},
        "bottom right": {"where": (0.83, 0.83)},
        "left side farther": {"where": (0.5, 0.5), "turn": (0, 35)},
        "right side farther": {"where": (0.5, 0.5), "turn": (0, -35)},
        "top side farther": {"where": (0.5, 0.5), "turn": (-35, 0)},
        "bottom side farther": {"where": (0.5, 0.5), "turn": (35, 0)},
        "nearer": {"where": (0.5, 0.5), "distance": 0.2},
        "farther away": {"where": (0.5, 0.5), "distance": 0.8},
        "more: show": {"where": (0.4, 0.4), "turn": (20, 20)},
    }
    shown: list[BoardView] = []
    asked: list[str] = []
    while (advice := next_view(shown, CAMERA, BOARD)) is not None:
        key = next(words for words in done if words in advice)
        assert "more" in key or key not in asked, f"asked for {advice!r} again"
        asked.append(key)
        shown.append(placed(**done[key]))
    assert len(shown) >= 20
    assert {"left side farther", "bottom side farther", "nearer"} <= set(asked)


def test_a_board_is_new_when_moved_tilted_or_turned_but_not_when_held():
    kept = [placed((0.5, 0.5))]
    held = TargetDetection(kept[0].seen.ids, kept[0].seen.pixels + np.array([3.0, -2.0]), BOARD.points)
    assert not is_new(kept, held)
    assert is_new([], held)
    for other in (
        placed((0.7, 0.5)),
        placed((0.5, 0.5), turn=(0, 35)),
        placed((0.5, 0.5), turn=(35, 0)),
        placed((0.5, 0.5), distance=0.3),
    ):
        assert is_new(kept, other.seen)
        assert not is_new([*kept, other], other.seen)


# Files


def test_a_saved_calibration_comes_back(calibration, tmp_path):
    path = tmp_path / "camera.yaml"
    full = replace(calibration, dropped=(("007.png", "no marker is seen"),), warnings=("only 3 views",))
    full.save(path)
    again = CameraCalibration.load(path, CAMERA)
    assert np.array_equal(again.intrinsics.matrix, full.intrinsics.matrix)
    assert np.array_equal(again.intrinsics.distortion, full.intrinsics.distortion)
    assert np.array_equal(again.covariance, full.covariance)
    for name in (
        "camera",
        "terms",
        "rms_px",
        "held_out_rms_px",
        "views",
        "dropped",
        "warnings",
        "target",
        "source",
    ):
        assert getattr(again, name) == getattr(full, name)
    content = yaml.safe_load(path.read_text())
    assert content["kind"] == "intrinsics"
    assert np.array_equal(content["camera_matrix"], full.intrinsics.matrix)
    assert len(content["distortion"]) == 5
    assert content["dropped"] == [{"view": "007.png", "why": "no marker is seen"}]
    assert content["standard_deviations"]["fx_px"] == pytest.approx(np.sqrt(full.covariance[0, 0]))


def test_a_calibration_is_good_for_its_own_camera_only(calibration, tmp_path):
    calibration.save(tmp_path / "camera.yaml")
    for other in (CameraIdentity("bench", 640, 360), CameraIdentity("ceiling", *SIZE)):
        with pytest.raises(CalibrationError, match="is of camera 'bench' at 1280 x 720"):
            CameraCalibration.load(tmp_path / "camera.yaml", other)


def test_a_damaged_calibration_is_refused(calibration, tmp_path):
    path = tmp_path / "camera.yaml"
    calibration.save(path)
    content = yaml.safe_load(path.read_text())
    for broken in ({"camera_matrix": [[1, 0], [0, 1]]}, {"distortion": "none"}, {"views": [{"view": "x"}]}):
        path.write_text(yaml.safe_dump(content | broken))
        with pytest.raises(DataError, match="is damaged"):
            CameraCalibration.load(path)


ROS = {
    "image_width": 640,
    "image_height": 480,
    "camera_name": "head",
    "camera_matrix": {"rows": 3, "cols": 3, "data": [600.0, 0, 320, 0, 601, 240, 0, 0, 1]},
    "distortion_model": "plumb_bob",
    "distortion_coefficients": {"rows": 1, "cols": 5, "data": [0.1, -0.2, 0.001, 0.002, 0.05]},
}
MESSAGE = {
    "width": 640,
    "height": 480,
    "distortion_model": "plumb_bob",
    "d": [0.1, -0.2, 0.001, 0.002, 0.05],
    "k": [600.0, 0, 320, 0, 601, 240, 0, 0, 1],
}
MRCAL = """# generated by mrcal
{
    'lensmodel':  'LENSMODEL_OPENCV5',

    # intrinsics are fx,fy,cx,cy,distortion0,distortion1,....
    'intrinsics': [ 600., 601., 320., 240., 0.1, -0.2, 0.001, 0.002, 0.05,],
    # extrinsics are rt_fromref
    'extrinsics': [ 0., 0., 0., 0., 0., 0.,],
    'imagersize': [ 640, 480,],
    'icam_intrinsics': 0,
    'optimization_inputs': b'P<+;-0RR91',
}
"""
REALSENSE = {
    "width": 640,
    "height": 480,
    "fx": 600.0,
    "fy": 601.0,
    "ppx": 320.0,
    "ppy": 240.0,
    "model": "Brown Conrady",
    "coeffs": [0.1, -0.2, 0.001, 0.002, 0.05],
}


def with_matrix(numbers: list[float]) -> dict[str, object]:
    return ROS | {"camera_matrix": {"rows": 3, "cols": 3, "data": numbers}}


def write_opencv(path: Path) -> None:
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", 640)
    storage.write("image_height", 480)
    storage.write("camera_matrix", np.array(ROS["camera_matrix"]["data"]).reshape(3, 3))
    storage.write("distortion_coefficients", np.array([[0.1, -0.2, 0.001, 0.002, 0.05]]))
    storage.release()


@pytest.mark.parametrize(
    "name",
    [
        "ros.yaml",
        "message.yaml",
        "message-echoed.yaml",
        "ros.json",
        "rs.json",
        "cv.yml",
        "cv.xml",
        "cv.json",
        "head.cameramodel",
    ],
)
def test_factory_values_are_read_from_every_kind_of_file(name, tmp_path):
    path = tmp_path / name
    if name.startswith("cv"):
        write_opencv(path)
    elif name.endswith(".json"):
        path.write_text(json.dumps(REALSENSE if name.startswith("rs") else ROS))
    elif name.endswith(".cameramodel"):
        path.write_text(MRCAL)
    elif name == "message-echoed.yaml":  # by `ros2 topic echo`, twice
        path.write_text(2 * f"{yaml.safe_dump(MESSAGE)}---\n")
    else:
        path.write_text(yaml.safe_dump(MESSAGE if name.startswith("message") else ROS))
    factory = import_intrinsics(path, "head")
    assert factory.camera == CameraIdentity("head", 640, 480)
    assert np.array_equal(parameters(factory.intrinsics), [600, 601, 320, 240, 0.1, -0.2, 0.001, 0.002, 0.05])
    assert factory.covariance is None
    assert factory.rms_px is None
    factory.save(tmp_path / "saved.yaml")
    again = CameraCalibration.load(tmp_path / "saved.yaml")
    assert again.covariance is None
    assert np.array_equal(again.intrinsics.matrix, factory.intrinsics.matrix)


@pytest.mark.parametrize(
    ("content", "error", "words"),
    [
        (
            ROS | {"distortion_model": "equidistant"},
            CalibrationError,
            "'equidistant', which is not supported",
        ),
        (REALSENSE | {"model": "Inverse Brown Conrady"}, CalibrationError, "not supported"),
        (REALSENSE | {"model": "Kannala Brandt4", "coeffs": [0] * 5}, CalibrationError, "not supported"),
        (ROS | {"image_width": 0}, DataError, "a picture size and focal lengths above 0 are needed"),
        (ROS | {"camera_matrix": {"data": [1, 2]}}, DataError, "is damaged"),
        (
            {"fx": 600},
            DataError,
            "expected a ROS camera_info, a RealSense JSON, an OpenCV FileStorage or a came",
        ),
        ([1, 2], DataError, "expected a ROS camera_info"),
        (with_matrix([600, 0, 0, 0, 601, 0, 320, 240, 1]), DataError, "is transposed, as MATLAB writes it"),
        (with_matrix([600, 2, 320, 0, 601, 240, 0, 0, 1]), DataError, "has a skew of 2 px"),
        (with_matrix([600, 0, 320, 0, 601, 240, 0, 0, 2]), DataError, "its camera matrix is none"),
        (
            with_matrix([600, 0, 700, 0, 601, 240, 0, 0, 1]),
            DataError,
            r"principal point \(700, 240\) lies outside",
        ),
    ],
)
def test_what_is_no_factory_file_is_refused(content, error, words, tmp_path):
    path = tmp_path / "file.json"
    path.write_text(json.dumps(content))
    with pytest.raises(error, match=words) as caught:
        import_intrinsics(path, "head")
    assert "\n" not in str(caught.value)


def test_a_lens_model_of_mrcals_own_is_refused(tmp_path):
    path = tmp_path / "head.cameramodel"
    path.write_text(MRCAL.replace("OPENCV5", "SPLINED_STEREOGRAPHIC_order=3"))
    with pytest.raises(
        CalibrationError, match="'LENSMODEL_SPLINED_STEREOGRAPHIC_order=3', which is not supported"
    ):
        import_intrinsics(path, "head")


def test_an_inverse_model_without_coefficients_is_the_same_model(tmp_path):
    path = tmp_path / "rs.json"
    path.write_text(json.dumps(REALSENSE | {"model": "Inverse Brown Conrady", "coeffs": [0] * 5}))
    assert not import_intrinsics(path, "head").intrinsics.distortion.any()


def test_coverage_is_drawn(calibration, tmp_path):
    draw_corner_errors(calibration, tmp_path / "new" / "camera.png")
    with Pillow.open(tmp_path / "new" / "camera.png") as picture:
        assert np.asarray(picture.convert("L")).std() > 5
    calibration.save(tmp_path / "camera.yaml")
    with pytest.raises(CalibrationError, match="no corners to draw"):
        draw_corner_errors(CameraCalibration.load(tmp_path / "camera.yaml"), tmp_path / "again.png")


# Pictures


def flat(value, size=(64, 48)):
    return Pillow.new("RGB", size, value)


def test_a_folder_is_read_by_name_in_rgb(tmp_path):
    flat((200, 100, 50)).save(tmp_path / "b.png")
    flat((10, 20, 30)).save(tmp_path / "a.bmp")
    (tmp_path / "notes.txt").write_text("not a picture")
    pictures = list(read_pictures(tmp_path))
    assert [name for name, _ in pictures] == ["a.bmp", "b.png"]
    assert [picture[0, 0].tolist() for _, picture in pictures] == [[10, 20, 30], [200, 100, 50]]
    assert pictures[0][1].shape == (48, 64, 3)
    assert [name for name, _ in read_pictures(tmp_path / "b.png")] == ["b.png"]


def test_sixteen_bits_of_grey_become_eight(tmp_path):
    Pillow.fromarray(np.full((48, 64), 0x8123, np.uint16)).save(tmp_path / "deep.png")
    [(_, picture)] = read_pictures(tmp_path)
    assert (picture == 0x81).all()


def test_pictures_that_cannot_be_used_are_named(tmp_path):
    with pytest.raises(DataError, match="found nothing"):
        read_pictures(tmp_path / "nowhere")
    with pytest.raises(DataError, match="found none"):
        read_pictures(tmp_path)
    flat(0).save(tmp_path / "000.png")
    flat(0, (32, 32)).save(tmp_path / "001.png")
    flat(0).save(tmp_path / "002.png")
    with pytest.raises(DataError, match=r"expected all pictures at 64 x 48, got 001.png 32 x 32;"):
        read_pictures(tmp_path)
    (tmp_path / "001.png").write_bytes(b"no picture")
    with pytest.raises(DataError, match=r"001.png cannot be read"):
        read_pictures(tmp_path)
    noise = np.random.default_rng(0).integers(0, 255, (48, 64, 3), np.uint8)
    Pillow.fromarray(noise).save(tmp_path / "001.png")
    whole = (tmp_path / "001.png").read_bytes()
    (tmp_path / "001.png").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(DataError, match=r"001.png cannot be read"):
        list(read_pictures(tmp_path))


def test_the_sharpest_frames_of_a_video_are_taken(tmp_path):
    path = tmp_path / "board.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 30, (64, 48))
    sharp = np.kron(np.indices((6, 8)).sum(0) % 2, np.full((8, 8), 255)).astype(np.uint8)
    for number in range(150):
        grey = sharp if number % 3 == 1 else cv2.GaussianBlur(sharp, (0, 0), 3)
        writer.write(cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR))
    writer.release()
    names = [name for name, _ in read_pictures(path)]
    assert names == [f"board.avi frame {number:06d}" for number in range(1, 150, 3)]


# From pictures to a calibration


def test_the_drawn_board_is_where_it_should_be():
    rng = np.random.default_rng(8)
    errors = []
    for _ in range(3):
        pose = random_pose(BOARD, TRUE, rng)
        seen = BOARD.detect(render_board(BOARD, pose, TRUE, rng, noise=0))
        errors.append(seen.pixels - TRUE.project(transform_points(pose, seen.points)))
    off = np.concatenate(errors)
    assert np.abs(off.mean(axis=0)).max() < 0.02
    assert np.sqrt((off**2).sum(axis=1).mean()) < 0.01


@pytest.mark.parametrize("blur", [0.6, 1.2])
def test_a_marker_is_as_large_as_it_is_however_blurred_and_bent(blur):
    """Its distance is found from its size: 1 mm at 1 m is a thousandth."""
    marker = parse_target("aruco:DICT_4X4_50:7:0.08")
    rng = np.random.default_rng(4)
    off, larger = [], []
    for _ in range(12):
        pose = random_pose(marker, TRUE, rng, near=0.25)
        true = TRUE.project(transform_points(pose, marker.points))
        seen = marker.detect(render_board(marker, pose, TRUE, rng, blur=blur))
        sides, true_sides = (
            np.linalg.norm(np.roll(c, -1, axis=0) - c, axis=1).mean() for c in (seen.pixels, true)
        )
        off.append(seen.pixels - true)
        larger.append(sides / true_sides - 1)
    assert np.sqrt((np.array(off) ** 2).sum(axis=2).mean()) < 0.06
    assert abs(np.mean(larger)) < 0.5e-3
    assert np.abs(larger).max() < 1.5e-3


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Twelve pictures at 640 x 360 of a moving board, and one of the empty table."""
    path = tmp_path_factory.mktemp("pictures")
    rng = np.random.default_rng(9)
    lens = TRUE.scaled(640, 360)
    for number in range(12):
        picture = render_board(BOARD, random_pose(BOARD, lens, rng), lens, rng)
        Pillow.fromarray(picture).save(path / f"{number:03d}.png")
    Pillow.fromarray(np.full((360, 640, 3), 120, np.uint8)).save(path / "012.png")
    return path


def test_a_folder_of_pictures_gives_the_camera(folder):
    calibration = calibrate_intrinsics_from(folder, BOARD, "bench")
    assert calibration.camera == CameraIdentity("bench", 640, 360)
    assert ("012.png", BOARD.why_not(np.full((360, 640, 3), 120, np.uint8))) in calibration.dropped
    assert calibration.rms_px < 0.15
    true = TRUE.scaled(640, 360).matrix
    assert np.allclose(calibration.intrinsics.matrix[:2], true[:2], atol=2.5)


def test_a_board_whose_squares_were_counted_wrong_is_told_how_it_is():
    rng = np.random.default_rng(3)
    picture = render_board(BOARD, random_pose(BOARD, TRUE, rng), TRUE, rng)
    swapped = parse_target("charuco:5x7:0.030:0.021:DICT_4X4_50")
    assert swapped.detect(picture) is None
    assert swapped.why_not(picture) == "it is a board of 7x5 squares, not 5x7; say it so"
    longer = parse_target("charuco:3x11:0.030:0.021:DICT_4X4_50")
    assert longer.why_not(picture).startswith("all 16 markers are seen, but not where this board has them")


def test_a_board_with_more_markers_than_its_dictionary_is_refused_when_it_is_named():
    with pytest.raises(BaggieError, match=r"14x10.* needs 70 markers and DICT_4X4_50 has 50"):
        parse_target("charuco:14x10:0.010:0.007:DICT_4X4_50")
    assert parse_target("charuco:14x10:0.010:0.007:DICT_4X4_100").markers == 70


@pytest.mark.parametrize(
    "distortion",
    [[-0.3189, 0.1006, 5e-4, -5e-4, 0.0088], [-0.2191, 0.0133, 0, 0, 0.0289], [0.3, -0.1, 1e-3, -1e-3, 0.05]],
)
def test_rays_of_very_wide_lenses_are_exact_to_the_corners(distortion):
    lens = Intrinsics(1280, 720, np.array([[600.0, 0, 640], [0, 600, 360], [0, 0, 1]]), np.array(distortion))
    u, v = np.meshgrid(np.linspace(0, 1279, 33), np.linspace(0, 719, 19))
    pixels = np.c_[u.ravel(), v.ravel()]
    rays = lens.rays(pixels)
    np.testing.assert_allclose(lens.project(np.c_[rays, np.ones(len(rays))]), pixels, atol=1e-5)


def test_pictures_without_the_board_say_why(folder, tmp_path):
    other = parse_target("charuco:7x5:0.030:0.021:DICT_6X6_250")
    for name in ("000.png", "012.png"):
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    with pytest.raises(CalibrationError, match=r"found it in 0 of 2.*is that what was printed") as caught:
        calibrate_intrinsics_from(tmp_path, other, "bench")
    assert "\n" not in str(caught.value)
    views_, skipped = find_views(read_pictures(tmp_path), BOARD)
    assert [view.name for view in views_] == ["000.png"]
    assert [name for name, _ in skipped] == ["012.png"]
