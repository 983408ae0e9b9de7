"""The calibrations as a person runs them: live in the simulator, from folders, interrupted, and given nonsense."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from baggie.calibration.camera_to_world import CameraToWorld
from baggie.calibration.hand_eye.solve import HandEye
from baggie.calibration.image_to_robot.map import ImageToRobot
from baggie.calibration.intrinsics.camera_calibration import CameraCalibration
from baggie.calibration.point_registration import T_world_target, points_to_touch
from baggie.calibration.robot_to_world import CameraToRobot
from baggie.cli.main import main
from baggie.commissioning.check import check_live
from baggie.commissioning.image_to_robot import (
    calibrate_image_to_robot_live,
    check_command,
    grid,
    marker_finder,
    marker_middle,
    parse_marker,
    visit,
)
from baggie.commissioning.session import Person, ViewFolder, open_session
from baggie.errors import BaggieError, CalibrationError, DataError
from baggie.geometry import difference, invert_transform, rigid, transform_points
from baggie.options.commissioning import CheckOptions, ImageToRobotOptions
from baggie.options.values import BOARD, HAND_MARKER
from baggie.pictures import read_picture, write_picture
from baggie.robot.limits import GuardedArm
from baggie.sim.cell import draw_cell
from baggie.types import Intrinsics
from baggie.vision.printing import NAMED
from baggie.vision.targets import ArucoMarker, parse_target
from baggie.workcell.config import open_workcell
from helpers.board_pictures import random_pose, render_board
from helpers.fake_workcell import FakeArm, FakeCell
from helpers.recording_arm import RecordingArm
from helpers.scripted import Scripted

CELL = 3


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Every calibration of one simulated cell, by its command."""
    folder = tmp_path_factory.mktemp("calibrated")
    camera = folder / "camera.yaml"
    cell = ["--cell", str(CELL)]
    lens = ["--intrinsics", str(camera)]
    to_world, to_robot = folder / "camera-to-world.yaml", folder / "robot-to-world.yaml"
    commands = [
        ["intrinsics", *cell, "--out", str(camera)],
        ["image-to-robot", *cell, *lens, "--columns", "3", "--out", str(folder / "image-to-robot.yaml")],
        ["camera-to-world", *cell, *lens, "--frames", "3", "--out", str(to_world)],
        ["robot-to-world", *cell, "--camera-to-world", str(to_world), "--out", str(to_robot)],
        ["hand-eye", *cell, *lens, "--views", "8", "--out", str(folder / "hand-eye.yaml")],
    ]
    for command in commands:
        assert main(["calibrate", *command]) == 0, command
    return folder


