"""Hand-eye calibration: a known truth is found, mistakes are named, and no closed form does better."""

import json
import re
from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike
from scipy.optimize import approx_fprime, least_squares
from scipy.spatial.transform import Rotation

from baggie.calibration.files import CameraIdentity
from baggie.calibration.hand_eye import refine as hand_eye_refine
from baggie.calibration.hand_eye.consensus import lens_share
from baggie.calibration.hand_eye.refine import CLOSED_FORMS, closed_form
from baggie.calibration.hand_eye.solve import HandEye, draw_views, solve_hand_eye
from baggie.calibration.hand_eye.views import HandEyeViews, Mount, read_views
from baggie.errors import CalibrationError, DataError
from baggie.geometry import FloatArray, difference, from_vector, invert_transform
from baggie.types import Intrinsics
from baggie.vision.targets import Charuco, TargetDetection, parse_target

BOARD = "charuco:7x5:0.030:0.021:DICT_4X4_50"
CAMERA = Intrinsics(
    640, 480, np.array([[600.0, 0, 320], [0, 600, 240], [0, 0, 1]]), np.array([0.05, -0.1, 0, 0, 0])
)
TRUTH = from_vector([0.05, -0.1, 1.5, 0.05, 0.01, -0.04])
"""`T_mount_camera` of every recording here."""


def looks(rng: np.random.Generator, count: int) -> FloatArray:
    """`T_camera_board` `(N, 4, 4)`: the board from all sides, 0.3 to 0.6 m away, its middle near the picture's."""
    poses = []
    for _ in range(count):
        tilt = Rotation.from_rotvec([*rng.uniform(-0.6, 0.6, 2), 0.0])
        turn = Rotation.from_euler("z", rng.uniform(-1.0, 1.0))
        pose = np.eye(4)
        pose[:3, :3] = (tilt * turn).as_matrix()
        middle = [*rng.uniform(-0.05, 0.05, 2), rng.uniform(0.3, 0.6)]
        pose[:3, 3] = middle - pose[:3, :3] @ [0.105, 0.075, 0.0]
        poses.append(pose)
    return np.array(poses)


def hands_of(mount: Mount, boards: FloatArray) -> FloatArray:
    """`T_base_hand` `(N, 4, 4)` of an exact arm, for `T_camera_board`."""
    stand_board = from_vector([0.02, 0.03, 0.5, 0.45, -0.1, 0.02])
    hands = [stand_board @ invert_transform(TRUTH @ board) for board in boards]
    return np.array(hands if mount == "hand" else [invert_transform(hand) for hand in hands])


def shaken(rng: np.random.Generator, poses: FloatArray, std: ArrayLike) -> FloatArray:
    """Poses with normal errors (w, d) of these standard deviations, in the frame they map to."""
    return np.array([hand_eye_refine.moved(pose, rng.normal(0, np.asarray(std, float))) for pose in poses])


def names(count: int) -> tuple[str, ...]:
    return tuple(f"view {i}" for i in range(count))


CAMERA_NOISE = (0.005, 0.005, 0.001, 0.0003, 0.0003, 0.001)
"""Of a board's pose as a camera has it: tilt and depth are noisier."""
ARM_NOISE = (0.0005, 0.0005, 0.0005, 0.0005, 0.0005, 0.0005)


def by_poses(seed: int, count: int = 12, mount: Mount = "hand", noise: float = 1.0) -> HandEyeViews:
    rng = np.random.default_rng(seed)
    boards = looks(rng, count)
    hands = shaken(rng, hands_of(mount, boards), noise * np.array(ARM_NOISE))
    return HandEyeViews(mount, hands, shaken(rng, boards, noise * np.array(CAMERA_NOISE)), names(count))


def by_corners(
    seed: int, count: int = 12, mount: Mount = "hand", noise_px: float = 0.3, arm: float = 0.0
) -> HandEyeViews:
    rng = np.random.default_rng(seed)
    boards = looks(rng, count)
    points = parse_target(BOARD).points
    seen = []
    for board in boards:
        pixels = CAMERA.project(points @ board[:3, :3].T + board[:3, 3])
        seen.append(
            TargetDetection(np.arange(len(points)), pixels + rng.normal(0, noise_px, pixels.shape), points)
        )
    hands = shaken(rng, hands_of(mount, boards), arm * np.array(ARM_NOISE))
    return HandEyeViews.from_seen(mount, list(hands), seen, CAMERA)


