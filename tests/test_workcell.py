import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import baggie
from baggie.calibration.files import CameraIdentity
from baggie.calibration.image_to_robot.map import ImageToRobot
from baggie.cameras import OpenCVSettings, RealSenseSettings
from baggie.cameras.camera import Camera, CameraSettings, OpenCamera
from baggie.commissioning.image_to_robot import grid
from baggie.errors import BaggieError, CalibrationError, LimitError, ReachError, UnsureError
from baggie.geometry import PlanarPose, ToolPose
from baggie.robot.franka import FrankaEntry
from baggie.robot.lerobot import LeRobotEntry
from baggie.robot.limits import GuardedArm
from baggie.robot.primitives import Handling, pick, place
from baggie.tasks.pattern import LAYER_M
from baggie.types import PickPlace, Plan
from baggie.workcell import config
from baggie.workcell.config import RealWorkcell
from baggie.workcell.workcell import Calibrations, WorkcellSettings
from baggie.workcell.workcell_file import read_workcell_file
from helpers.recording_arm import RecordingArm, TimelessCell
from helpers.synthetic import image_to_robot, to_pixels

# Narrower than it opens, so that letting go is told from opening.
SETTINGS = WorkcellSettings(handling=Handling(release_width_m=0.05))
anything = st.floats(allow_nan=True, allow_infinity=True)


def guarded() -> tuple[GuardedArm, RecordingArm]:
    arm = RecordingArm()
    return GuardedArm(arm, SETTINGS.limits), arm


wild = st.builds(ToolPose, anything, anything, anything, anything)
near = st.builds(
    ToolPose, *[st.floats(low, high) for low, high in ((0.1, 0.8), (-0.6, 0.6), (0, 0.8), (-4, 4))]
)


@given(st.lists(st.tuples(st.one_of(wild, near), st.one_of(anything, st.floats(0.1, 1.0))), max_size=20))
def test_no_motion_however_wild_gets_past_the_gate(motions: list[tuple[ToolPose, float]]) -> None:
    limits = replace(SETTINGS.limits, max_step_m=0.5)
    arm = RecordingArm()
    gate = GuardedArm(arm, limits)
    for target, speed in motions:
        try:
            gate.move_to(target, speed)
        except LimitError:
            continue
    assert all(0 < speed <= limits.max_speed_m_s for speed in arm.speeds)
    for start, end in pairwise([RecordingArm().at, *arm.poses]):
        assert math.isfinite(end.yaw)
        assert np.linalg.norm(end.xyz - start.xyz) <= 0.5 + 1e-9
        for x, y, z in np.linspace(start.xyz, end.xyz, 20):
            assert limits.z_min_m - 1e-6 <= z <= limits.z_max_m
            area = limits.workspace if z < limits.clearance_z_m - 1e-6 else limits.reach
            assert area.contains(x, y, margin=-1e-6)


def test_an_arm_that_stands_low_outside_may_only_rise() -> None:
    gate, arm = guarded()
    arm.at = ToolPose(0.2, 0.0, 0.05)
    with pytest.raises(LimitError, match="raise the arm first"):
        gate.move_to(ToolPose(0.4, 0.0, 0.2), 0.2)
    gate.move_to(replace(arm.at, z=0.2), 0.2)
    gate.move_to(ToolPose(0.4, 0.0, 0.2), 0.2)
    assert len(arm.poses) == 2


@pytest.mark.parametrize("what", [KeyboardInterrupt, RuntimeError])
def test_whatever_interrupts_a_motion_stops_the_arm_first(what: type[BaseException]) -> None:
    class Interrupted(RecordingArm):
        def grasp(self, force_n: float) -> float:
            raise what

    arm = Interrupted()
    with pytest.raises(what):
        GuardedArm(arm, SETTINGS.limits).grasp(5.0)
    assert arm.log == ["stop"]


@given(anything, anything, anything)
def test_the_gate_refuses_wild_lowering_squeezing_and_opening(a: float, b: float, c: float) -> None:
    gate, arm = guarded()
    for call in (
        lambda: gate.lower_until_contact(a, b, c),
        lambda: gate.grasp(a),
        lambda: gate.move_gripper(b),
    ):
        try:
            call()
        except LimitError:
            continue
    assert all(pose.z >= SETTINGS.limits.z_min_m - 1e-6 for pose in arm.poses)
    assert 0.0 <= arm.width <= 0.08