@pytest.fixture(scope="module")
def mapped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The quickest calibration of that cell, without knowing its lens: `image-to-robot.yaml`, and what it recorded."""
    folder = tmp_path_factory.mktemp("mapped")
    out = ["--cell", str(CELL), "--columns", "3", "--out", str(folder / "image-to-robot.yaml")]
    assert main(["calibrate", "image-to-robot", *out]) == 0
    return folder


@pytest.mark.slow
def test_the_simulated_cell_calibrates_itself_to_the_millimetre(calibrated: Path) -> None:
    cell = draw_cell(CELL)
    lens = CameraCalibration.load(calibrated / "camera.yaml").intrinsics
    spots = grid(open_workspace(), 0.0, (0.0,))
    rays = lens.rays(cell.project(spots))
    truth = transform_points(cell.T_camera_base, spots)
    assert 1000 * np.abs(rays * truth[:, 2:] - truth[:, :2]).max() < 1.0

    on_table = ImageToRobot.load(calibrated / "image-to-robot.yaml").at_height(0.0)
    errors = np.linalg.norm(on_table.to_robot(cell.project(spots)) - spots[:, :2], axis=1)
    assert 1000 * np.sqrt((errors**2).mean()) < 1.5

    T_base_camera = invert_transform(cell.T_camera_base)
    assert HandEye.load(calibrated / "hand-eye.yaml").leave_one_out_mm < 2.0
    for found in (
        CameraToRobot.load(calibrated / "camera-to-robot.yaml").pose.transform,
        CameraToRobot.load(calibrated / "hand-eye-camera-to-robot.yaml").pose.transform,
    ):
        shift, turn = difference(found, T_base_camera)
        assert 1000 * shift < 3.0
        assert np.degrees(turn) < 0.3


def open_workspace():
    return FakeCell().settings.workspace


@pytest.mark.slow
def test_pictures_beside_the_results_show_them(calibrated: Path) -> None:
    for name in (
        "camera.png",
        "image-to-robot.png",
        "hand-eye.png",
        "camera.live.jpg",
        "image-to-robot/reference.png",
    ):
        assert read_picture(calibrated / name).shape[0] > 100, name


@pytest.mark.slow
def test_a_workcell_file_points_to_its_calibrations(calibrated: Path) -> None:
    lines = [
        "arm: sim",
        f"cell: {CELL}",
        "calibrations:",
        "  intrinsics: camera.yaml",
        "  image_to_robot: image-to-robot.yaml",
    ]
    (calibrated / "cell.yaml").write_text("\n".join([*lines, "  camera_to_robot: camera-to-robot.yaml"]))
    cell = open_workcell(calibrated / "cell.yaml")
    try:
        assert cell.calibrations.image_to_robot is not None
        assert cell.look().intrinsics == cell.calibrations.intrinsics.intrinsics
    finally:
        cell.close()
    (calibrated / "other.yaml").write_text("\n".join([lines[0], "cell: 4", *lines[2:]]))
    with pytest.raises(CalibrationError, match="cell 3"):
        open_workcell(calibrated / "other.yaml")


def test_the_check_measures_and_an_old_map_fails_it(
    mapped: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    options = CheckOptions(map=mapped / "image-to-robot.yaml", cell=CELL, points=2, touches=1)
    with open_session(options) as session:
        good = check_live(session, ImageToRobot.load(options.map), options)
        assert good["held_out_mm"]["max"] < 1.5
        assert good["touch_mm"]["max"] < 2.0
        assert good["background_moved_px"] < 0.5
        session.cell.bump_camera([0.008, 0.0, 0.0], [0.0, 0.0, 0.0])
        bad = check_live(session, ImageToRobot.load(options.map), options)
        assert bad["touch_mm"]["mean"] > 4.0
        assert bad["background_moved_px"] > 2.0


def test_what_was_recorded_is_solved_again_offline(mapped: Path, tmp_path: Path) -> None:
    out = tmp_path / "again.yaml"
    assert (
        main(["calibrate", "image-to-robot", "--from", str(mapped / "image-to-robot"), "--out", str(out)])
        == 0
    )
    first, again = (ImageToRobot.load(path) for path in (mapped / "image-to-robot.yaml", out))
    np.testing.assert_array_equal(again.projection, first.projection)


@pytest.mark.slow
def test_whatever_was_recorded_is_solved_again_offline(calibrated: Path, tmp_path: Path) -> None:
    lens = ["--intrinsics", str(calibrated / "camera.yaml")]
    for name, words, load in (
        ("image-to-robot", lens, lambda path: ImageToRobot.load(path).projection),
        ("camera-to-world", lens, lambda path: CameraToWorld.load(path).pose.transform),
        ("hand-eye", lens, lambda path: HandEye.load(path).transform.transform),
    ):
        recorded, again = calibrated / name, tmp_path / f"{name}.yaml"
        assert main(["calibrate", name, *words, "--from", str(recorded), "--out", str(again)]) == 0
        np.testing.assert_array_equal(load(again), load(recorded.with_suffix(".yaml")))
    command = ["calibrate", "robot-to-world", "--from", str(calibrated / "robot-to-world")]
    assert main([*command, "--out", str(tmp_path / "robot-to-world.yaml")]) == 0


def test_a_marker_that_is_not_where_it_is_said_to_be_is_noticed(
    mapped: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    recording = ["--from", str(mapped / "image-to-robot"), "--out", str(tmp_path / "map.yaml")]
    assert main(["calibrate", "image-to-robot", *recording, "--marker-in-hand", "0.115", "0.0", "0.0"]) == 1
    assert "--marker-in-hand 0.130" in capsys.readouterr().err
    assert not (tmp_path / "map.yaml").exists()


@pytest.mark.slow
def test_a_coloured_blob_serves_as_a_marker(tmp_path: Path) -> None:
    marker = ["--marker", "color:217,13,191", "--marker-in-hand", "0.09", "0", "0", "--columns", "3"]
    out = tmp_path / "map.yaml"
    assert main(["calibrate", "image-to-robot", *marker, "--cell", str(CELL), "--out", str(out)]) == 0
    spots = grid(open_workspace(), 0.0, (0.0,))
    errors = ImageToRobot.load(out).to_robot(draw_cell(CELL).project(spots)) - spots[:, :2]
    assert 1000 * np.sqrt((errors**2).sum(axis=1).mean()) < 1.5


def test_an_interrupted_calibration_goes_on(
    mapped: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One whose last two points are missing is stopped after the first of them, and finished."""
    recorded = shutil.copytree(mapped / "image-to-robot", tmp_path / "map") / "views.json"
    content = json.loads(recorded.read_text())
    whole = content["views"]
    recorded.write_text(json.dumps(content | {"views": whole[:-2]}))
    options = ImageToRobotOptions(out=tmp_path / "map.yaml", cell=CELL, columns=3)
    with open_session(options) as session:
        take, calls = session.camera.look, []

        def look_until_stopped():
            calls.append(1)
            if len(calls) == 2:  # a point, and then somebody presses Ctrl-C
                raise KeyboardInterrupt
            return take()

        monkeypatch.setattr(session.camera, "look", look_until_stopped)
        with pytest.raises(KeyboardInterrupt, match=f"after {len(whole) - 1} of 18 points"):
            calibrate_image_to_robot_live(session, options)
        before = json.loads(recorded.read_text())["views"]
        assert before[:-1] == whole[:-2]
        assert len(before) == len(whole) - 1
        fitted = calibrate_image_to_robot_live(session, options)
        after = json.loads(recorded.read_text())["views"]
    assert after[: len(before)] == before
    points = [view["point"] for view in after]
    assert len(points) == len(set(points))
    assert set(points) >= {view["point"] for view in whole}  # one that went unseen may be seen this time
    assert len(fitted.residuals.points) == len(points)