# What is found


@pytest.mark.parametrize("mount", ["hand", "fixed"])
def test_every_closed_form_means_the_same_transform(mount: Mount) -> None:
    views = by_poses(0, mount=mount, noise=0.0)
    for method in CLOSED_FORMS:
        metres, radians = difference(closed_form(method, views.T_stand_mount, views.T_camera_board), TRUTH)
        assert metres < 1e-8, method
        assert radians < 1e-8, method


@pytest.mark.parametrize("mount", ["hand", "fixed"])
@pytest.mark.parametrize("record", [by_poses, by_corners])
def test_exact_views_give_the_exact_transform(record: Any, mount: Mount) -> None:
    nothing = {"noise": 0.0} if record is by_poses else {"noise_px": 0.0}
    result = solve_hand_eye(record(1, count=5, mount=mount, **nothing))
    metres, radians = difference(result.transform.transform, TRUTH)
    assert metres < 1e-5
    assert np.degrees(radians) < 1e-3
    assert result.leave_one_out_mm < 0.01
    assert result.dropped == ()
    assert result.warnings == ()


@settings(deadline=None, max_examples=10)
@given(st.integers(0, 10_000), st.lists(st.floats(-2, 2), min_size=6, max_size=6))
def test_where_the_base_is_has_no_effect(seed: int, vector: list[float]) -> None:
    views = by_poses(seed, count=8)
    start = hand_eye_refine.mean_board(TRUTH, views.T_stand_mount, views.T_camera_board)
    here = hand_eye_refine.refine((TRUTH, start), views.T_stand_mount, views.T_camera_board)
    base = from_vector(vector)
    there = hand_eye_refine.refine((TRUTH, base @ start), base @ views.T_stand_mount, views.T_camera_board)
    metres, radians = difference(here.pair[0], there.pair[0])
    assert metres < 1e-5
    assert radians < 1e-5
    assert np.allclose(base @ here.pair[1], there.pair[1], atol=1e-4)


def test_a_camera_on_a_hand_is_a_fixed_camera_seen_from_there() -> None:
    views = by_poses(2, count=5)
    turned = np.array([invert_transform(hand) for hand in views.T_base_hand])
    on_hand, fixed = solve_hand_eye(views), solve_hand_eye(replace(views, mount="fixed", T_base_hand=turned))
    assert np.allclose(on_hand.transform.transform, fixed.transform.transform, atol=1e-9)
    assert fixed.leave_one_out_mm == pytest.approx(on_hand.leave_one_out_mm)


@pytest.mark.parametrize("record", [by_poses, by_corners])
def test_no_closed_form_does_better_on_views_left_out(record: Any) -> None:
    views = record(3, count=7)
    result = solve_hand_eye(views, keep_all=True)
    assert set(CLOSED_FORMS) < set(result.methods)
    assert all(result.leave_one_out_mm <= result.methods[name].leave_one_out_mm for name in CLOSED_FORMS)
    assert result.leave_one_out_mm == pytest.approx(np.mean([error for _, error in result.views]))
    assert difference(result.transform.transform, TRUTH)[0] < 0.005
    errors = []
    for i in range(len(views)):
        others = [j for j in range(len(views)) if j != i]
        x = closed_form("park", views.T_base_hand[others], views.T_camera_board[others])
        places = (views.T_base_hand @ x @ views.T_camera_board)[:, :3, 3]
        errors.append(1000 * np.linalg.norm(places[i] - places[others].mean(axis=0)))
    assert result.methods["park"].leave_one_out_mm == pytest.approx(np.mean(errors))
    assert result.methods["park"].max_mm == pytest.approx(max(errors))