def test_a_limit_error_says_what_came_and_what_is_allowed() -> None:
    gate, _ = guarded()
    with pytest.raises(
        LimitError, match=r"x 0\.900, y 0\.000 m is outside the workspace \(x 0\.28\.\.0\.70 m"
    ):
        gate.check(PlanarPose(0.9, 0.0), "place")


def test_pick_closes_where_it_was_sent_and_reports_what_it_holds() -> None:
    target, handling = PlanarPose(0.5, 0.1, 0.4), Handling()
    arm = RecordingArm(width=0.012)
    grasp = pick(arm, target, handling)
    assert grasp.pose == target.at_height(handling.pick_z_m)
    assert grasp.held
    assert grasp.width_m == pytest.approx(0.012)
    assert arm.log.index("lower") < arm.log.index("grasp")
    assert arm.at.z == handling.travel_z_m


def test_pick_stops_at_what_it_touches() -> None:
    arm = RecordingArm(floor_z=0.09)
    assert pick(arm, PlanarPose(0.5, 0.0), Handling()).pose.z == pytest.approx(0.09)


def test_an_empty_grasp_is_noticed() -> None:
    assert not pick(RecordingArm(width=0.0), PlanarPose(0.5, 0.0), Handling()).held


def test_place_lets_go_where_it_was_sent_and_rises_straight_up() -> None:
    target, handling = PlanarPose(0.45, -0.2, 0.0), Handling()
    arm = RecordingArm()
    pick(arm, PlanarPose(0.5, 0.1), handling)
    release = place(arm, target, handling)
    assert release.pose.planar == target
    assert release.held
    np.testing.assert_allclose(arm.at.xyz[:2], target.xy)
    assert arm.at.z > release.pose.z


def test_what_cannot_be_placed_is_put_back() -> None:
    start, beyond = PlanarPose(0.5, 0.1), PlanarPose(0.4, -0.2)

    class ShortArm(RecordingArm):
        def move_to(self, target: ToolPose, speed_m_s: float) -> ToolPose:
            if target.planar == beyond:
                raise ReachError("too far")
            return super().move_to(target, speed_m_s)

    arm = ShortArm()
    with pytest.raises(ReachError):
        TimelessCell(arm, cast(Camera, None), SETTINGS).execute(PickPlace(start, beyond))
    let_go = arm.log.index(f"gripper {SETTINGS.handling.release_width_m:.3f}")
    assert "grasp" in arm.log[:let_go]
    assert arm.at.planar == start


radii = st.none() | st.floats(0.0, 0.2) | st.just(math.nan)


@given(radii, radii)
def test_only_a_plan_that_is_sure_enough_moves_the_arm(pick_m: float | None, place_m: float | None) -> None:
    plan = Plan(PickPlace(PlanarPose(0.5, 0.1), PlanarPose(0.4, -0.2, 0.3)), 1.0, pick_m, place_m)
    arm = RecordingArm()
    cell = TimelessCell(arm, cast(Camera, None), SETTINGS)
    if all(radius is None or radius <= SETTINGS.sure_within_m for radius in (pick_m, place_m)):
        assert cell.carry_out(plan).executed == plan.action
    else:
        with pytest.raises(UnsureError):
            cell.carry_out(plan)
        assert not arm.log


def test_an_unsure_plan_says_what_is_unsure_how_much_is_allowed_and_what_to_do() -> None:
    plan = Plan(PickPlace(PlanarPose(0.5, 0.1), PlanarPose(0.4, -0.2)), 1.0, 0.01, 0.045)
    with pytest.raises(UnsureError) as raised:
        TimelessCell(RecordingArm(), cast(Camera, None), SETTINGS).carry_out(plan)
    message = str(raised.value)
    assert "sure within 30 mm, got the place within 45 mm;" in message
    assert "sure_within_m" in message
    assert "pick" not in message
    assert "\n" not in message