def test_the_check_that_is_named_next_is_of_the_same_workcell_and_marker() -> None:
    plain = ImageToRobotOptions(out=Path("map.yaml"))
    assert check_command(plain) == "baggie calibrate check --map map.yaml"
    assert check_command(replace(plain, cell=7)) == "baggie calibrate check --cell 7 --map map.yaml"
    lab = replace(plain, workcell="lab.yaml", marker="color:217,13,191", marker_in_hand=(0.09, 0.0, 0.0))
    assert check_command(lab) == (
        "baggie calibrate check --workcell lab.yaml --map map.yaml --marker color:217,13,191 --marker-in-hand 0.09 0 0"
    )


# -- folders ---------------------------------------------------------------------------------------


def test_a_view_folder_keeps_what_it_was_given_and_refuses_another_beginning(tmp_path: Path) -> None:
    folder = ViewFolder(tmp_path / "views", {"board": "a"})
    picture = np.random.default_rng(0).integers(0, 255, (20, 30, 3)).astype(np.uint8)
    folder.append({"x": 1.5}, picture)
    folder.append({"x": 2.5})
    again = ViewFolder(tmp_path / "views", {"board": "a"})
    assert again.views == [{"x": 1.5, "image": "000.png"}, {"x": 2.5}]
    np.testing.assert_array_equal(read_picture(tmp_path / "views" / "000.png"), picture)
    with pytest.raises(CalibrationError, match="begun with board"):
        ViewFolder(tmp_path / "views", {"board": "b"})
    (tmp_path / "views" / "views.json").write_text("{")
    with pytest.raises(DataError, match=r"views\.json"):
        ViewFolder(tmp_path / "views", {"board": "a"})


# -- targets, points, the world --------------------------------------------------------------------


@pytest.mark.parametrize("bent", [0.0, -0.2])
def test_a_marker_s_middle_is_where_its_diagonals_cross_but_for_the_lens(bent: float) -> None:
    matrix = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    lens = Intrinsics(640, 480, matrix, np.array([bent, 0.0, 0.0, 0.0, 0.0]))
    marker = parse_target("aruco:DICT_4X4_50:0:0.10")
    assert isinstance(marker, ArucoMarker)
    rng = np.random.default_rng(1)
    for _ in range(4):
        pose = random_pose(marker, lens, rng, near=0.3)
        found = marker_finder(marker)(render_board(marker, pose, lens, rng))
        assert found is not None
        middle = lens.project(pose[None, :3, 3])[0]
        assert np.linalg.norm(marker_middle(found, lens) - middle) < 0.3


