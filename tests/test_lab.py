"""The virtual lab, reached as a real workcell is: over Franka's protocol and a camera on the network."""

from __future__ import annotations

import io
import json
import math
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import baggie
import baggie.lab.robot as robot_module
from baggie.cameras import open_camera
from baggie.cameras.camera import Camera, check_camera
from baggie.collect import CollectOptions, collect
from baggie.commissioning.check import check_calibration
from baggie.commissioning.doctor import examine
from baggie.commissioning.image_to_robot import calibrate_image_to_robot
from baggie.errors import ArmError, BaggieError, CameraError, ReachError, StuckError
from baggie.geometry import PlanarPose, ToolPose
from baggie.lab.robot import TICKS_PER_STEP, CommandState, LabRobot, pose_difference
from baggie.lab.web import LabControl
from baggie.options.commissioning import CheckOptions, DoctorOptions, ImageToRobotOptions
from baggie.robot.contract import check_arm
from baggie.sim.cell import draw_cell
from baggie.sim.scene import ARM
from baggie.sim.world import World
from baggie.types import PickPlace
from baggie.vision.color_mask import find_bag
from baggie.workcell.workcell import Workcell, WorkcellSettings
from baggie.workcell.workcell_file import read_workcell_file
from helpers.carries import carries_in, check_reached
from helpers.lab_process import control_of, running_lab

