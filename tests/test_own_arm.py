"""The template of examples/04_own_arm.py, and how a workcell file opens an arm of one's own."""

from __future__ import annotations

import re
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import baggie
from baggie.cameras.camera import check_camera
from baggie.errors import ArmError, BaggieError, LimitError, ReachError
from baggie.geometry import PlanarPose, ToolPose
from baggie.robot.contract import FORCE_N, check_arm
from baggie.robot.lerobot import LeRobotEntry
from baggie.robot.lerobot.arm import LeRobotArm
from baggie.robot.limits import GuardedArm
from baggie.robot.primitives import Handling, least_turn, pick, place
from baggie.types import PickPlace
from baggie.workcell.workcell import WorkcellSettings
from baggie.workcell.workcell_file import read_workcell_file
from helpers.lerobot_robot import FR3, NumbersRobot, settings
from helpers.recording_arm import RecordingArm

ROOT = Path(__file__).parents[1]
EXAMPLE = ROOT / "examples" / "04_own_arm.py"
LIMITS = WorkcellSettings().limits


@pytest.fixture(scope="module")
def own_arm() -> Iterator[ModuleType]:
    import importlib.util

    spec = importlib.util.spec_from_file_location("example_own_arm", EXAMPLE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["example_own_arm"] = module
    spec.loader.exec_module(module)
    yield module
    del sys.modules["example_own_arm"]


def opened(own_arm: ModuleType, **robot: Any) -> Any:
    return own_arm.OwnArm(own_arm.ImaginaryRobot(**robot), 0.85, sleep=lambda _: None)


def test_the_template_keeps_the_contract(own_arm: ModuleType) -> None:
    check_arm(GuardedArm(opened(own_arm), LIMITS))


class Slept:
    """The time that passes while the template sleeps."""

    now = 0.0

    def sleep(self, seconds: float) -> None:
        self.now += seconds


@pytest.mark.parametrize("sign", [1, 0, -1])
def test_the_template_feels_a_firm_thing_and_would_be_found_out(own_arm: ModuleType, sign: int) -> None:
    time = Slept()
    robot = own_arm.ImaginaryRobot(table_z=0.04)
    felt = own_arm.ImaginaryRobot.upward_force_n.fget
    sick = type("Sick", (own_arm.ImaginaryRobot,), {"upward_force_n": property(lambda r: sign * felt(r))})
    robot.__class__ = sick
    arm = own_arm.OwnArm(robot, 0.85, sleep=time.sleep)

    def check() -> list[str]:
        return check_arm(
            GuardedArm(arm, LIMITS), firm_height_m=0.04, tool_x=lambda: arm.pose().yaw, clock=lambda: time.now
        )

    if sign > 0:
        assert check()[0] == "force: felt 3 times at z 40 mm, on a thing of 40 mm"
        return
    with pytest.raises(AssertionError, match="pushed on for as long as through the air"):
        check()


def test_the_template_feels_the_table_and_what_it_holds(own_arm: ModuleType) -> None:
    arm = opened(own_arm, table_z=0.05, thing_m=0.02)
    handling, start, goal = Handling(), PlanarPose(0.5, 0.1), PlanarPose(0.45, -0.1)
    grasp = pick(GuardedArm(arm, LIMITS), start, handling)
    assert grasp.held
    release = place(GuardedArm(arm, LIMITS), goal, handling)
    for pose, where in ((grasp.pose, start), (release.pose, goal)):
        np.testing.assert_allclose(pose.xyz, where.at_height(0.05).xyz, atol=1e-9)


@pytest.mark.parametrize(
    ("symmetry", "pick_deg", "place_deg"), [(4, 45, 90), (2, 90, 180), (1, 90, 270), (0, 0, 0)]
)
def test_the_yaws_that_the_guide_calls_enough_are_enough(
    symmetry: int, pick_deg: int, place_deg: int
) -> None:
    arm, angles = GuardedArm(RecordingArm(), LIMITS), np.linspace(-np.pi, np.pi, 25)
    turned = [
        least_turn(arm, PickPlace(PlanarPose(0.5, 0.0, a), PlanarPose(0.5, 0.1, b)), Handling(), symmetry)
        for a in angles
        for b in angles
    ]
    picks, places = (
        np.rad2deg([abs(getattr(action, end).yaw) for action in turned]) for end in ("pick", "place")
    )
    assert picks.max() == pytest.approx(pick_deg, abs=8)
    assert places.max() == pytest.approx(place_deg, abs=16)
    assert picks.max() <= pick_deg + 1e-6
    assert places.max() <= place_deg + 1e-6
    span = "0 | 0" if symmetry == 0 else f"-{pick_deg} to {pick_deg} | -{place_deg} to {place_deg}"
    assert f"| {span} |" in (ROOT / "docs" / "own-arm.md").read_text()


def test_the_speeds_and_forces_that_the_guide_names_are_the_defaults() -> None:
    text, handling = (ROOT / "docs" / "own-arm.md").read_text(), Handling()
    for name in ("fast_m_s", "carry_m_s", "feel_m_s"):
        assert f"| `{name}` | {getattr(handling, name):g} |" in text
    assert (
        f"asks for {handling.touch_force_n:g} N when it picks (`touch_force_n`) and {handling.land_force_n:g} N"
        in text
    )
    assert f"`max_contact_force_n`, {LIMITS.max_contact_force_n:g} N" in text
    assert f"the doctor for\n  {FORCE_N:g} N" in text


@given(st.floats(-1, 1), st.floats(-1, 1), st.floats(0, 1))
def test_the_template_goes_there_or_says_why_not_and_stays(
    own_arm: ModuleType, x: float, y: float, z: float
) -> None:
    arm, target = opened(own_arm), ToolPose(x, y, z, 0.4)
    before = arm.pose()
    if np.linalg.norm(target.xyz) <= 0.85:
        np.testing.assert_allclose(arm.move_to(target, 0.5).xyz, target.xyz, atol=1e-9)
    else:
        with pytest.raises(ReachError):
            arm.move_to(target, 0.5)
        assert arm.pose() == before


def test_the_template_is_never_faster_than_asked_and_stops(own_arm: ModuleType) -> None:
    seen = []
    arm = opened(own_arm)
    arm._sleep = lambda _: seen.append(arm.pose().xyz)
    arm.move_to(ToolPose(0.5, 0.1, 0.2), 0.25)
    assert np.linalg.norm(np.diff(seen, axis=0), axis=1).max() <= 0.25 * own_arm.PERIOD_S + 1e-9
    arm._sleep = lambda _: arm.stop()
    with pytest.raises(ArmError, match="was stopped"):
        arm.move_to(ToolPose(0.5, -0.1, 0.2), 0.25)
    assert arm.pose().y > 0.09


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    writer = cv2.VideoWriter(str(tmp_path / "table.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 10, (64, 48))
    writer.write(np.zeros((48, 64, 3), np.uint8))
    writer.release()
    return tmp_path


def written(folder: Path, arm: str, more: str = "") -> Path:
    path = folder / "cell.yaml"
    path.write_text(f"arm: {arm}\ncamera: {folder / 'table.avi'}\n{more}")
    return path


def test_a_workcell_file_opens_an_arm_that_lies_beside_it(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "path", sys.path[:])
    shutil.copy(EXAMPLE, folder / "an_arm_of_my_own.py")
    cell = baggie.open_workcell(
        written(folder, "{kind: python, factory: 'an_arm_of_my_own:open_arm', reach_m: 0.6}")
    )
    assert cell.arm.info.name == "imaginary arm"
    with pytest.raises(ReachError, match=r"reaches 0\.60 m"):
        cell.arm.move_to(ToolPose(0.6, 0.3, 0.3), 0.5)
    with pytest.raises(LimitError):
        cell.execute(PickPlace(PlanarPose(0.45, 0.0), PlanarPose(0.9, 0.0)))
    cell.close()


def test_a_workcell_file_opens_a_camera_that_lies_beside_it(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "path", sys.path[:])
    shutil.copy(EXAMPLE, folder / "beside_arm.py")
    shutil.copy(ROOT / "examples" / "03_own_camera.py", folder / "beside_camera.py")
    path = folder / "cell.yaml"
    path.write_text(
        "arm: {kind: python, factory: 'beside_arm:open_arm'}\n"
        "camera: {kind: python, factory: 'beside_camera:open_camera', width: 320, height: 240}\n"
    )
    cell = baggie.open_workcell(path)
    check_camera(cell.camera)
    before, seen, after = cell.clock(), cell.look(), cell.clock()
    assert seen.size == (320, 240)
    assert before - 0.1 <= seen.time <= after + 0.1
    cell.close()


WRONG_CAMERAS = """
class Blind:
    name = "blind"
    size = (640, 480)
    intrinsics = None

class Flat(Blind):
    size = 640
    def look(self): ...

def open_eye(gain=1): ...
"""


@pytest.mark.parametrize(
    ("camera", "message"),
    [
        (
            "'wrong_cameras:Blind'",
            r"made a Blind, which is no Camera: it lacks look; see baggie/cameras/camera.py",
        ),
        ("'wrong_cameras:Flat'", r"it has a `size` that is not \(width, height\) in pixels"),
        (
            "'wrong_cameras:open_eye', fps: 3",
            r"takes \(gain=1\), not fps .*; change the options below `camera`",
        ),
        ("'no_such_camera:open_eye'", r"the camera's factory 'no_such_camera:open_eye' cannot be imported"),
        ("open_eye", r"line 2: camera\.factory: .*got 'open_eye'"),
    ],
)
def test_a_factory_that_makes_no_camera_is_said_so(
    folder: Path, monkeypatch: pytest.MonkeyPatch, camera: str, message: str
) -> None:
    monkeypatch.setattr(sys, "path", sys.path[:])
    monkeypatch.delitem(sys.modules, "wrong_cameras", raising=False)
    (folder / "wrong_cameras.py").write_text(WRONG_CAMERAS)
    shutil.copy(EXAMPLE, folder / "beside_arm.py")
    path = folder / "cell.yaml"
    path.write_text(
        "arm: {kind: python, factory: 'beside_arm:open_arm'}\n"
        f"camera: {{kind: python, factory: {camera}}}\n"
    )
    with pytest.raises(BaggieError, match=message) as raised:
        baggie.open_workcell(path)
    assert "\n" not in str(raised.value)


def test_a_real_workcell_and_its_pictures_have_one_clock(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "path", sys.path[:])
    shutil.copy(EXAMPLE, folder / "timed_arm.py")
    cell = baggie.open_workcell(written(folder, "{kind: python, factory: 'timed_arm:open_arm'}"))
    before, seen, after = cell.clock(), cell.camera.look().time, cell.clock()
    assert before - 0.1 <= seen <= after + 0.1  # clocks of an operating system tick, and are set
    cell.close()


WRONG = """
class Half:
    info = "half an arm"
    def pose(self): ...
    def move_to(self): ...
    def lower_until_contact(self): ...
    def move_gripper(self): ...
    def grasp(self): ...
    def gripper_width(self): ...
    def stop(self): ...

class Whole(Half):
    def park(self): ...

def with_options(port, baud=9600): ...
"""


@pytest.mark.parametrize(
    ("arm", "message"),
    [
        (
            "'nowhere_to_be:open_arm'",
            r"ModuleNotFoundError: No module named 'nowhere_to_be'\); expected module:function",
        ),
        ("'needs_more:open_arm'", r"No module named 'own_missing_library'"),
        ("'wrong_arms:Third'", r"wrong_arms has no function or class 'Third'"),
        ("'wrong_arms:Half'", r"wrong_arms:Half made a Half, which is no Arm: it lacks park; see"),
        ("'wrong_arms:Whole'", r"which is no Arm: it has an `info` that is no ArmInfo"),
        ("'wrong_arms:with_options', prot: 3", r"takes \(port, baud=9600\), not prot \(.*'port'\)"),
        ("'wrong_arms'", r"line 1: arm\.factory: .*got 'wrong_arms'"),
        ("3", r"line 1: arm\.factory: .*got 3"),
    ],
)
def test_a_factory_that_makes_no_arm_is_said_so(
    folder: Path, monkeypatch: pytest.MonkeyPatch, arm: str, message: str
) -> None:
    monkeypatch.setattr(sys, "path", sys.path[:])
    monkeypatch.delitem(sys.modules, "wrong_arms", raising=False)
    (folder / "needs_more.py").write_text("import own_missing_library\n")
    (folder / "wrong_arms.py").write_text(WRONG)
    with pytest.raises(BaggieError, match=message) as raised:
        baggie.open_workcell(written(folder, f"{{kind: python, factory: {arm}}}"))
    assert "\n" not in str(raised.value)


SO101 = (
    "{kind: lerobot, type: so101_follower, port: /dev/ttyACM0, model: so101.urdf, park: [90, 0, 0, 90, 0]}"
)


def test_a_workcell_file_describes_a_lerobot_robot(folder: Path) -> None:
    entry = read_workcell_file(written(folder, SO101)).arm
    assert isinstance(entry, LeRobotEntry)
    assert (entry.type, entry.port, entry.model) == ("so101_follower", "/dev/ttyACM0", Path("so101.urdf"))
    assert [joint.name for joint in entry.joints][-1] == "wrist_roll"
    assert entry.speed <= 0.1, "slow, until somebody has watched it"


def test_without_lerobot_a_workcell_file_says_what_to_install(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "lerobot.robots", None)
    with pytest.raises(BaggieError, match=r"pip install 'lerobot\[feetech\]'$"):
        baggie.open_workcell(written(folder, SO101))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            ", joints: [{name: a, turn: 1}]",
            r"line 1: arm\.joints\.0\.turn: there is no such entry; .*sign, zero_deg",
        ),
        (", units: radians", r"line 1: arm\.units: .*'degrees' or 'normalized', got 'radians'"),
        (", park: [0]", r"line 1: arm: park needs 5 numbers, one a joint, got 1"),
    ],
)
def test_a_wrong_entry_of_a_lerobot_robot_is_named(folder: Path, change: str, message: str) -> None:
    given = SO101.replace(", park: [90, 0, 0, 90, 0]", "") if "park" in change else SO101
    with pytest.raises(BaggieError, match=message):
        read_workcell_file(written(folder, given[:-1] + change + "}"))


