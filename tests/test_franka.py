"""A Franka arm over the real protocol: libfranka speaks with franky-sim's server through TCP and UDP."""

from __future__ import annotations

import os
import re
import signal
import socket
import struct
import sys
import threading
import time
from collections.abc import Iterator

import numpy as np
import pytest

from baggie.errors import ArmError, BaggieError, LimitError, ReachError, install_extra
from baggie.geometry import FloatArray, PlanarPose, ToolPose, hand_matrix
from baggie.robot.arm import LedArm, hand_pose
from baggie.robot.franka.arm import FrankaArm
from baggie.robot.franka.models import HOME, MODELS, ModelName
from baggie.types import PickPlace
from baggie.workcell.workcell import Workcell, WorkcellSettings
from helpers.fci_process import Server
from helpers.fci_server import BOX_TOP_M

franky = pytest.importorskip("franky", reason='needs franky-control: pip install ".[franka]"')
HIGH = ToolPose(0.49, 0.0, 0.20)  # above the box
LIMITS = WorkcellSettings().limits


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    # An address of its own for each process that runs tests; the ports are given by the protocol.
    server = Server(*(f"127.0.{os.getpid() % 200 + 20}.{number}" for number in range(1, 250)))
    yield server
    server.kill()


@pytest.fixture(scope="module")
def connected(server: Server) -> Iterator[FrankaArm]:
    arm = FrankaArm(server.host, speed=1.0, realtime=False)
    yield arm
    arm.close()


@pytest.fixture
def arm(connected: FrankaArm) -> FrankaArm:
    if connected.pose().z < HIGH.z - 0.01:
        connected.move_to(HIGH, 1.5)
    return connected


def beside(arm: FrankaArm) -> ToolPose:
    """A place 8 cm from where the arm is."""
    here = arm.pose()
    return ToolPose(here.x, 0.08 if here.y < 0.04 else 0.0, here.z)


def test_connecting_leaves_the_priority_of_who_connects_as_it_was(arm: FrankaArm) -> None:
    had = os.sched_getscheduler(0)
    arm.close()
    arm.pose()
    assert os.sched_getscheduler(0) == had


def test_what_it_commands_is_what_it_measures(arm: FrankaArm) -> None:
    arm.move_to(HIGH, 1.2)
    commanded = np.asarray(arm._link.robot.state.O_T_EE_d.matrix)
    assert isinstance(arm, LedArm)
    np.testing.assert_allclose(hand_pose(arm), commanded, atol=2e-3)
    np.testing.assert_allclose(hand_pose(arm), hand_matrix(HIGH), atol=2e-3)


def test_lowering_stops_at_what_it_touches(arm: FrankaArm) -> None:
    arm.move_to(HIGH, 1.2)
    lowered = arm.lower_until_contact(0.05, 0.2, 10.0)
    assert BOX_TOP_M < lowered.z < BOX_TOP_M + LIMITS.z_min_m  # the fingertips are below the tool
    assert (lowered.x, lowered.y) == pytest.approx((HIGH.x, HIGH.y), abs=0.006)  # it presses, and slips


def test_a_reflex_on_the_way_down_is_a_contact(arm: FrankaArm, server: Server) -> None:
    start, (_, recovered) = arm.pose(), server.count()
    server.tell("reflex cartesian_reflex")
    assert arm.lower_until_contact(0.12, 0.3, 10.0).z > start.z - 0.02
    assert server.count()[1] == recovered + 1


def test_nothing_outside_of_the_workspace_reaches_the_robot(arm: FrankaArm, server: Server) -> None:
    class Cell(Workcell):
        def clock(self) -> float:
            return 0.0

    cell = Cell(arm, None, WorkcellSettings())  # type: ignore[arg-type]
    begun, _ = server.count()
    for outside in (PlanarPose(0.9, 0.0), PlanarPose(0.5, 0.6), PlanarPose(float("nan"), 0.0)):
        for action in (PickPlace(outside, HIGH.planar), PickPlace(HIGH.planar, outside)):
            with pytest.raises(LimitError):
                cell.execute(action)
    with pytest.raises(ReachError, match="cannot reach"):
        arm.move_to(ToolPose(0.75, 0.5, 0.65), 1.0)
    assert server.count()[0] == begun


def test_a_collision_is_recovered_from_and_reported(arm: FrankaArm, server: Server) -> None:
    _, recovered = server.count()
    target = beside(arm)
    server.tell("reflex cartesian_reflex")
    with pytest.raises(ReachError, match=r"\(cartesian_reflex\) and has recovered; something is in its way"):
        arm.move_to(target, 1.0)
    assert server.count()[1] == recovered + 1
    arm.move_to(target, 1.0)  # it goes on


def test_a_motion_cut_short_by_a_late_packet_is_finished(arm: FrankaArm, server: Server) -> None:
    begun, recovered = server.count()
    target = beside(arm)
    server.tell("reflex communication_constraints_violation")
    reached = arm.move_to(target, 1.0)
    np.testing.assert_allclose(reached.xyz, target.xyz, atol=0.002)
    assert server.count() == (begun + 2, recovered + 1)