def test_refinements_are_nearer_the_truth_than_closed_forms() -> None:
    off: dict[str, list[float]] = {"poses": [], "corners": [], "closed": []}
    for seed in range(5):
        views = by_corners(seed)
        hands, boards = views.T_stand_mount, views.T_camera_board
        assert views.seen is not None
        start = closed_form("park", hands, boards)
        pair = hand_eye_refine.refine(
            (start, hand_eye_refine.mean_board(start, hands, boards)), hands, boards
        ).pair
        corners = hand_eye_refine.reproject(pair, hands, views.seen, CAMERA).pair
        closed = min(difference(closed_form(method, hands, boards), TRUTH)[0] for method in CLOSED_FORMS)
        for name, metres in (
            ("poses", difference(pair[0], TRUTH)[0]),
            ("corners", difference(corners[0], TRUTH)[0]),
            ("closed", closed),
        ):
            off[name].append(metres)
    assert np.mean(off["poses"]) < np.mean(off["closed"])
    assert np.mean(off["corners"]) < 0.8 * np.mean(off["poses"])


@pytest.mark.parametrize("what", ["poses", "corners"])
def test_jacobians_are_the_derivatives(what: str, monkeypatch: pytest.MonkeyPatch) -> None:
    checked = set()

    def spy(residuals: Any, start: FloatArray, jac: Any, **options: Any) -> Any:
        numeric = approx_fprime(start, residuals, 1e-7)
        assert np.abs(jac(start) - numeric).max() < 1e-4 * np.abs(numeric).max()
        checked.add(start.size)
        return least_squares(residuals, start, jac=jac, **options)

    monkeypatch.setattr(hand_eye_refine, "least_squares", spy)
    views = by_corners(4, count=5)
    hands, boards = views.T_stand_mount, views.T_camera_board
    start = (
        hand_eye_refine.moved(TRUTH, np.array([0.02, -0.01, 0.03, 0.01, 0.02, -0.01])),
        hand_eye_refine.mean_board(TRUTH, hands, boards),
    )
    if what == "poses":
        for with_scale in (False, True):
            hand_eye_refine.refine(start, hands, boards, with_scale=with_scale)
        assert checked == {12, 13}
    else:
        assert views.seen is not None
        hand_eye_refine.reproject(start, hands, views.seen, CAMERA)
        assert checked == {12}


@pytest.mark.slow
def test_the_truth_lies_where_the_covariance_says() -> None:
    results = [solve_hand_eye(by_poses(seed, count=7)) for seed in range(4)]
    assert sum(result.transform.holds(TRUTH) for result in results) >= 3
    distances = []
    for result in results:
        error = result.transform.error_of(TRUTH)
        distances.append(error @ np.linalg.solve(result.transform.covariance, error))
    assert 1.5 < np.mean(distances) < 24  # 6, were the covariance exactly known


# What is wrong


def with_wrong_views(views: HandEyeViews, wrong: Sequence[int]) -> HandEyeViews:
    rng = np.random.default_rng(7)
    boards = views.T_camera_board.copy()
    for i in wrong:
        boards[i] = hand_eye_refine.moved(
            boards[i], rng.choice([-1, 1], 6) * [0.2, 0.1, 0.3, 0.05, 0.08, 0.1]
        )
    return replace(views, T_camera_board=boards)


def test_wrong_views_are_named_and_do_no_harm() -> None:
    wrong = [1, 4]
    off_clean, off = [], []
    for seed in (5, 6):
        views = by_poses(seed, count=10)
        result = solve_hand_eye(with_wrong_views(views, wrong))
        assert [name for name, _ in result.dropped] == [f"view {i}" for i in wrong]
        assert all(re.search(r"\d+\.\d mm .* take it again", why) for _, why in result.dropped)
        off.append(difference(result.transform.transform, TRUTH)[0])
        off_clean.append(difference(solve_hand_eye(views).transform.transform, TRUTH)[0])
    assert np.mean(off) < 2 * np.mean(off_clean)


def test_all_views_are_kept_on_demand() -> None:
    views = with_wrong_views(by_poses(5, count=6), [1])
    result = solve_hand_eye(views, keep_all=True)
    assert result.dropped == ()
    assert [name for name, _ in result.views] == list(views.names)


def test_too_many_wrong_views_are_refused() -> None:
    rng = np.random.default_rng(0)
    views = by_poses(5, count=10)
    boards = views.T_camera_board.copy()
    boards[:5] = looks(rng, 5)
    with pytest.raises(CalibrationError, match="views agree"):
        solve_hand_eye(replace(views, T_camera_board=boards))


def inverted(poses: FloatArray) -> FloatArray:
    return np.array([invert_transform(pose) for pose in poses])


