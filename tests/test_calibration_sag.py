"""Boards that are not flat: their sag is found with the lens, and counted in wherever the board is used again."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import yaml
from PIL import Image as Pillow
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from baggie.calibration.camera_to_world import T_WORLD_TARGET, CameraToWorld, fit_camera_to_world
from baggie.calibration.files import CameraIdentity
from baggie.calibration.hand_eye.solve import solve_hand_eye
from baggie.calibration.hand_eye.views import HandEyeViews, read_views
from baggie.calibration.intrinsics import lens as lens_bundle
from baggie.calibration.intrinsics.camera_calibration import CameraCalibration
from baggie.calibration.intrinsics.fit import BoardView, fit_intrinsics
from baggie.calibration.intrinsics.lens import DISTORTION, USUAL_SAG, LensGuess, fit_lens, settle_lens
from baggie.calibration.intrinsics.views import corner_noise_px
from baggie.calibration.point_registration import points_to_touch
from baggie.commissioning.intrinsics import calibrate_intrinsics
from baggie.commissioning.poses import calibrate_camera_to_world, calibrate_robot_to_world_live
from baggie.errors import DataError
from baggie.geometry import difference, from_vector, invert_transform, rigid, transform_points
from baggie.options.commissioning import CameraToWorldOptions, IntrinsicsOptions, RobotToWorldOptions
from baggie.types import Intrinsics
from baggie.vision.corners import FLAT, Sag
from baggie.vision.targets import TargetDetection, parse_target, with_sag
from helpers.board_pictures import lens_error_px, random_pose, render_board

BOARD = parse_target("chessboard:10x7:0.025")
CHARUCO = parse_target("charuco:11x8:0.025:0.018:DICT_4X4_50")
MARKER = parse_target("aruco:DICT_4X4_50:7:0.08")
CAMERA = CameraIdentity("bench", 1280, 720)
MATRIX = np.array([[900.0, 0, 645], [0, 902, 352], [0, 0, 1]])
TRUE = Intrinsics(1280, 720, MATRIX, np.array([-0.1, 0.05, 3e-4, -2e-4, 0.0]))
SMALL = TRUE.scaled(640, 360)
BENT = Sag(2e-3, 5e-4)
SHAPES = [Sag(3e-4, 1e-4), Sag(-3e-3, 2e-3)]


def seen_at(pose, points, rng, noise, board=BOARD):
    """The flat board's points, seen where those of `points` are."""
    pixels = TRUE.project(transform_points(pose, points))
    return TargetDetection(np.arange(len(pixels)), pixels + rng.normal(0, noise, pixels.shape), board.points)


def views(points, count=12, noise=0.02):
    rng = np.random.default_rng(0)
    poses = [random_pose(BOARD, TRUE, rng) for _ in range(count)]
    return [BoardView(f"{i:03d}", seen_at(pose, points, rng, noise)) for i, pose in enumerate(poses)]


def twisted(by_m):
    low, high = BOARD.points.min(axis=0), BOARD.points.max(axis=0)
    x, y = ((2 * BOARD.points - low - high)[:, :2] / (high - low)[:2]).T
    return np.c_[BOARD.points[:, :2], by_m * x * y]


# The shape


def test_a_sag_is_that_of_the_middle_and_leaves_the_outermost_corners():
    bent = with_sag(BOARD, Sag(1e-3, 4e-4)).points.reshape(7, 10, 3)
    assert np.array_equal(bent[..., :2], BOARD.points.reshape(7, 10, 3)[..., :2])
    assert np.allclose(bent[[0, 0, -1, -1], [0, -1, 0, -1], 2], 0, atol=1e-18)
    x = np.linspace(-1, 1, 10)
    assert np.allclose(bent[0, :, 2], 1e-3 * (1 - x**2))
    assert np.allclose(bent[3, :, 2], 1e-3 * (1 - x**2) + 4e-4)


def test_boards_are_bent_and_markers_are_not():
    sag = Sag(1e-3, 0.0)
    assert with_sag(CHARUCO, sag).points[:, 2].max() == pytest.approx(1e-3, rel=0.02)
    assert with_sag(MARKER, sag) is MARKER
    assert with_sag(BOARD, sag).spec == BOARD.spec