def test_the_workcell_may_ask_for_more(tmp_path: Path) -> None:
    path = tmp_path / "cell.yaml"
    path.write_text("sure_within_m: 0.01\n")
    assert read_workcell_file(path).sure_within_m == 0.01
    plan = Plan(PickPlace(PlanarPose(0.5, 0.1), PlanarPose(0.4, -0.2)), 1.0, 0.02)
    strict = replace(SETTINGS, sure_within_m=0.01)
    with pytest.raises(UnsureError, match="within 10 mm, got the pick within 20 mm"):
        TimelessCell(RecordingArm(), cast(Camera, None), strict).carry_out(plan)


class TrippingArm(RecordingArm):
    """A reflex ends its lift with something in the hand, once."""

    tripped = False

    def move_to(self, target: ToolPose, speed_m_s: float) -> ToolPose:
        if self.width == self._held and not self.tripped:
            self.tripped = True
            raise ReachError("a reflex")
        return super().move_to(target, speed_m_s)


def test_what_was_picked_up_when_a_reflex_came_is_put_down_where_it_is() -> None:
    arm, at = TrippingArm(), PlanarPose(0.45, 0.1)
    with pytest.raises(ReachError, match="a reflex"):
        TimelessCell(arm, cast(Camera, None), SETTINGS).execute(PickPlace(at, PlanarPose(0.55, -0.1)))
    assert arm.log[-3:-1] == ["lower", f"gripper {SETTINGS.handling.release_width_m:.3f}"]
    assert arm.at.planar.distance(at) < 1e-6
    assert arm.at.z >= SETTINGS.handling.approach_z_m


@pytest.mark.parametrize(("y", "nearest"), [(0.1, 0.1), (0.45, SETTINGS.workspace.y_max)])
def test_a_real_cell_begins_with_what_the_hand_still_holds_put_down_inside_its_workspace(
    y: float, nearest: float
) -> None:
    arm = RecordingArm(width=0.02)
    arm.at, arm.width = ToolPose(0.5, y, 0.25), 0.02
    cell = RealWorkcell(arm, cast(OpenCamera, None), SETTINGS)
    cell.reset((0,))
    assert arm.width == SETTINGS.handling.release_width_m
    assert arm.at.xyz == pytest.approx([0.5, nearest, SETTINGS.handling.place_z_m], abs=0.1)
    assert arm.at.y == pytest.approx(nearest)
    log = list(arm.log)
    assert not cell.rescue()
    assert arm.log == log, "an empty hand has nothing to put down"


@pytest.mark.parametrize("width", [0.0, 0.049, 0.051, 0.076, 0.08])
def test_a_hand_that_is_shut_or_has_let_go_holds_nothing(width: float) -> None:
    arm = RecordingArm()
    arm.width = width
    assert not TimelessCell(arm, cast(Camera, None), SETTINGS).put_down()
    assert arm.log == []


def test_a_plan_that_leaves_the_workspace_is_refused_before_anything_moves() -> None:
    arm = RecordingArm()
    plan = Plan(PickPlace(PlanarPose(0.5, 0.1), PlanarPose(1.5, 0.0)))
    with pytest.raises(LimitError):
        TimelessCell(arm, cast(Camera, None), SETTINGS).carry_out(plan)
    assert not arm.log


def test_a_workcell_file_is_read(tmp_path: Path) -> None:
    path = tmp_path / "cell.yaml"
    path.write_text("cell: 3\nworkspace:\n  x: [0.4, 0.6]\nbag:\n  mass_kg: 0.15\n")
    written = read_workcell_file(path)
    assert (written.cell, written.workspace.x, written.bag.mass_kg) == (3, (0.4, 0.6), 0.15)


FRANKA = "arm:\n  kind: franka\n  host: 192.0.2.1\n"


@pytest.mark.parametrize(
    ("text", "force_n"),
    [("arm: sim\n", Handling().land_force_n), ("arm: sim\nhandling: {land_force_n: 7}\n", 7.0)],
)
def test_a_simulated_arm_handles_as_it_always_did_unless_its_file_says_how(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, force_n: float
) -> None:
    opened: list[WorkcellSettings] = []
    monkeypatch.setattr(
        "baggie.workcell.simulated.SimulatedWorkcell", lambda _cell, settings, **_: opened.append(settings)
    )
    path = tmp_path / "cell.yaml"
    path.write_text(text)
    config._open(read_workcell_file(path), path)
    assert opened[0].handling == replace(Handling(), land_force_n=force_n)