def mixed_up(views: HandEyeViews, what: str) -> HandEyeViews:
    if what == "mount":
        return replace(views, mount="fixed" if views.mount == "hand" else "hand")
    if what == "hand":
        return replace(views, T_base_hand=inverted(views.T_base_hand))
    return replace(views, T_camera_board=inverted(views.T_camera_board))


@pytest.mark.parametrize("mount", ["hand", "fixed"])
@pytest.mark.parametrize(
    ("what", "words"),
    [
        ("hand", "times better with T_base_hand inverted"),
        ("mount", "or mount '"),
        ("board", "times better with T_camera_board inverted"),
    ],
)
def test_the_usual_mix_ups_are_recognised(mount: Mount, what: str, words: str) -> None:
    with pytest.raises(CalibrationError, match=words) as caught:
        solve_hand_eye(mixed_up(by_poses(8, count=8, mount=mount), what))
    assert "\n" not in str(caught.value)


def test_both_kinds_of_pose_inverted_fit_as_well_but_show_the_board_behind_the_camera() -> None:
    views = by_poses(8, count=5)
    both = replace(
        views, T_base_hand=inverted(views.T_base_hand), T_camera_board=inverted(views.T_camera_board)
    )
    assert any("behind the camera" in warning for warning in solve_hand_eye(both).warnings)


def test_turning_about_one_axis_is_refused() -> None:
    boards = np.array([from_vector([0, 0, angle, 0.02, 0.01, 0.5]) for angle in np.linspace(-1, 1, 8)])
    camera = np.eye(4)
    camera[:3, 3] = [0.05, 0, 0]
    hands = np.array([invert_transform(camera @ board) for board in boards])
    with pytest.raises(CalibrationError, match=r"about other axes.*20 degrees"):
        solve_hand_eye(HandEyeViews("hand", hands, boards, names(8)))


def test_few_views() -> None:
    views = by_poses(9, count=4)
    with pytest.raises(CalibrationError, match=r"at least 3 views.*got 2"):
        solve_hand_eye(views.select(np.array([True, True, False, False])))
    result = solve_hand_eye(views.select(np.array([True, True, True, False])))
    assert difference(result.transform.transform, TRUTH)[0] < 0.03
    assert np.isfinite(result.leave_one_out_mm)
    assert "only 3 views" in result.warnings[0]


def test_a_board_of_another_size_is_noticed() -> None:
    views = by_poses(10, count=8)
    boards = views.T_camera_board.copy()
    boards[:, :3, 3] /= 0.94
    warnings = solve_hand_eye(replace(views, T_camera_board=boards)).warnings
    assert any(re.search("9[345]% of its stated size", warning) for warning in warnings)


def test_a_board_taken_for_its_mirror_image_is_put_right() -> None:
    views = by_corners(11, count=6)
    boards = views.T_camera_board.copy()
    normal = boards[3, :3, 2]
    sight = boards[3, :3, 3] / np.linalg.norm(boards[3, :3, 3])
    mirrored = 2 * (normal @ sight) * sight - normal
    axis = np.cross(normal, mirrored)
    boards[3, :3, :3] = (
        Rotation.from_rotvec(axis / np.linalg.norm(axis) * np.arccos(normal @ mirrored)).as_matrix()
        @ boards[3, :3, :3]
    )
    right, wrong = solve_hand_eye(views), solve_hand_eye(replace(views, T_camera_board=boards))
    assert wrong.dropped == ()
    assert difference(wrong.transform.transform, right.transform.transform)[0] < 1e-4


def test_a_lens_of_four_terms_is_the_one_with_a_fifth_of_zero() -> None:
    views = by_corners(17)
    start = solve_hand_eye(views)
    pair = (start.transform.transform, start.board)
    covariance = np.diag([1.0, 1.0, 2.0, 2.0, 1e-4, 1e-4, 1e-8, 1e-8, 1e-4])
    shares = [
        lens_share(
            replace(
                views,
                intrinsics=replace(CAMERA, distortion=np.array([0.1, -0.05, 1e-3, 1e-3, *fifth])),
                intrinsics_covariance=covariance,
            ),
            pair,
        )
        for fifth in ((), (0.0,))
    ]
    assert shares[0].any()
    np.testing.assert_allclose(shares[0], shares[1], rtol=1e-9, atol=1e-18)