def test_a_board_whose_squares_were_counted_is_bent_over_the_same_length():
    picture = render_board(
        BOARD, random_pose(BOARD, SMALL, np.random.default_rng(2)), SMALL, np.random.default_rng(2)
    )
    counted = with_sag(parse_target("chessboard:11x8:0.025"), Sag(1e-3, 5e-4))
    seen = counted.detect(picture)
    assert len(seen.ids) == 70
    assert np.array_equal(seen.points, counted.points.reshape(8, 11, 3)[:7, :10].reshape(-1, 3))


# With the lens


@pytest.mark.parametrize("sag", SHAPES)
def test_a_board_that_sags_gives_the_lens_and_its_sag(sag):
    points = sag.bend(BOARD.points, BOARD.points)
    found = fit_intrinsics(views(points), CAMERA, BOARD)
    assert lens_error_px(found.intrinsics, TRUE) < 0.1
    for name in ("along_m", "across_m"):
        off, std = getattr(found.sag, name) - getattr(sag, name), getattr(found.sag_std, name)
        assert abs(off) < 3 * std
        assert std < 1e-5
    assert found.board_shape == f"the board sags by {sag}"
    assert found.warnings == ()
    assert not found.dropped
    as_if_flat = fit_opencv(views(points))
    assert lens_error_px(as_if_flat, TRUE) > 5 * lens_error_px(found.intrinsics, TRUE)


def fit_opencv(seen):
    points, pixels = ([getattr(v.seen, of).astype(np.float32) for v in seen] for of in ("points", "pixels"))
    _, matrix, distortion, *_ = cv2.calibrateCamera(points, pixels, CAMERA.size, None, None)
    return Intrinsics(*CAMERA.size, matrix, distortion.ravel())


def test_words_are_in_millimetres():
    assert str(Sag(-3e-4, 1e-4)) == "0.3 mm along, 0.1 mm across"


def test_wrong_corners_do_not_hide_behind_the_sag():
    """As far off as those of a board like this are by a lens that takes it for flat."""
    spoiled = views(SHAPES[1].bend(BOARD.points, BOARD.points))
    pixels = spoiled[3].seen.pixels
    pixels[[6, 8, 9, 17, 18, 19]] += [1.2, -1.0]
    found = fit_intrinsics(spoiled, CAMERA, BOARD)
    assert [view.corners for view in found.views] == [70] * 3 + [64] + [70] * 8
    assert lens_error_px(found.intrinsics, TRUE) < 0.1


def test_exact_corners_give_the_exact_sag():
    sag = Sag(6e-3, -1e-3)
    found = fit_intrinsics(views(sag.bend(BOARD.points, BOARD.points), 8, 0.0), CAMERA, BOARD)
    assert found.sag.along_m == pytest.approx(6e-3, abs=1e-9)
    assert found.sag.across_m == pytest.approx(-1e-3, abs=1e-9)
    assert lens_error_px(found.intrinsics, TRUE) < 1e-5


def test_a_flat_board_stays_flat():
    found = fit_intrinsics(views(BOARD.points), CAMERA, BOARD)
    for name in ("along_m", "across_m"):
        assert abs(getattr(found.sag, name)) < 3 * getattr(found.sag_std, name) < 3e-5
    assert found.board_shape == "the board is flat (to 0.1 mm)"
    assert lens_error_px(found.intrinsics, TRUE) < 0.1
    assert found.warnings == ()


def test_where_pictures_do_not_tell_the_board_is_as_flat_as_boards_usually_are():
    """From the front and far away a sag looks like nothing."""
    rng = np.random.default_rng(3)
    poses = [rigid(np.eye(3), [*rng.uniform(-0.2, 0.1, 2), 20.0]) for _ in range(6)]
    seen = [seen_at(pose, BOARD.points, rng, 0.5) for pose in poses]
    fit = settle_lens(seen, (), LensGuess(replace(TRUE, distortion=np.zeros(5)), poses), BOARD.points)
    usual = USUAL_SAG * np.ptp(BOARD.points, axis=0)[:2]
    assert np.all(np.abs([fit.sag.along_m, fit.sag.across_m]) < usual)
    assert np.allclose(np.sqrt(np.diag(fit.covariance)[9:]), usual, rtol=0.02)


