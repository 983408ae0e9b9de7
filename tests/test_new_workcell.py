import re
import shutil
import sys
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import ClassVar, Literal

import cv2
import numpy as np
import pytest

import baggie
from baggie.cameras import OpenCVSettings, PythonCameraEntry, RealSenseSettings
from baggie.commissioning.new_workcell import ASKED, new_workcell
from baggie.errors import BaggieError, ReachError
from baggie.geometry import ToolPose
from baggie.options.commissioning import NewWorkcellOptions
from baggie.registry import ARMS, CAMERAS
from baggie.robot.arm import ArmEntry
from baggie.robot.franka import FrankaEntry
from baggie.robot.lerobot import LeRobotEntry
from baggie.workcell.workcell_file import (
    BagEntry,
    ReplayEntry,
    SimulatedEntry,
    WorkcellFile,
    read_workcell_file,
)
from helpers.scripted import Scripted


def write(path: Path, *answers: str) -> WorkcellFile:
    """What is read of a file that somebody wrote who gave these answers, and then took every default."""
    new_workcell(NewWorkcellOptions(path), operator=Scripted(*answers, *[""] * 30))
    return read_workcell_file(path)


def test_enter_alone_gives_a_slow_franka(tmp_path: Path) -> None:
    written = write(tmp_path / "cell.yaml")
    assert isinstance(written.arm, FrankaEntry)
    assert (written.arm.speed, written.arm.model) == (0.1, "fr3")
    assert written.camera == OpenCVSettings(source="0")


def test_every_kind_of_arm_and_camera_that_a_file_can_name_is_offered() -> None:
    kinds = ARMS.names()
    assert sorted(ASKED) == sorted(kinds)
    person = Scripted()
    with pytest.raises(BaggieError, match="nobody answers"):
        new_workcell(NewWorkcellOptions(Path("nowhere/cell.yaml")), operator=person)
    assert all(kind in person.asked[0] for kind in kinds)


class PackagedEntry(ArmEntry):
    """As another package has it."""

    kind: Literal["packaged"]
    about: ClassVar[str] = "another package's"
    address: str
    gain: float = 1.0