# On disk


def record(folder: Path, recorded: HandEyeViews, metres: float = 1.0, **changes: Any) -> Path:
    def rows(pose: FloatArray) -> list[list[float]]:
        pose = pose.copy()
        pose[:3, 3] /= metres
        return [[float(value) for value in row] for row in pose]

    entries: list[dict[str, Any]] = [
        {"T_base_hand": rows(hand), "T_camera_board": rows(board)}
        for hand, board in zip(recorded.T_base_hand, recorded.T_camera_board, strict=True)
    ]
    content = {"units": "m" if metres == 1 else "mm", "mount": recorded.mount, "views": entries, **changes}
    (folder / "views.json").write_text(json.dumps(content))
    return folder


def render(board: FloatArray) -> FloatArray:
    """The board as `CAMERA` without distortion sees it at `T_camera_board`."""
    target = parse_target(BOARD)
    assert isinstance(target, Charuco)
    metre = 2000
    flat = target.board.generateImage((int(0.21 * metre), int(0.15 * metre)))
    to_metres = np.array([[1 / metre, 0, 0.5 / metre], [0, 1 / metre, 0.5 / metre], [0, 0, 1]])
    homography = CAMERA.matrix @ board[:3, [0, 1, 3]] @ to_metres
    picture = cv2.warpPerspective(flat, homography, (CAMERA.width, CAMERA.height), borderValue=(190.0,))
    return np.asarray(cv2.GaussianBlur(picture, (3, 3), 0.7))


def test_millimetres_and_metres_are_one_recording(tmp_path: Path) -> None:
    views = by_poses(12, count=4)
    in_m = read_views(record(tmp_path, views))
    in_mm = read_views(record(tmp_path, views, metres=1e-3))
    for found in (in_m, in_mm):
        assert np.allclose(found.T_base_hand, views.T_base_hand)
        assert np.allclose(found.T_camera_board, views.T_camera_board)


def test_a_recording_of_pictures(tmp_path: Path) -> None:
    rng = np.random.default_rng(13)
    boards = looks(rng, 6)
    hands = hands_of("fixed", boards)
    entries = []
    for i, (hand, board) in enumerate(zip(hands, boards, strict=True)):
        picture = render(board) if i != 2 else np.full((480, 640), 190, np.uint8)
        cv2.imwrite(str(tmp_path / f"{i:03}.png"), picture)
        entries.append({"T_base_hand": hand.tolist(), "image": f"{i:03}.png"})
    setting = {"camera_matrix": CAMERA.matrix.tolist(), "distortion": [0, 0, 0, 0, 0], "board": BOARD}
    content = {"units": "m", "mount": "fixed", "views": entries, **setting}
    (tmp_path / "views.json").write_text(json.dumps(content))
    views = read_views(tmp_path)
    assert views.seen is not None
    result = solve_hand_eye(views)
    assert "reprojection" in result.methods
    assert [name for name, _ in result.dropped] == ["002.png"]
    assert "no marker" in result.dropped[0][1]
    assert difference(result.transform.transform, TRUTH)[0] < 0.002

    cv2.imwrite(str(tmp_path / "004.png"), np.zeros((100, 100), np.uint8))
    with pytest.raises(DataError, match=r"004\.png has 100 x 100 pixels"):
        read_views(tmp_path)
    (tmp_path / "004.png").write_text("no picture")
    with pytest.raises(DataError, match="cannot be read"):
        read_views(tmp_path)
    (tmp_path / "004.png").unlink()
    with pytest.raises(DataError, match="no picture"):
        read_views(tmp_path)
    del content["board"]
    (tmp_path / "views.json").write_text(json.dumps(content))
    with pytest.raises(DataError, match='expected board beside "views"'):
        read_views(tmp_path)