def test_a_sag_that_is_not_known_makes_the_focal_length_less_sure(monkeypatch):
    seen = [view.seen for view in views(BOARD.points, 6, 0.1)]
    free = fit_lens(seen, CAMERA.size, DISTORTION, TRUE, BOARD.points)
    monkeypatch.setattr(lens_bundle, "USUAL_SAG", 1e-9)
    held = fit_lens(seen, CAMERA.size, DISTORTION, TRUE, BOARD.points)
    assert abs(held.sag.along_m) < 1e-9
    assert np.all(np.diag(free.covariance)[:4] > np.diag(held.covariance)[:4])


def test_the_covariance_is_that_of_many_fits_of_a_bowed_board():
    rng, points = np.random.default_rng(4), BENT.bend(BOARD.points, BOARD.points)
    poses = [random_pose(BOARD, TRUE, rng) for _ in range(7)]
    truth = LensGuess(TRUE, poses, BENT)
    fits = [
        settle_lens([seen_at(p, points, rng, 0.1) for p in poses], DISTORTION, truth, BOARD.points)
        for _ in range(80)
    ]
    true = np.concatenate(
        [MATRIX[[0, 1, 0, 1], [0, 1, 2, 2]], TRUE.distortion, [BENT.along_m, BENT.across_m]]
    )
    scale = np.sqrt(np.diag(fits[0].covariance))
    errors = np.array([(fit.values - true) / scale for fit in fits])
    inverse = np.linalg.inv(np.mean([fit.covariance for fit in fits], axis=0) / np.outer(scale, scale))
    distances = np.einsum("ni,ij,nj->n", errors, inverse, errors)
    assert 0.8 < distances.mean() / 11 < 1.2
    assert 0.88 <= (distances < chi2.ppf(0.95, 11)).mean() <= 1


# What is left over


def test_the_corners_noise_is_told_from_what_moves_them_together():
    rng, seen, off = np.random.default_rng(5), [], []
    for _ in range(6):
        noise = rng.normal(0, 0.02, (70, 2))
        x, y = BOARD.points[:, :2].T
        smooth = np.c_[1 + 200 * x * y, 3 * x - 40 * y**2]
        wrong = np.where(rng.random((70, 1)) < 0.03, 5.0, 0.0)
        seen.append(TargetDetection(np.arange(70), np.zeros((70, 2)), BOARD.points))
        off.append(noise + smooth + wrong)
    assert corner_noise_px(seen, off) == pytest.approx(0.02 * np.sqrt(2), rel=0.2)
    row = [TargetDetection(view.ids[:3], view.pixels[:3], view.points[:3]) for view in seen]
    assert corner_noise_px(row, [each[:3] for each in off]) is None


def test_what_two_numbers_do_not_describe_is_warned_of():
    found = fit_intrinsics(views(twisted(1e-3), 8, noise=0.01), CAMERA, BOARD)
    assert found.rms_px > 10 * found.corner_noise_px
    warning = found.warnings[-1]
    assert "times as far as they are found" in warning
    assert "is the board twisted" in warning


# Corners


@pytest.mark.parametrize(("board", "most_px"), [(BOARD, 0.016), (CHARUCO, 0.035)])
def test_corners_of_boards_do_not_err_together(board, most_px):
    """In 640 x 360 pixels a square is 20 to 40: markers are near; a chessboard's finder by itself errs by 0.09 px."""
    rng, errors, growth = np.random.default_rng(6), [], []
    for _ in range(5):
        pose = random_pose(board, SMALL, rng)
        seen = board.detect(render_board(board, pose, SMALL, rng, blur=0.8))
        true = SMALL.project(transform_points(pose, seen.points))
        off = seen.pixels - true
        off, true = (each[np.linalg.norm(off, axis=1) < 0.2] for each in (off, true))
        around = true - true.mean(axis=0)
        errors.append(np.median(np.linalg.norm(off, axis=1)))
        growth.append((off * around).sum() / (around**2).sum())
    assert np.mean(errors) < most_px
    assert np.abs(growth).max() < 1.2e-4


# Files


@pytest.fixture(scope="module")
def bowed():
    points = SHAPES[0].bend(BOARD.points, BOARD.points)
    return fit_intrinsics(views(points), CAMERA, BOARD)