def test_where_a_marker_s_middle_appears_is_exact_in_every_perspective_and_lens() -> None:
    matrix = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    bent = Intrinsics(640, 480, matrix, np.array([-0.3, 0.1, 0.001, -0.002]))
    corners = 0.04 * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    pose = rigid(Rotation.from_euler("xyz", [0.4, -0.3, 0.5]).as_matrix(), [0.2, 0.1, 0.6])
    middle = bent.project(pose[None, :3, 3])[0]
    seen = bent.project(transform_points(pose, corners))
    np.testing.assert_allclose(marker_middle(seen, bent), middle, atol=1e-6)
    assert np.linalg.norm(marker_middle(seen) - middle) > 0.05  # bent lines cross elsewhere
    np.testing.assert_array_equal(marker_middle(middle[None], bent), middle)  # a blob's is as it was found


def test_the_marker_is_brought_to_where_it_is_wanted() -> None:
    cell, in_hand = FakeCell(), np.array([0.13, 0.02, 0.01])
    positions = grid(cell.settings.workspace, 0.05, (0.05, 0.15), columns=2, rows=2)
    cell.arm = FakeArm()
    for number, hand, _ in visit(cell.arm, cell.camera, positions, in_hand):
        np.testing.assert_allclose(transform_points(hand, in_hand[None])[0], positions[number], atol=1e-12)


def test_the_marker_is_brought_everywhere_by_a_slow_arm_and_in_a_slow_cell() -> None:
    cell, in_hand = FakeCell(), np.zeros(3)
    positions = grid(cell.settings.workspace, 0.05, (0.05, 0.15), columns=2, rows=2)
    slow = RecordingArm()
    slow.info = replace(slow.info, max_speed_m_s=0.1)
    for arm, fastest in ((slow, 0.1), (RecordingArm(), 0.2)):
        gate = GuardedArm(arm, replace(cell.settings.limits, max_speed_m_s=0.2))
        assert len(list(visit(gate, cell.camera, positions, in_hand))) == len(positions)
        assert set(arm.speeds) == {fastest}


@pytest.mark.parametrize(
    "spec", ["color:1,2", "color:red", "charuco:7x5:0.03:0.02:DICT_4X4_50", "aruco:4x4", ""]
)
def test_a_marker_that_cannot_be_read_is_one_line(spec: str) -> None:
    with pytest.raises(BaggieError) as caught:
        parse_marker(spec)
    assert "\n" not in str(caught.value)


def test_the_world_lies_on_the_print_s_lower_left_point_with_z_up() -> None:
    for spec in (BOARD, HAND_MARKER, "chessboard:7x5:0.03"):
        target = parse_target(spec)
        points = transform_points(T_world_target(target), target.points)
        assert points.min(axis=0) == pytest.approx(np.zeros(3))
        touched = points_to_touch(target, axes_only=False)
        assert np.linalg.norm(touched[0][1]) == 0
        for _, point in touched:  # each is a printed corner
            assert np.linalg.norm(points - point, axis=1).min() < 1e-9
    assert len(points_to_touch(parse_target(BOARD), axes_only=True)) == 3


def test_every_target_we_name_can_be_read_and_printed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in (*NAMED, "goal-card"):
        out = tmp_path / f"{name}.pdf"
        assert main(["print-target", name, "--out", str(out), "--json"]) == 0
        assert json.loads(capsys.readouterr().out)["pdf"] == str(out)
        assert out.read_bytes().startswith(b"%PDF")
    assert (
        main(["print-target", "charuco:20x20:0.05:0.03:DICT_6X6_250", "--out", str(tmp_path / "big.pdf")])
        == 1
    )
    assert main(["print-target", "board", "--out", str(tmp_path / "board.doc")]) == 2


# -- people ----------------------------------------------------------------------------------------