def test_what_is_missing_or_damaged_is_said_in_one_line(tmp_path: Path) -> None:
    views = by_poses(14, count=3)

    def says(words: str, kind: type[Exception] = DataError) -> None:
        with pytest.raises(kind, match=words) as caught:
            read_views(tmp_path)
        assert "\n" not in str(caught.value)

    says("cannot read .*views.json")
    (tmp_path / "views.json").write_text('{"units": ')
    says("is no JSON")
    (tmp_path / "views.json").write_text("[]")
    says("got something else")
    record(tmp_path, views, units="cm")
    says("'cm'")
    record(tmp_path, views, mount="eye")
    says("'eye'")
    record(tmp_path, views, views=3)
    says('expected a list "views"')
    record(tmp_path, views, views=[{"T_camera_board": np.eye(4).tolist()}])
    says("view 0 has no T_base_hand")
    record(tmp_path, views, views=[{"T_base_hand": np.eye(4).tolist()}])
    says("neither T_camera_board nor image")
    far = views.T_base_hand.copy()
    far[:, :3, 3] = 534.2
    record(tmp_path, replace(views, T_base_hand=far))
    says("looks like mm", CalibrationError)
    record(tmp_path, views, units="mm")
    says("looks like metres", CalibrationError)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda pose: np.diag([1.0, 1, -1, 1]) @ pose, "axes swapped or mirrored, view 1"),
        (lambda pose: pose.T, "looks transposed"),
        (lambda pose: np.diag([1.5, 1, 1, 1]) @ pose, "expected a rotation"),
        (lambda pose: pose[:3], "4 x 4"),
        (lambda pose: pose * np.nan, "finite"),
        (lambda pose: [["a"] * 4] * 4, "finite"),
    ],
)
def test_matrices_that_are_no_poses_are_named(tmp_path: Path, change: Any, words: str) -> None:
    views = by_poses(14, count=3)
    wrong = change(views.T_base_hand[1])
    record(tmp_path, views)
    content = json.loads((tmp_path / "views.json").read_text())
    content["views"][1]["T_base_hand"] = wrong if isinstance(wrong, list) else wrong.tolist()
    (tmp_path / "views.json").write_text(json.dumps(content))
    with pytest.raises(CalibrationError, match=words) as caught:
        read_views(tmp_path)
    assert "view 1" in str(caught.value)


def test_rotations_of_few_digits_become_exact(tmp_path: Path) -> None:
    views = by_poses(15, count=3)
    content = json.loads((record(tmp_path, views) / "views.json").read_text())
    for view in content["views"]:
        view["T_base_hand"] = np.round(view["T_base_hand"], 3).tolist()
    (tmp_path / "views.json").write_text(json.dumps(content))
    rotations = read_views(tmp_path).T_base_hand[:, :3, :3]
    assert np.allclose(rotations @ rotations.transpose(0, 2, 1), np.eye(3), atol=1e-12)
    assert np.allclose(rotations, views.T_base_hand[:, :3, :3], atol=2e-3)


def test_a_result_is_read_as_it_was_written(tmp_path: Path) -> None:
    views = replace(with_wrong_views(by_poses(16, count=7), [2]), camera=CameraIdentity("front", 640, 480))
    result = solve_hand_eye(views)
    path = tmp_path / "hand-eye.yaml"
    keys: dict[Mount, str] = {"fixed": "T_base_camera", "hand": "T_hand_camera"}
    for mount, key in keys.items():
        mounted = replace(result, mount=mount)
        mounted.save(path)
        back = HandEye.load(path)
        assert np.array_equal(back.transform.transform, result.transform.transform)
        assert np.array_equal(back.transform.covariance, result.transform.covariance)
        assert np.array_equal(back.board, result.board)
        for name in {each.name for each in fields(HandEye)} - {"transform", "board"}:  # which have arrays
            assert getattr(back, name) == getattr(mounted, name)
        content = yaml.safe_load(path.read_text())
        assert np.array_equal(content[key], result.transform.transform)
        assert content["leave_one_out_mm"] == result.leave_one_out_mm
        assert [drop["view"] for drop in content["dropped"]] == ["view 2"]
    earlier = (
        path.read_text().replace("daniilidis", "horaud").replace(f"method: {result.method}", "method: horaud")
    )
    path.write_text(earlier)  # which had other closed forms
    assert HandEye.load(path).leave_one_out_mm == result.methods["daniilidis"].leave_one_out_mm
    path.write_text(path.read_text().replace("mount:", "mounted:"))
    with pytest.raises(DataError, match="damaged"):
        HandEye.load(path)

    draw_views(result, tmp_path / "views.png")
    assert cv2.imread(str(tmp_path / "views.png")) is not None