def test_the_sag_is_kept_and_belongs_to_its_board(bowed, tmp_path):
    bowed.save(tmp_path / "camera.yaml")
    again = CameraCalibration.load(tmp_path / "camera.yaml")
    assert again.sag == bowed.sag
    assert again.sag_std == bowed.sag_std
    assert again.corner_noise_px == bowed.corner_noise_px
    assert again.board_shape == bowed.board_shape
    assert again.shaped(BOARD) == with_sag(BOARD, bowed.sag)
    other = parse_target("chessboard:10x7:0.030")
    assert again.shaped(other) is other
    assert again.shaped(MARKER) is MARKER
    assert yaml.safe_load((tmp_path / "camera.yaml").read_text())["board_shape"] == bowed.board_shape


def test_calibrations_from_before_have_no_sag(bowed, tmp_path):
    path = tmp_path / "camera.yaml"
    bowed.save(path)
    content = yaml.safe_load(path.read_text())
    for key in ("sag", "sag_std", "board_shape", "corner_noise_px"):
        del content[key]
    path.write_text(yaml.safe_dump(content))
    old = CameraCalibration.load(path)
    assert old.sag is None
    assert old.board_shape is None
    assert old.shaped(BOARD) is BOARD
    path.write_text(yaml.safe_dump(content | {"sag": {"along_m": "much"}}))
    with pytest.raises(DataError, match="is damaged"):
        CameraCalibration.load(path)


# Wherever the board is used again


def test_a_camera_above_a_bowed_board_is_where_it_is():
    turn = Rotation.from_euler("zx", [0.3, np.radians(35)]).as_matrix()
    T_camera_board = rigid(turn, [-0.08, -0.05, 0.6])
    truth = T_WORLD_TARGET @ invert_transform(T_camera_board)
    rng, off_mm = np.random.default_rng(7), []
    for board in (with_sag(BOARD, BENT), BOARD):
        seen = seen_at(T_camera_board, with_sag(BOARD, BENT).points, rng, 0.02, board=board)
        found = fit_camera_to_world([seen] * 2, board, CAMERA, TRUE)
        assert found.sag == board.sag
        off_mm.append(1000 * difference(found.pose.transform, truth)[0])
    assert off_mm[0] < 0.3
    assert off_mm[1] > 1.0


def test_the_world_file_keeps_the_sag_and_old_ones_have_none(tmp_path):
    board, path = with_sag(BOARD, BENT), tmp_path / "world.yaml"
    seen = seen_at(
        rigid(np.eye(3), [-0.1, -0.07, 0.5]), board.points, np.random.default_rng(8), 0.02, board=board
    )
    fit_camera_to_world([seen], board, CAMERA, TRUE).save(path)
    assert CameraToWorld.load(path).sag == BENT
    content = yaml.safe_load(path.read_text())
    del content["sag"]
    path.write_text(yaml.safe_dump(content))
    assert CameraToWorld.load(path).sag == FLAT


def hand_eye_views(board, seed=9):
    rng, truth = np.random.default_rng(seed), from_vector([0.05, -0.1, 1.5, 0.05, 0.01, -0.04])
    stand_board = from_vector([0.02, 0.03, 0.5, 0.45, -0.1, 0.02])
    poses = [random_pose(BOARD, TRUE, rng) for _ in range(7)]
    seen = [seen_at(pose, with_sag(BOARD, BENT).points, rng, 0.05, board=board) for pose in poses]
    hands = [stand_board @ invert_transform(truth @ pose) for pose in poses]
    return HandEyeViews.from_seen("hand", hands, seen, TRUE), truth


def test_hand_and_eye_are_found_by_a_bowed_board():
    off_mm = []
    for board in (with_sag(BOARD, BENT), BOARD):
        recorded, truth = hand_eye_views(board)
        off_mm.append(1000 * difference(solve_hand_eye(recorded).transform.transform, truth)[0])
    assert off_mm[0] < 0.1
    assert off_mm[1] > 3 * off_mm[0]