def test_what_a_workcell_file_says_reaches_lerobot(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []

    def open_robot(*args: Any) -> NumbersRobot:
        asked.append(args)
        return NumbersRobot()

    monkeypatch.setattr("baggie.robot.lerobot.open_robot", open_robot)
    (folder / "models").mkdir()
    shutil.copy(FR3, folder / "models" / "fr3.xml")
    mine = settings().model_dump(mode="json", exclude={"model"})
    arm = {
        "kind": "lerobot",
        "type": "numbers",
        "id": "left",
        "options": {"baud": 3},
        "model": "models/fr3.xml",
        **mine,
    }
    import yaml

    path = folder / "cell.yaml"
    path.write_text(yaml.safe_dump({"arm": arm, "camera": str(folder / "table.avi")}))
    cell = baggie.open_workcell(path)
    assert asked == [("numbers", {"id": "left", "baud": 3})]
    assert isinstance(cell.arm._arm, LeRobotArm)
    assert cell.arm.info.name == "LeRobot's numbers_follower"
    cell.close()
    path.write_text(
        yaml.safe_dump({"arm": arm | {"widths": [[0, 0], [100, 0.05]]}, "camera": str(folder / "table.avi")})
    )
    narrow = baggie.open_workcell(path)
    assert narrow.settings.handling.open_width_m == 0.05, "what is not written follows from the gripper"
    narrow.close()
    path.write_text(f"{path.read_text()}handling: {{open_width_m: 0.08}}\n")
    with pytest.raises(
        BaggieError, match=r"handling\.open_width_m is 0\.08, the gripper of .* opens to 0\.05; lower it"
    ):
        baggie.open_workcell(path)


def test_the_workcell_files_that_the_guide_shows_are_accepted(tmp_path: Path) -> None:
    blocks = re.findall(r"```yaml\n(.*?)```", (ROOT / "docs" / "own-arm.md").read_text(), re.DOTALL)
    assert len(blocks) == 2
    for block in blocks:
        (tmp_path / "cell.yaml").write_text(block)
        read_workcell_file(tmp_path / "cell.yaml")