pytest.importorskip("franky", reason='needs franky-control: pip install ".[franka]"')
FAST_M_S = 1.2
HERE = PlanarPose(0.5, 0.0, 0.0)
ASIDE = PlanarPose(0.5, 0.8, 0.0)
HIGH = ToolPose(0.5, 0.15, 0.25)


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A workcell file that opens a lab in a process of its own."""
    with running_lab(tmp_path_factory.mktemp("lab")) as path:
        yield path


@pytest.fixture(scope="module")
def opened(file: Path) -> Iterator[Workcell]:
    cell = baggie.open_workcell(file)
    yield cell
    cell.close()


@pytest.fixture(scope="module")
def control(file: Path) -> LabControl:
    return control_of(file)


@pytest.fixture
def cell(opened: Workcell, control: LabControl) -> Workcell:
    """With nothing wrong, the bag in the middle, and the arm parked."""
    control.fault("heal")
    control.reset(0)
    control.lay_bag(HERE)
    return opened


def test_its_arm_keeps_the_contract_of_arms(cell: Workcell) -> None:
    check_arm(cell.arm, speed_m_s=FAST_M_S)


def test_its_camera_keeps_the_contract_of_cameras_and_shows_the_scene_now(
    cell: Workcell, control: LabControl
) -> None:
    check_camera(cell.camera)
    lies = np.array([[0.5, y, 0.02] for y in (0.0, 0.15, -0.15)])
    centers = []
    for x, y, _ in lies:
        control.lay_bag(PlanarPose(x, y, 0.0))
        found = find_bag(cell.camera.look().color, cell.settings.object_color)
        assert found is not None
        centers.append(found.center)
    assert np.array(centers) == pytest.approx(draw_cell(0, cell.camera.size).project(lies), abs=3)


def test_a_block_is_laid_where_nothing_lies_and_taken_away(cell: Workcell, control: LabControl) -> None:
    control.lay_block(PlanarPose(0.5, 0.2), 0.04)
    assert control.truth()["block"] == {"height": 0.04, "pressed_n": 0.0}
    with pytest.raises(BaggieError, match="got one on it; take the block away first"):
        control.lay_bag(PlanarPose(0.5, 0.1))
    control.take_block_away()
    control.lay_bag(PlanarPose(0.5, 0.1))
    control.lay_block(PlanarPose(0.5, -0.1), 0.2)
    control.reset(0)
    assert control.truth()["block"]["height"] == 0


@pytest.mark.slow
def test_the_bag_is_felt_held_carried_and_put_down(cell: Workcell, control: LabControl) -> None:
    place = PlanarPose(0.5, 0.15, 0.0)
    outcome = cell.execute(PickPlace(HERE, place))
    assert outcome.success
    assert outcome.grasp_width_m > cell.settings.handling.empty_width_m
    assert outcome.place_z_m < 0.035, "pressed flat: where it only touches the table it topples"
    assert control.bag_pose().distance(place) < 0.015


@pytest.mark.slow
def test_a_bag_is_laid_with_the_dents_of_a_grasp_or_as_new(cell: Workcell, control: LabControl) -> None:
    def area(*, undented: bool) -> float:
        control.lay_bag(HERE, undented=undented)
        found = find_bag(cell.look().color, cell.settings.object_color)
        assert found is not None
        return float(cv2.contourArea(found.corners.astype(np.float32)))

    new = area(undented=True)
    assert cell.execute(PickPlace(HERE, HERE)).success
    assert area(undented=False) > 1.05 * new
    assert area(undented=True) == pytest.approx(new, rel=0.02)


@given(carries_in(WorkcellSettings().workspace), st.sampled_from([1, 2, 4]))
def test_every_carry_however_it_is_said_is_within_the_wrists_reach(
    opened: Workcell, action: PickPlace, symmetry: int
) -> None:
    opened.arm.park()
    check_reached(opened, action, symmetry)


@pytest.mark.slow
def test_however_a_carry_is_said_the_bag_arrives_by_one_motion(cell: Workcell, control: LabControl) -> None:
    ways = []
    for pick_yaw, place_yaw in ((0.3, 0.0), (0.3 + math.pi, 0.0), (0.3 - 2 * math.pi, math.pi)):
        control.reset(0)
        control.lay_bag(replace(HERE, yaw=0.3))
        cell.arm.park()
        place = PlanarPose(0.5, 0.2, place_yaw)
        outcome = cell.execute(PickPlace(replace(HERE, yaw=pick_yaw), place))
        assert outcome.success
        assert control.bag_pose().distance(place) < 0.02
        ways.append(outcome.executed.to_array())
    np.testing.assert_allclose(ways, np.tile(ways[0], (3, 1)), atol=0.01)


@pytest.mark.slow
def test_lowering_stops_on_the_bag_and_not_in_the_air(cell: Workcell, control: LabControl) -> None:
    cell.arm.move_to(HERE.at_height(0.15), FAST_M_S)
    assert control.truth()["tool"] == pytest.approx({"x": HERE.x, "y": HERE.y, "z": 0.15}, abs=0.003)
    cell.arm.move_gripper(0.0)
    # The bag is 3 cm high and soft; the force is a median, 30 ms and so 3 mm late.
    assert 0.016 < cell.arm.lower_until_contact(0.012, 0.1, 3.0).z < 0.05
    cell.arm.move_to(HERE.at_height(0.15), FAST_M_S)
    cell.arm.move_to(ToolPose(0.5, 0.2, 0.15), FAST_M_S)
    assert cell.arm.lower_until_contact(0.012, 0.1, 3.0).z == pytest.approx(0.012, abs=0.003)
    cell.arm.move_to(ToolPose(0.5, 0.2, 0.15), FAST_M_S)


def test_a_scene_is_the_same_for_the_same_seed(cell: Workcell, control: LabControl) -> None:
    first, other, again = control.reset(1), control.reset(2), control.reset(1)
    assert first.distance(again) < 1e-6
    assert first.distance(other) > 0.01


def test_a_refused_motion_moves_nothing_and_the_next_one_goes(cell: Workcell, control: LabControl) -> None:
    control.fault("refuse")
    before = cell.arm.pose()
    with pytest.raises((ArmError, ReachError)) as caught:
        cell.arm.move_to(HIGH, FAST_M_S)
    assert not isinstance(caught.value, StuckError), "an idle robot may be asked again"
    np.testing.assert_allclose(cell.arm.pose().xyz, before.xyz, atol=1e-3)
    cell.arm.move_to(HIGH, FAST_M_S)


def test_a_reflex_is_recovered_from(cell: Workcell, control: LabControl) -> None:
    control.fault("reflex")
    with pytest.raises(ReachError, match="something is in its way"):
        cell.arm.move_to(HIGH, FAST_M_S)
    cell.arm.move_to(HIGH, FAST_M_S)


def test_a_motion_with_lost_packets_is_finished(cell: Workcell, control: LabControl) -> None:
    recovered = control.truth()["errors_recovered"]
    control.fault("drop-packets", seconds=0.05, after=0.1)
    cell.arm.move_to(replaced(HIGH, y=-0.15), 0.2)
    assert control.truth()["errors_recovered"] > recovered


@pytest.mark.slow
def test_a_robot_that_does_not_recover_says_so(cell: Workcell, control: LabControl) -> None:
    control.fault("stuck")
    control.fault("joint-reflex")
    with pytest.raises(StuckError, match="does not recover by itself"):
        cell.arm.move_to(HIGH, FAST_M_S)
    with pytest.raises(ArmError, match="does not recover by itself"):
        cell.arm.move_to(HIGH, FAST_M_S)
    control.fault("heal")
    assert cell.arm.move_to(HIGH, FAST_M_S).z == pytest.approx(HIGH.z, abs=0.002)


def test_a_cut_link_is_an_error_and_comes_back(cell: Workcell, control: LabControl) -> None:
    control.fault("cut-link", seconds=0.5, after=0.2)
    with pytest.raises(ArmError, match=r"link to the robot at .* was lost"):
        cell.arm.move_to(HIGH, 0.1)
    cell.arm.move_to(HIGH, FAST_M_S)


@pytest.mark.slow
def test_a_grasp_that_slips_is_noticed(cell: Workcell, control: LabControl) -> None:
    cell.arm.move_to(HERE.at_height(0.1), FAST_M_S)
    cell.arm.lower_until_contact(0.014, 0.35, 10.0)
    assert cell.arm.grasp(10.0) > 0.003
    cell.arm.move_to(HERE.at_height(0.2), 0.5)
    assert control.truth()["bag_lowest_z"] > 0.03
    control.fault("slip")
    wait_until(lambda: control.truth()["bag_lowest_z"] < 0.01)
    wait_until(lambda: cell.arm.gripper_width() < cell.settings.handling.empty_width_m)


@pytest.mark.slow
def test_a_bumped_camera_sees_everything_elsewhere(cell: Workcell, control: LabControl) -> None:
    before = find_bag(cell.camera.look().color, cell.settings.object_color)
    control.fault("bump-camera")
    after = find_bag(cell.camera.look().color, cell.settings.object_color)
    assert before is not None
    assert after is not None
    assert np.linalg.norm(after.center - before.center) == pytest.approx(7.5, abs=2)  # 15 of 1280 pixels


@pytest.mark.slow
def test_a_camera_that_freezes_or_goes_away_is_noticed_and_comes_back(
    file: Path, cell: Workcell, control: LabControl
) -> None:
    settings = read_workcell_file(file).camera
    assert settings is not None
    camera = open_camera(settings.model_copy(update={"timeout_s": 6.0}))
    control.fault("freeze-camera", seconds=30)
    with pytest.raises(CameraError, match="has frozen"):
        look_twice(camera)
    control.fault("heal")
    camera.look()
    control.fault("unplug-camera", seconds=60)
    with pytest.raises(CameraError, match="no picture"):
        look_twice(camera)
    control.fault("heal")
    camera.look()
    camera.close()


def test_what_is_no_fault_is_refused_in_one_line(control: LabControl) -> None:
    with pytest.raises(BaggieError, match=r"expected a fault among refuse, .* got 'earthquake'"):
        control.fault("earthquake")
    with pytest.raises(BaggieError, match="start one with: baggie lab"):
        LabControl("http://127.0.0.1:9").truth()


@pytest.mark.parametrize(
    "asked",
    [
        *(f"bag?x={wrong}&y=0.1" for wrong in ("nan", "9e9", "-inf", "1e400", "half", "", "-2.5")),
        *(f"bag?x=0.5&y=0.1&yaw={wrong}" for wrong in ("nan", "inf", "left")),
        "bag?y=0.1",
        "bag?x=0.5&y=0.1&z=0.2",
        "bag?x=0.5&y=0.1&x=0.6",
        "bag?x=0.5&y=0.1&undented=nan",
        *(f"reset?seed={wrong}" for wrong in ("nan", "-1", "1e400", "1.5", "9" * 5000, "")),
        *(f"paddle?shown={wrong}" for wrong in ("nan", "2", "-1", "yes")),
        "paddle",
        *(f"block?x=0.5&y=0.2&height={wrong}" for wrong in ("nan", "-0.01", "0.21", "high")),
        *(f"block?x={wrong}&y=0.2&height=0.04" for wrong in ("nan", "2.5")),
        "block?x=0.52&y=0.05&height=0.04",  # on the bag
        "block",
        *(f"fault?name=refuse&after={wrong}" for wrong in ("nan", "-1", "inf", "1e9")),
        *(f"fault?name=drop-packets&seconds={wrong}" for wrong in ("nan", "-1", "1e400", "1e300")),
    ],
)
def test_what_makes_no_scene_and_no_fault_is_refused_and_nothing_changes(
    cell: Workcell, control: LabControl, asked: str
) -> None:
    before = control.truth()
    with pytest.raises(urllib.error.HTTPError) as refused:
        urllib.request.urlopen(
            urllib.request.Request(f"{control.address}/{asked}", method="POST"), timeout=20
        )
    assert refused.value.code == 400
    line = json.load(refused.value)["error"]
    assert line.startswith("expected")
    assert "\n" not in line
    after = control.truth()
    assert after["seed"] == before["seed"] == 0
    assert np.hypot(after["bag"]["x"] - HERE.x, after["bag"]["y"] - HERE.y) < 0.01


def test_what_is_asked_as_a_form_is_done_too(cell: Workcell, control: LabControl) -> None:
    def ask(path: str, form: bytes) -> Any:
        request = urllib.request.Request(f"{control.address}/{path}", form, method="POST")
        with urllib.request.urlopen(request, timeout=20) as answer:
            return json.load(answer)

    assert ask("reset", b"seed=7")["seed"] == 7
    assert ask("bag?x=0.45", b"y=0.2&undented=1")["bag"]["y"] == pytest.approx(0.2, abs=1e-6)
    for form in (b'{"seed": 3}', b"seed=", b"x" * 5000):
        with pytest.raises(urllib.error.HTTPError) as refused:
            ask("reset", form)
        assert json.load(refused.value)["error"].startswith("expected")
    assert control.truth()["seed"] == 7


@pytest.mark.slow
def test_the_doctor_has_the_lab_lay_a_firm_block_and_hold_the_paddle(
    file: Path, cell: Workcell, control: LabControl
) -> None:
    cell.close()
    findings = examine(DoctorOptions(str(file), move="yes", lab=control.address))
    found = {finding.check: finding for finding in findings}
    assert [found[name].verdict for name in ("touch", "force", "tool x")] == ["ok"] * 3, findings
    assert "seen to point at 0, by the marker in the hand" in found["tool x"].found
    assert control.truth()["block"]["height"] == 0


@pytest.mark.slow
def test_it_calibrates_and_collects_unattended(
    file: Path, cell: Workcell, control: LabControl, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell.close()
    map_file, with_map, out = tmp_path / "map.yaml", tmp_path / "cell.yaml", tmp_path / "bags"
    monkeypatch.setattr(sys, "stdin", io.StringIO())  # nobody presses Enter
    control.show_paddle(True)
    control.lay_bag(ASIDE)
    calibrate_image_to_robot(
        ImageToRobotOptions(
            workcell=str(file),
            marker="color:217,13,191",
            marker_in_hand=(0.09, 0.0, 0.0),
            columns=3,
            prepared=True,
            out=map_file,
        )
    )
    checked = check_calibration(
        CheckOptions(
            workcell=str(file),
            map=map_file,
            marker="color:217,13,191",
            marker_in_hand=(0.09, 0.0, 0.0),
            points=3,
            touches=0,
            prepared=True,
        )
    )
    assert checked["held_out_mm"]["mean"] < 3
    control.show_paddle(False)
    control.reset(0)
    with_map.write_text(f"{file.read_text()}calibrations: {{image_to_robot: {map_file}}}\n")
    summary = collect(CollectOptions(out=out, attempts=2, workers=1, workcell=with_map))
    assert summary["succeeded"] == 2
    last = baggie.open_dataset(out)[-1]
    assert last.truth is None
    assert control.bag_pose().distance(last.outcome.executed.place) < 0.03


def test_what_chatters_for_three_steps_is_not_felt_and_what_lasts_is(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World(draw_cell(0))
    assert world.fingers is not None
    robot = LabRobot(world, world.fingers)
    for newtons, steps, felt in ((-2.0, 9, -2.0), (500.0, 3, -2.0), (-2.0, 9, -2.0), (12.0, 4, 12.0)):
        monkeypatch.setattr(robot_module, "upward_touch", lambda *_, newtons=newtons: newtons)
        for _ in range(steps * TICKS_PER_STEP):
            robot.tick()
        assert robot.state.O_F_ext_hat_K[2] == felt


def test_an_arm_that_is_folded_up_comes_to_rest_where_it_is_held() -> None:
    folded = np.array([-0.407, 0.121, -0.333, -2.519, 0.08, 2.631, 0.427])
    world = World(draw_cell(0))
    assert world.fingers is not None
    robot = LabRobot(world, world.fingers)
    world.put_joints(folded)
    robot.hold()
    joints = [int(world.model.joint(f"{ARM}fr3_joint{k}").dofadr[0]) for k in range(1, 8)]
    world.data.qvel[joints] = [0.2, -0.2, 0.2, 0.2, -0.2, 0.2, 0.2]
    for _ in range(1200):
        robot.tick()
    assert np.abs(world.joint_velocities).max() < 0.01
    np.testing.assert_allclose(world.joints, folded, atol=1e-3)


def test_a_trail_knows_velocity_and_acceleration_of_what_was_commanded() -> None:
    moments = 0.001 * np.arange(6)
    command = CommandState(turned(0.0), pose_difference)
    for moment in moments[1:]:
        command.take(turned(moment), 0.001)
    np.testing.assert_allclose(command.velocity, [0.3, 0, 4.0 * moments[-2:].sum() / 2, 0, 0, 0.5], atol=1e-6)
    np.testing.assert_allclose(command.acceleration, [0, 0, 4.0, 0, 0, 0], atol=1e-5)


def turned(moment: float) -> np.ndarray:
    """A pose at 0.3 m/s along x, speeding up along z with 4 m/s², turning about z with 0.5 rad/s."""
    c, s = np.cos(0.5 * moment), np.sin(0.5 * moment)
    return np.array([[c, -s, 0, 0.3 * moment], [s, c, 0, 0], [0, 0, 1, 2.0 * moment**2], [0, 0, 0, 1]])


def replaced(pose: ToolPose, y: float) -> ToolPose:
    return ToolPose(pose.x, y, pose.z, pose.yaw)


def look_twice(camera: Camera) -> None:
    """One frame may have been on its way."""
    camera.look()
    camera.look()


def wait_until(met: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 20
    while not met():
        assert time.monotonic() < deadline
        time.sleep(0.05)