def test_what_does_not_recover_by_itself_is_tried_again_by_the_next_motion(
    arm: FrankaArm, server: Server
) -> None:
    target = beside(arm)
    server.tell("stuck")
    server.tell("reflex joint_reflex")
    held = r"\(joint_reflex\) and does not recover by itself; look what holds it"
    with pytest.raises(ArmError, match=held):
        arm.move_to(target, 1.0)
    before = server.count()
    with pytest.raises(ArmError, match=held):
        arm.move_to(target, 1.0)
    assert server.count() == before  # nothing was asked to move
    server.tell("free")
    np.testing.assert_allclose(arm.move_to(target, 1.0).xyz, target.xyz, atol=0.002)
    assert server.count() == (before[0] + 1, before[1] + 1)


def test_a_new_connection_recovers_from_what_it_finds(arm: FrankaArm, server: Server) -> None:
    target = beside(arm)
    server.tell("stuck")
    server.tell("reflex joint_reflex")
    with pytest.raises(ArmError, match="does not recover by itself"):
        arm.move_to(target, 1.0)
    server.tell("free")
    arm.close()
    arm.move_to(target, 1.0)


def test_stop_brakes_a_motion_from_another_thread(arm: FrankaArm) -> None:
    start, target = arm.pose(), beside(arm)
    threading.Timer(0.1, arm.stop).start()
    with pytest.raises(ArmError, match="was stopped"):
        arm.move_to(target, 0.05)
    travelled = np.linalg.norm(arm.pose().xyz - start.xyz)
    assert travelled < 0.05
    arm.move_to(target, 1.0)


def test_ctrl_c_stops_the_arm(arm: FrankaArm) -> None:
    target = beside(arm)
    threading.Timer(0.1, os.kill, (os.getpid(), signal.SIGINT)).start()
    with pytest.raises(KeyboardInterrupt):
        arm.move_to(target, 0.05)
    stopped = arm.pose()
    time.sleep(0.3)
    np.testing.assert_allclose(
        arm.pose().xyz, stopped.xyz, atol=5e-3
    )  # it comes to rest, and goes no further
    assert np.linalg.norm(arm.pose().xyz - target.xyz) > 0.02
    arm.move_to(target, 1.0)


def test_another_end_effector_is_refused(arm: FrankaArm, server: Server) -> None:
    longer = np.eye(4)
    longer[2, 3] = 0.05
    arm.close()
    set_end_effector(server, longer)
    try:
        with pytest.raises(
            ArmError, match=r"robot's is 50\.0 mm and 0\.0 degrees away .* Choose 'Franka Hand'"
        ):
            arm.pose()
    finally:
        set_end_effector(server, np.eye(4))


def set_end_effector(server: Server, T_nominal_tool: FloatArray) -> None:
    def connect_and_set() -> None:
        robot = franky.Robot(server.host, realtime_config=franky.RealtimeConfig.Ignore)
        robot.set_ee(T_nominal_tool.T.ravel())

    thread = threading.Thread(target=connect_and_set)  # which connecting gives a real-time priority for good
    thread.start()
    thread.join()


def test_a_server_that_goes_away_is_a_clear_error_and_comes_back_gently(
    arm: FrankaArm, server: Server
) -> None:
    target = beside(arm)
    threading.Timer(0.1, server.kill).start()
    began = time.monotonic()
    with pytest.raises(ArmError, match=r"link to the robot at .* was lost .* the next motion connects again"):
        arm.move_to(target, 0.05)
    with pytest.raises(ArmError, match=r"no robot answers at .*activate FCI"):
        arm.pose()
    assert time.monotonic() - began < 10
    server.start(server.host)
    assert arm.move_to(HIGH, 1.5).z == pytest.approx(HIGH.z, abs=0.002)


def test_another_version_says_what_to_install() -> None:
    host = f"127.0.{os.getpid() % 200 + 20}.251"
    with socket.create_server((host, 1337)) as listening:

        def answer_as_a_panda() -> None:
            client, _ = listening.accept()
            with client:
                command, number, size = struct.unpack("<3I", client.recv(12, socket.MSG_WAITALL))
                # With something left unread, closing would take the answer back.
                client.recv(size - 12, socket.MSG_WAITALL)
                client.sendall(struct.pack("<3IBH5x", command, number, 20, 1, 5))
                client.recv(1)  # until the other side has read it

        threading.Thread(target=answer_as_a_panda, daemon=True).start()
        with pytest.raises(
            ArmError, match=r"version 5 of the .* version 10: .*pip install .*server-version/5/$"
        ):
            FrankaArm(host, "panda", realtime=False).pose()


@pytest.mark.parametrize("name", MODELS)
def test_ways_stay_within_the_joints_of_each_model(name: ModelName) -> None:
    model, reached = MODELS[name], 0
    kinematics = model.kinematics()
    for yaw in np.linspace(-4.0, 4.0, 9):
        try:
            way = kinematics.line(HOME, ToolPose(0.5, 0.2, 0.1, yaw))
        except ReachError:
            continue
        reached += 1
        assert (way >= model.lower_rad).all()
        assert (way <= model.upper_rad).all()
    assert reached >= 5


def test_without_the_extra_one_line_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "franky", None)
    with pytest.raises(BaggieError, match=re.escape(install_extra("franka"))):
        FrankaArm("192.0.2.1")