def test_a_kind_of_another_package_is_offered_and_asked_for_what_has_no_default(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    point = EntryPoint("packaged", f"{__name__}:PackagedEntry", ARMS.group)
    monkeypatch.setitem(vars(ARMS), "_others", {"packaged": point})
    person = Scripted("packaged", "10.0.0.1", *[""] * 20)
    new_workcell(NewWorkcellOptions(tmp_path / "cell.yaml"), operator=person)
    assert "packaged, another package's" in person.asked[0]
    assert read_workcell_file(tmp_path / "cell.yaml").arm == PackagedEntry(
        kind="packaged", address="10.0.0.1"
    )


@pytest.mark.parametrize("kind", [kind for kind in ASKED if kind != "replay"])
def test_every_kind_has_defaults_that_are_read_without_an_error(tmp_path: Path, kind: str) -> None:
    assert write(tmp_path / "cell.yaml", kind).arm.kind == kind


def test_what_was_answered_is_what_is_read(tmp_path: Path) -> None:
    franka = ("franka", "10.0.0.7", "panda", "0.2", "no")
    bag = ("0.4 0.6", "-0.2, 0.1", "0.04 0.06", "0.05", "yes", "1 2 3")
    written = write(tmp_path / "cell.yaml", *franka, "realsense", "any", *bag)
    assert written.arm == FrankaEntry(
        kind="franka", host="10.0.0.7", model="panda", speed=0.2, realtime=False
    )
    assert written.camera == RealSenseSettings()
    assert (written.workspace.x, written.workspace.y) == ((0.4, 0.6), (-0.2, 0.1))
    assert written.bag == BagEntry(length_m=0.06, width_m=0.04, height_m=0.05, hard=True, color=(1, 2, 3))


@pytest.mark.parametrize("kind", [kind for kind in CAMERAS.names() if kind not in ("sim", "python")])
def test_every_kind_of_camera_has_a_source(tmp_path: Path, kind: str) -> None:
    source = "043422070123"  # digits, which YAML would take for a number in base 8
    franka = ("franka", "", "", "", "")
    assert write(tmp_path / "cell.yaml", *franka, kind, source).camera == CAMERAS[kind](source=source)


def test_a_camera_of_one_s_own_gets_its_options(tmp_path: Path) -> None:
    answers = ("franka", "", "", "", "", "python", "my_lab.eye:open_eye", "gain=3")
    camera = write(tmp_path / "cell.yaml", *answers).camera
    assert isinstance(camera, PythonCameraEntry)
    assert (camera.factory, camera.model_extra) == ("my_lab.eye:open_eye", {"gain": 3})


def test_a_file_of_pictures_has_to_be_there(tmp_path: Path) -> None:
    film = tmp_path / "table.avi"
    film.touch()
    answers = ("franka", "", "", "", "", "opencv", "webcam", str(film))
    assert write(tmp_path / "cell.yaml", *answers).camera == OpenCVSettings(source=str(film))


def test_the_defaults_of_a_small_lerobot_arm_are_those_of_the_guide(tmp_path: Path) -> None:
    guide = (Path(__file__).parents[1] / "docs" / "own-arm.md").read_text()
    (example,) = re.findall(r"```yaml\n(arm:\n  kind: lerobot\n.*?)```", guide, re.DOTALL)
    (tmp_path / "guide.yaml").write_text(example)
    expected = read_workcell_file(tmp_path / "guide.yaml")
    assert isinstance(expected.arm, LeRobotEntry)
    id_and_model = ("left", str(expected.arm.model))
    written = write(tmp_path / "cell.yaml", "lerobot", "", "", *id_and_model, "", "", "0.12")
    assert isinstance(written.arm, LeRobotEntry)
    own = {
        "speed": expected.arm.speed,
        "widths": expected.arm.widths,
    }  # of one that was measured, and watched
    assert written.arm.model_copy(update=own) == expected.arm
    assert written.model_copy(update={"arm": expected.arm}) == expected


def test_another_lerobot_arm_says_what_it_is(tmp_path: Path) -> None:
    person = Scripted(
        *("lerobot", "koch", "-", "-", "", "koch.xml", "grip", "1 2 3", "0", "a b", "normalized"),
        *("1 2 3", "-5 7", "0.5", "0.05", "0.3", *[""] * 9),
    )
    new_workcell(NewWorkcellOptions(tmp_path / "cell.yaml"), operator=person)
    written = read_workcell_file(tmp_path / "cell.yaml")
    arm = written.arm
    assert isinstance(arm, LeRobotEntry)
    assert (arm.port, arm.id, arm.tool, arm.tool_rpy_deg) == (None, None, "grip", (1, 2, 3))
    assert ([joint.name for joint in arm.joints], arm.park, arm.units) == (["a", "b"], (-5, 7), "normalized")
    assert (arm.widths[-1][1], arm.speed) == (0.05, 0.3)
    assert not written.handling.written, "it follows from the gripper"
    hints = [prompt for prompt in person.asked if "will not do" in prompt]
    assert [hint.partition(";")[0] for hint in hints] == [
        "'' will not do (expected an answer)",
        "'1 2 3' will not do (expected 2 of them, apart by spaces)",
        "'0.5' will not do (expected 0.01 to 0.3)",
    ]


def test_an_arm_of_one_s_own_gets_its_options_and_opens(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "path", sys.path[:])
    example = Path(__file__).parents[1] / "examples" / "04_own_arm.py"
    shutil.copy(example, tmp_path / "asked_arm.py")
    film = cv2.VideoWriter(str(tmp_path / "table.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 10, (64, 48))
    film.write(np.zeros((48, 64, 3), np.uint8))
    film.release()
    person = Scripted(
        *("python", "asked_arm", "asked_arm:open_arm", "reach_m", "kind=x", "reach_m=0.7"),
        *("opencv", str(tmp_path / "table.avi"), *[""] * 9),
    )
    new_workcell(NewWorkcellOptions(tmp_path / "cell.yaml"), operator=person)
    assert len([prompt for prompt in person.asked if "will not do" in prompt]) == 3
    cell = baggie.open_workcell(tmp_path / "cell.yaml")
    assert (cell.arm.info.name, cell.settings.handling.open_width_m) == ("imaginary arm", 0.08)
    with pytest.raises(ReachError, match=r"reaches 0\.70 m"):
        cell.arm.move_to(ToolPose(0.65, 0.3, 0.3), 0.5)
    cell.close()


def test_a_recording_to_replay_has_to_be_there_and_needs_neither_camera_nor_bag(tmp_path: Path) -> None:
    (tmp_path / "bags").mkdir()
    person = Scripted("replay", "nowhere", "bags", "", "")
    new_workcell(NewWorkcellOptions(tmp_path / "cell.yaml"), operator=person)
    arm = read_workcell_file(tmp_path / "cell.yaml").arm
    assert isinstance(arm, ReplayEntry)
    assert arm.recording == Path("bags")
    assert "'nowhere' will not do (expected a folder that is there)" in person.asked[2]
    assert len(person.asked) == 5


@pytest.mark.parametrize(
    ("right", "wrong"),
    [
        (["franka"], "my robot"),
        (["franka", "", "panda"], "0"),  # not even slowly
        (["franka", "", "panda"], "nan"),
        (["sim"], "3.5"),
        (["sim", "0"], "0.3 inf"),
        (["sim", "0"], "350 650"),  # millimetres
        (["lerobot", "", "", "", "", "", ""], "120"),
        (["sim", "0", "0.3 0.6", ""], "0.5 0.5"),  # no bag is as large
        (["sim", "0", "0.3 0.6", ""], "0.05 0.05"),  # nor as small, in a simulated cell
        (["sim", "0", "0.3 0.6", ""], "0.1"),
        (["sim", "0", "0.3 0.6", "", ""], "1 2 256"),
        (["python"], "own arm"),
    ],
)
def test_a_bad_answer_is_asked_again_in_one_line(tmp_path: Path, right: list[str], wrong: str) -> None:
    path = tmp_path / "cell.yaml"
    person = Scripted(*right, wrong, *[""] * 20)
    new_workcell(NewWorkcellOptions(path), operator=person)
    again = person.asked[len(right) + 1]
    assert again.startswith(f"{wrong!r} will not do (")
    assert again.endswith(person.asked[len(right)])
    assert "\n" not in again
    read_workcell_file(path)


def test_a_wrong_answer_is_asked_again_with_what_is_expected(tmp_path: Path) -> None:
    path = tmp_path / "cell.yaml"
    person = Scripted("robot", "sim", "-3", "x", "7", "0.6 0.4", "0.4", *[""] * 9)
    new_workcell(NewWorkcellOptions(path), operator=person)
    written = read_workcell_file(path)
    assert (written.arm, written.cell) == (SimulatedEntry(), 7)
    assert "'robot' will not do (expected franka, lerobot, python, replay or sim)" in person.asked[1]
    assert "'-3' will not do (Input should be greater than or equal to 0)" in person.asked[3]
    assert "(expected the lower bound first, got 0.6 and 0.4)" in person.asked[6]


def test_nothing_that_is_there_is_written_over(tmp_path: Path) -> None:
    path = tmp_path / "cell.yaml"
    path.write_text("mine")
    with pytest.raises(BaggieError, match="is there already"):
        new_workcell(NewWorkcellOptions(path), operator=Scripted())
    assert path.read_text() == "mine"


def test_nobody_there_is_said_and_nothing_written(tmp_path: Path) -> None:
    with pytest.raises(BaggieError, match="nobody answers"):
        new_workcell(NewWorkcellOptions(tmp_path / "cell.yaml"), operator=Scripted("sim"))
    assert not (tmp_path / "cell.yaml").exists()