def test_a_recording_says_how_its_board_sags(tmp_path):
    rng = np.random.default_rng(10)
    picture = render_board(BOARD, random_pose(BOARD, SMALL, rng), SMALL, rng, sag_m=(2e-3, 5e-4))
    Pillow.fromarray(picture).save(tmp_path / "000.png")
    setting = {"camera_matrix": SMALL.matrix.tolist(), "distortion": SMALL.distortion.tolist()}
    view = {"T_base_hand": np.eye(4).tolist(), "image": "000.png"}
    content = {"units": "m", "mount": "hand", "board": BOARD.spec, "views": [view], **setting}
    for sag, expected in (({"along_m": 2e-3, "across_m": 5e-4}, BENT), (None, FLAT)):
        (tmp_path / "views.json").write_text(json.dumps(content | {"sag": sag}))
        [seen] = read_views(tmp_path).seen
        assert np.array_equal(seen.points, with_sag(BOARD, expected).points)
    (tmp_path / "views.json").write_text(json.dumps(content | {"sag": {"along_m": 2e-3}}))
    with pytest.raises(DataError, match="expected along_m and across_m, metres, as sag"):
        read_views(tmp_path)


def test_points_to_touch_are_on_the_bowed_board():
    flat, bent = (points_to_touch(board, axes_only=False) for board in (BOARD, with_sag(BOARD, BENT)))
    heights = {words: point[2] for words, point in bent}
    assert [words for words, _ in flat] == list(heights)
    assert all(point[2] == 0 for _, point in flat)
    for words, height in heights.items():  # the world's z is up, out of the print
        expected = 0.0
        if "lower side" in words or "upper side" in words:
            expected = -2e-3
        elif "side" in words:
            expected = -5e-4
        assert height == pytest.approx(expected, abs=3e-5), words


def test_the_robot_touches_the_board_as_the_camera_saw_it(tmp_path):
    touched = []

    def touch(target, point, words):
        touched.append((target, point))
        raise KeyboardInterrupt

    assistant = SimpleNamespace(clear_table=lambda: None, touch=touch)
    session = SimpleNamespace(workcell=lambda: SimpleNamespace(arm=None), assistant=assistant)
    for number, spec in enumerate((BOARD.spec, CHARUCO.spec)):
        options = RobotToWorldOptions(out=tmp_path / f"{number}.yaml", target=spec)
        camera = SimpleNamespace(target=BOARD.spec, sag=BENT)
        with pytest.raises(KeyboardInterrupt):
            calibrate_robot_to_world_live(session, options, camera)
    assert [target.sag for target, _ in touched] == [BENT, FLAT]


def test_from_pictures_of_a_bowed_board_to_a_camera_above_it(tmp_path):
    """By the commands: the calibration says how the board sags, and the next one takes it so, unasked."""
    rng, sag_m = np.random.default_rng(11), (1.5e-3, -4e-4)
    (tmp_path / "pictures").mkdir()
    for number in range(9):
        picture = render_board(BOARD, random_pose(BOARD, SMALL, rng), SMALL, rng, sag_m=sag_m)
        Pillow.fromarray(picture).save(tmp_path / "pictures" / f"{number:03d}.png")
    camera = tmp_path / "camera.yaml"
    said = calibrate_intrinsics(IntrinsicsOptions(out=camera, from_=tmp_path / "pictures", board=BOARD.spec))
    assert said["board_shape"] == "the board sags by 1.5 mm along, 0.4 mm across"
    assert lens_error_px(CameraCalibration.load(camera).intrinsics, SMALL) < 0.1
    pose = rigid(Rotation.from_euler("zx", [0.2, np.radians(30)]).as_matrix(), [-0.08, -0.05, 0.5])
    Pillow.fromarray(render_board(BOARD, pose, SMALL, rng, sag_m=sag_m)).save(tmp_path / "table.png")
    options = CameraToWorldOptions(
        out=tmp_path / "world.yaml", intrinsics=camera, from_=tmp_path / "table.png", target=BOARD.spec
    )
    found = calibrate_camera_to_world(options)
    assert found["sag"]["along_m"] == pytest.approx(1.5e-3, abs=5e-5)
    T_world_camera = np.array(found["T_world_camera"])
    T_board_camera = invert_transform(CameraToWorld.load(Path(options.out)).T_world_target) @ T_world_camera
    assert 1000 * difference(T_board_camera, invert_transform(pose))[0] < 0.3