def test_where_all_is_prepared_nobody_is_asked_but_for_what_comes_later() -> None:
    someone = Scripted(*[""] * 4)
    for prepared in (True, False):
        person = Person(someone, prepared=prepared)
        person.clear_table()
        person.hold(None, "fix it to the hand")
        person.lay(parse_target(HAND_MARKER), "lay it down")
    assert someone.asked == [
        "lay it down",
        "take everything off the table",
        "fix it to the hand",
        "lay it down",
    ]


def test_a_person_s_measurement_is_read_or_left_out() -> None:
    person = Person(Scripted("1 -0.5", "", "far off"))
    np.testing.assert_allclose(person.measure_touch("there"), [0.001, -0.0005])
    assert person.measure_touch("there") is None
    assert person.measure_touch("there") is None


# -- real pictures from disk, through the command --------------------------------------------------


@pytest.fixture(scope="module")
def board_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("board")
    lens, board, rng = draw_cell(0).lens.intrinsics, parse_target(BOARD), np.random.default_rng(0)
    for number in range(8):
        write_picture(
            folder / f"{number:03d}.png", render_board(board, random_pose(board, lens, rng), lens, rng)
        )
    return folder


def test_intrinsics_from_a_folder_give_the_keys_that_were_promised(
    board_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    import yaml

    out = tmp_path / "camera.yaml"
    command = [
        "calibrate",
        "intrinsics",
        "--from",
        str(board_folder),
        "--board",
        BOARD,
        "--out",
        str(out),
        "--json",
    ]
    assert main(command) == 0
    result, written = json.loads(capsys.readouterr().out), yaml.safe_load(out.read_text())
    truth = draw_cell(0).lens.intrinsics
    for content in (result, written):
        np.testing.assert_allclose(content["camera_matrix"], truth.matrix, atol=3.0)
        assert len(content["distortion"]) == 5
        assert content["rms_px"] < 0.3
        assert content["dropped"] == []


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("empty", "picture"),
        ("resolution", "1280 x 720"),
        ("mirrored", "mirrored"),
        ("other-board", "dictionar|DICT"),
        ("blank", "no marker"),
    ],
)
def test_pictures_that_cannot_be_used_are_one_clear_line(
    board_folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], change: str, words: str
) -> None:
    import re

    board = "charuco:12x8:0.032:0.024:DICT_6X6_50" if change == "other-board" else BOARD
    for path in sorted(board_folder.glob("*.png"))[: 0 if change == "empty" else 5]:
        picture = read_picture(path)
        if change == "resolution" and path.stem == "003":
            picture = cv2.resize(picture, (640, 360))
        elif change == "mirrored":
            picture = np.ascontiguousarray(picture[:, ::-1])
        elif change == "blank":
            picture = np.full_like(picture, 128)
        write_picture(tmp_path / "pictures" / path.name, picture)
    (tmp_path / "pictures").mkdir(exist_ok=True)
    out = tmp_path / "camera.yaml"
    command = [
        "calibrate",
        "intrinsics",
        "--from",
        str(tmp_path / "pictures"),
        "--board",
        board,
        "--out",
        str(out),
    ]
    assert main(command) == 1
    errors = [line for line in capsys.readouterr().err.splitlines() if line.startswith("error:")]
    assert len(errors) == 1
    assert re.search(words, errors[0]), errors
    assert not out.exists()


def swap_axes(recorded: Path, folder: Path) -> list[str]:
    """The command that maps from a copy of what was recorded, in `folder`, with x for y and y for x."""
    content = json.loads((recorded / "views.json").read_text())
    offset = np.array([[0.13, 0.0, 0.0]])
    for view in content["views"]:
        x, y, z = transform_points(view.pop("T_base_hand"), offset)[0]
        view["base"] = [y, x, z]
    (folder / "views.json").write_text(json.dumps(content))
    return ["calibrate", "image-to-robot", "--from", str(folder), "--out", str(folder / "map.yaml")]


def test_a_swapped_x_and_y_axis_is_refused(
    mapped: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(swap_axes(mapped / "image-to-robot", tmp_path)) == 1
    assert "swapped" in capsys.readouterr().err


@pytest.mark.slow
def test_a_swapped_x_and_y_axis_is_refused_with_a_known_lens_too(
    calibrated: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lens = ["--intrinsics", str(calibrated / "camera.yaml")]
    assert main([*swap_axes(calibrated / "image-to-robot", tmp_path), *lens]) == 1
    assert "swapped" in capsys.readouterr().err