def test_a_workcell_file_describes_a_real_arm(tmp_path: Path) -> None:
    path = tmp_path / "cell.yaml"
    path.write_text(f"{FRANKA}  model: panda\ncamera: 0\n")
    arm = read_workcell_file(path).arm
    assert isinstance(arm, FrankaEntry)
    assert (arm.host, arm.model) == ("192.0.2.1", "panda")
    assert arm.speed <= 0.1, "slow, until somebody has watched it"


def test_a_real_workcell_opens_before_its_robot_is_needed(tmp_path: Path) -> None:
    pytest.importorskip("franky", reason='needs franky-control: pip install ".[franka]"')
    video = tmp_path / "table.avi"
    writer = cv2.VideoWriter(str(video), cv2.VideoWriter.fourcc(*"MJPG"), 10, (64, 48))
    writer.write(np.zeros((48, 64, 3), np.uint8))
    writer.release()
    (tmp_path / "cell.yaml").write_text(f"{FRANKA}camera: {video}\nworkspace:\n  x: [0.4, 0.5]\n")
    cell = baggie.open_workcell(tmp_path / "cell.yaml")
    try:
        assert cell.arm.info.name == "FR3 at 192.0.2.1"
        assert cell.camera.look().size == (64, 48)
        with pytest.raises(LimitError):
            cell.execute(PickPlace(PlanarPose(0.45, 0.0), PlanarPose(0.9, 0.0)))
    finally:
        cell.close()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("bag:\n  mass_kg: -1\n", r"bag\.mass_kg: .*greater than 0\.02, got -1"),
        ("sure_within_m: 0\n", r"sure_within_m: .*greater than 0, got 0"),
        (
            "lens: wide\n",
            r"cell\.yaml, line 1: lens: there is no such entry; take it out, or give one of arm, ",
        ),
        (
            f"{FRANKA}camera:\n  kind: usb\n",
            r"line 5: camera\.kind: .*'realsense', 'orbbec', 'k4a', 'python', got 'usb'; change it",
        ),
        ("camera:\n  kind: k4a\n  exposure: 8\n", r"line 3: camera\.exposure: .* give one of .*exposure_ms"),
        ("camera:\n  size: [640,\n    wide]\n", r"line 3: camera\.size\.1: .*integer.*, got 'wide'"),
        ("camera: {}\narm: true\n", r"line 2: arm: .*, got true; change it"),
        (
            "cell: 1\narm: ur5\n",
            r"line 2: arm\.kind: expected one of 'sim', 'replay', 'franka'.*, got 'ur5'; change it",
        ),
        ("arm: replay\n", r"line 1: arm\.recording: Field required"),
        (f"{FRANKA}  port: 2\n", r"line 4: arm\.port: .* give one of kind, host, model, speed, realtime"),
        ("arm:\n  kind: franka\ncamera: 0\n", r"line 1: arm\.host: Field required"),
        (f"{FRANKA}  speed: 2\n", r"line 4: arm\.speed: .*less than or equal to 1, got 2"),
        (f"{FRANKA}  model: ur5\n", r"line 4: arm\.model: .*'fr3' or 'panda', got 'ur5'"),
        (FRANKA, r"a real arm needs a real camera; write `camera: 0`"),
        (
            "camera: 0\n",
            r"the arm 'sim' sees with a camera of its own; give its `width` and `height`, or leave",
        ),
        ("workspace:\n  y: [0.3, -0.3]\n", r"line 2: workspace\.y: expected the lower bound first"),
        ("handling:\n  grip_n: 3\n", r"line 2: handling\.grip_n: .* give one of travel_z_m, .*grasp_force_n"),
        (
            "limits:\n  max_speed_m_s: 0.5\nhandling: {fast_m_s: 1.2}\n",
            r"cell\.yaml, line 3: handling\.fast_m_s is 1\.2, the limits allow up to 0\.5; lower it",
        ),
        (
            "limits:\n  z_min_m: 0.02\nhandling: {pick_z_m: 0.014}\n",
            r"pick_z_m and place_z_m are 0\.014 and 0\.024, .* no less than 0\.02",
        ),
        ("cell: [", r"cell\.yaml is no YAML, line 1: .*; mend it there"),
        ("cell: 1\n\ncell: 2\n", r"line 3: the key 'cell' stands there twice; mend it there"),
        (
            "bag: {color: [1, 2, 3], mass_kg: 0.1, color: [3, 2, 1]}\n",
            r"line 1: the key 'color' stands there twice",
        ),
        ("", r"expected entries such as `arm: sim` in .*cell\.yaml, got nothing; `baggie workcell new`"),
        ("# arm: sim\n", r"got nothing"),
        ("{}\n", r"got nothing"),
        ("- arm\n", r"expected entries such as `arm: sim` in .*, got a list"),
        ("sim\n", r"got a str"),
        (
            "workspace:\n  x: [350, 650]\n",
            r"line 2: workspace\.x\.0: expected metres, at most 5, got 350; .* thousandth",
        ),
        ("workspace:\n  y: [-30, 30]\n", r"workspace\.y\.0: expected metres, at most 5, got -30"),
        ("workspace: {x: [.nan, .inf]}\n", r"workspace\.x\.0: .*finite number, got \.nan"),
        ("limits: {z_max_m: 700}\n", r"limits\.z_max_m: expected metres, at most 5, got 700"),
        ("limits: {max_speed_m_s: 1200}\n", r"max_speed_m_s: .*less than or equal to 5, got 1200"),
        ("limits: {max_contact_force_n: .inf}\n", r"finite number, got \.inf"),
        (
            "handling: {travel_z_m: 200}\n",
            r"handling\.travel_z_m is 200, the limits allow 0\.012 to 0\.7; change it",
        ),
        (
            "handling: {pick_z_m: 5}\n",
            r"handling\.pick_z_m is 5, the hand comes down from .*, 0\.11; lower it",
        ),
        ("handling: {place_z_m: 24}\n", r"handling\.place_z_m is 24, .* from handling\.travel_z_m, 0\.2"),
        ("handling: {open_width_m: 80}\n", r"handling\.open_width_m is 80, expected metres from 0 to 0\.5"),
        ("handling: {release_width_m: -0.03}\n", r"handling\.release_width_m is -0\.03, expected metres"),
        ("handling: {empty_width_m: 2}\n", r"handling\.empty_width_m is 2, expected metres"),
        ("sure_within_m: 30\n", r"sure_within_m: expected metres, at most 5, got 30"),
        ("cell: 99999999999999999999\n", r"cell: .*less than or equal to 9223372036854775807"),
        ("handling: {pick_z_m: .nan}\n", r"handling\.pick_z_m: .*finite number, got \.nan"),
        ("bag: {color: [300, 0, -5]}\n", r"bag\.color\.0: .*less than or equal to 255, got 300"),
        ("bag: {color: [30, 0, -5]}\n", r"bag\.color\.2: .*greater than or equal to 0, got -5"),
        (f"{FRANKA}camera: {{size: [640, 0]}}\n", r"camera\.size\.1: .*greater than 0, got 0"),
        ("camera: {width: 640}\narm: replay\n", r"arm\.recording: Field required"),
        ("camera: {width: 100}\n", r"line 1: camera\.width: .*greater than or equal to 120, got 100"),
        (
            "camera: {width: 640, size: [640, 480]}\n",
            r"camera\.size: there is no such entry; .* kind, width, height",
        ),
        (f"{FRANKA}camera: {{width: 640}}\n", r"a real arm needs a real camera"),
        (
            f"{FRANKA}camera: {{source: 1.10}}\n",
            r"camera\.source: .*valid string, got 1\.10; put it in quotes",
        ),
        (f"{FRANKA}camera: {{source: no}}\n", r"camera\.source: .*valid string, got no; put it in quotes"),
        ("1: 2\n", r"line 1: 1: .*"),
    ],
)
def test_a_wrong_workcell_file_names_the_entry(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "cell.yaml"
    path.write_text(text)
    with pytest.raises(BaggieError, match=message):
        read_workcell_file(path)


@pytest.mark.parametrize(
    "written", ["0", "043422070123", "4769476691", "12:30:45", "1e5", "0x1F", "2026-01-31", "1_000"]
)
def test_a_camera_is_called_what_is_written_with_quotes_or_without(tmp_path: Path, written: str) -> None:
    path = tmp_path / "cell.yaml"
    for quoted in (written, f"'{written}'", f'"{written}"'):
        path.write_text(f"{FRANKA}camera: {{kind: realsense, source: {quoted}}}\n")
        assert read_workcell_file(path).camera == RealSenseSettings(source=written)
        path.write_text(f"{FRANKA}camera: {{kind: opencv, source: {quoted}}}\n")
        assert read_workcell_file(path).camera == OpenCVSettings(source=written)
    assert CameraSettings(source=0) == CameraSettings(source="0")  # type: ignore[arg-type]


def test_a_name_of_digits_is_a_name(tmp_path: Path) -> None:
    path = tmp_path / "cell.yaml"
    path.write_text(
        f"arm: {{kind: lerobot, type: so101_follower, id: 007, model: a.urdf, park: [{'0, ' * 5}]}}\ncamera: 0\n"
    )
    arm = read_workcell_file(path).arm
    assert isinstance(arm, LeRobotEntry)
    assert arm.id == "007"


def test_a_workcell_file_in_another_encoding(tmp_path: Path) -> None:
    path = tmp_path / "cell.yaml"
    for encoding in ("utf-8", "utf-8-sig", "utf-16"):
        path.write_text("# Küche\ncell: 3\n", encoding)
        assert read_workcell_file(path).cell == 3
    path.write_text("cell: 3\n# Küche\n", "latin-1")
    with pytest.raises(
        BaggieError, match=r"cell\.yaml is no text in UTF-8: byte 0xfc in line 2 .*; save it as UTF-8"
    ):
        read_workcell_file(path)
    path.write_bytes(bytes(range(256)))
    with pytest.raises(BaggieError, match="is no text in UTF-8"):
        read_workcell_file(path)


def test_a_camera_in_few_words(tmp_path: Path) -> None:
    path = tmp_path / "cell.yaml"
    path.write_text(f"{FRANKA}camera: 2\n")
    assert read_workcell_file(path).camera == OpenCVSettings(source="2")
    path.write_text(f"{FRANKA}camera: realsense:1234\n")
    assert read_workcell_file(path).camera == RealSenseSettings(source="1234")


def test_a_missing_workcell_file_says_what_to_give() -> None:
    with pytest.raises(BaggieError, match=r"no workcell file nowhere\.yaml"):
        read_workcell_file(Path("nowhere.yaml"))


def test_an_outline_is_as_high_as_its_layer_and_wants_a_map_that_knows_heights() -> None:
    cell = RealWorkcell.__new__(RealWorkcell)
    cell.settings = SETTINGS
    cell.camera = cast("Camera", SimpleNamespace(size=(1280, 720)))
    cell.calibrations = Calibrations(image_to_robot=image_to_robot())
    pose, (length, width, height) = PlanarPose(0.5, 0.1, 0.3), SETTINGS.object_size_m
    for layer, middle_m in ((0, height / 2), (1, 1.5 * LAYER_M), (4, 4.5 * LAYER_M)):
        truly = to_pixels(np.c_[pose.outline(length, width), np.full(4, middle_m)])
        np.testing.assert_allclose(cell.outline(pose, layer), truly, atol=0.05)
    robot = grid(SETTINGS.workspace, 0.02, (height / 2,))
    flat = ImageToRobot.fit(to_pixels(robot), robot, CameraIdentity("drawn", 1280, 720), height_m=height / 2)
    cell.calibrations = Calibrations(image_to_robot=flat)
    assert cell.outline(pose).shape == (4, 2)
    with pytest.raises(CalibrationError, match=r"fitted at one height only, 0\.015 m, not at 0\.033 m"):
        cell.outline(pose, 1)
