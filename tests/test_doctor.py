import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from baggie.cli.main import main
from baggie.commissioning import health
from baggie.commissioning.doctor import Finding, examine, require_healthy
from baggie.commissioning.health import HELPED
from baggie.errors import ArmError, BaggieError, CameraError
from baggie.geometry import ToolPose
from baggie.options.commissioning import DoctorOptions
from baggie.sim.arm import SimulatedArm
from baggie.sim.arm_world import ArmWorld
from baggie.types import Observation
from baggie.workcell.workcell import Workcell, WorkcellSettings
from helpers.recording_arm import RecordingArm, TimelessCell
from helpers.scripted import Scripted


class ObedientArm(RecordingArm):
    """Does what it is told, with nothing between its fingers; the table is at `table_z`."""

    def __init__(self, table_z: float = 0.0, stuck_width: float | None = None) -> None:
        super().__init__(width=0.0, floor_z=table_z)
        self.stuck_width = stuck_width

    def move_gripper(self, width_m: float) -> float:
        return super().move_gripper(width_m if self.stuck_width is None else self.stuck_width)


class Eye:
    """Noise about a level; or always the same picture."""

    name, size, intrinsics = "eye", (64, 48), None

    def __init__(self, level: int = 120, frozen: bool = False) -> None:
        self.level, self.frozen, self._rng = level, frozen, np.random.default_rng(0)

    def look(self) -> Observation:
        rng = np.random.default_rng(1) if self.frozen else self._rng
        return Observation(np.clip(rng.normal(self.level, 3, (48, 64, 3)), 0, 255).astype(np.uint8))


def cell(arm: ObedientArm | None = None, eye: Eye | None = None) -> Workcell:
    return TimelessCell(arm or ObedientArm(), eye or Eye(), WorkcellSettings())


@pytest.fixture
def frozen(monkeypatch: pytest.MonkeyPatch) -> ObedientArm:
    """The arm of the workcell that opens: nothing is wrong but its camera, which has frozen."""
    arm = ObedientArm()
    monkeypatch.setattr("baggie.commissioning.doctor.open_workcell", lambda *_: cell(arm, Eye(frozen=True)))
    return arm


def test_a_healthy_arm_passes_and_moves_slowly() -> None:
    arm = ObedientArm()
    for check in health.MOVING.values():
        assert check(cell(arm))
    assert arm.speeds
    assert max(arm.speeds) <= 0.1


def test_an_arm_that_is_slower_than_the_check_up_is_checked_as_fast_as_it_goes() -> None:
    arm = ObedientArm()
    arm.info = replace(arm.info, max_speed_m_s=0.03)
    for check in health.MOVING.values():
        assert check(cell(arm))
    assert max(arm.speeds) == pytest.approx(0.03)


@pytest.mark.parametrize(
    ("check", "sick", "error", "says"),
    [
        ("pictures", cell(eye=Eye(frozen=True)), CameraError, "frozen"),
        ("light", cell(eye=Eye(level=10)), health.Doubt, "too dark"),
        ("light", cell(eye=Eye(level=255)), health.Doubt, "less light"),
        ("calibrations", cell(), health.Doubt, "baggie calibrate"),
        ("gripper", cell(ObedientArm(stuck_width=0.07)), ArmError, "sent to 40 mm are 70 mm apart"),
        ("touch", cell(ObedientArm(table_z=0.06)), ArmError, "touched at z 60 mm, 46 mm too early"),
    ],
)
def test_what_is_wrong_is_said_with_a_remedy(check: str, sick: Workcell, error: type, says: str) -> None:
    with pytest.raises(error, match=says):
        {**health.STILL, **health.MOVING}[check](sick)


@pytest.mark.slow
def test_a_simulated_workcell_is_healthy() -> None:
    person = Scripted("y")
    findings = examine(DoctorOptions(), operator=person)
    require_healthy(findings)
    found = {finding.check: finding.verdict for finding in findings}
    assert len(person.asked) == 1
    assert list(found) == ["workcell", *health.STILL, *health.MOVING, *HELPED]
    sick = {name for name, verdict in found.items() if verdict != "ok"}
    assert sick == {"calibrations", "view"}, "a fresh cell has none"


def helped(
    monkeypatch: pytest.MonkeyPatch, arm: ObedientArm, *answers: str
) -> tuple[dict[str, Finding], Scripted]:
    """What is found with somebody who gives leave and these answers, and lays the thing under the hand meanwhile."""

    def lay(words: str) -> None:
        arm._floor = 0.04 if "firm thing" in words else 0.0

    monkeypatch.setattr("baggie.commissioning.doctor.open_workcell", lambda *_: cell(arm))
    person = Scripted("y", *answers, meanwhile=lay)
    findings = examine(DoctorOptions(), operator=person)
    return {finding.check: finding for finding in findings}, person


def test_a_person_lays_a_firm_thing_and_says_where_the_hand_points(monkeypatch: pytest.MonkeyPatch) -> None:
    arm = ObedientArm()
    found, person = helped(monkeypatch, arm, "high", "4", "40", "", "y")
    assert found["force"] == Finding("force", "ok", "felt 3 times at z 40 mm, on a thing of 40 mm")
    assert found["tool x"].verdict == "ok"
    assert found["tool x"].found.endswith("point at 0, as somebody says")
    assert person.asked[2].startswith("'high' will not do (expected 30 to 168); lay a firm thing")
    assert person.asked[3].startswith("'4' will not do (expected 30 to 168)")
    assert max(arm.speeds) <= 0.1


def test_what_nobody_lays_or_tells_is_not_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    arm = ObedientArm()
    found, _ = helped(monkeypatch, arm, "", "", "")
    assert [found[name].verdict for name in HELPED] == ["not tried", "not tried"]
    assert "nobody laid a firm thing" in found["force"].found
    assert "nobody said where its x axis points" in found["tool x"].found


def test_who_says_yes_beforehand_is_asked_for_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("baggie.commissioning.doctor.open_workcell", lambda *_: cell())
    found = {finding.check: finding for finding in examine(DoctorOptions(move="yes"))}
    assert [found[name].verdict for name in HELPED] == ["not tried", "not tried"]
    require_healthy(list(found.values()))


class Blind(ObedientArm):
    """Goes on down through whatever is there."""

    def lower_until_contact(self, z_min: float, speed_m_s: float, force_n: float) -> ToolPose:
        self.at = replace(self.at, z=z_min)
        return self.at


def test_an_arm_that_feels_nothing_and_one_that_is_turned_have_failed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    found, _ = helped(monkeypatch, Blind(), "40")
    assert (found["touch"].verdict, found["force"].verdict) == ("ok", "failed")
    assert "feels nothing, or its force has the wrong sign" in found["force"].found
    assert found["tool x"] == Finding("tool x", "not tried", "after force has failed")
    found, _ = helped(monkeypatch, ObedientArm(), "", "", "n")
    assert found["tool x"].verdict == "failed"
    assert "at yaw 0 degrees the tool's x axis is seen to point at" in found["tool x"].found


def simulated(*sick: tuple[str, Any]) -> dict[str, Finding]:
    with pytest.MonkeyPatch.context() as patch:
        for name, method in sick:
            patch.setattr(SimulatedArm, name, method)
        return {finding.check: finding for finding in examine(DoctorOptions(move="yes"))}


@pytest.mark.slow
def test_a_simulated_arm_that_presses_its_way_down_is_found_out() -> None:
    lower = SimulatedArm.lower_until_contact
    found = simulated(("lower_until_contact", lambda arm, z, speed, _force: lower(arm, z, speed, math.inf)))
    assert (found["touch"].verdict, found["force"].verdict) == ("ok", "failed")
    assert "pushed on for as long as through the air" in found["force"].found


@pytest.mark.slow
def test_a_simulated_arm_whose_force_has_the_wrong_sign_is_found_out() -> None:
    felt = ArmWorld.upward_force.fget
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ArmWorld, "upward_force", property(lambda world: -felt(world)))
        found = simulated()
    assert (found["touch"].verdict, found["force"].verdict) == ("ok", "failed")


@pytest.mark.slow
def test_a_simulated_arm_that_is_turned_by_half_a_turn_is_seen() -> None:
    move, pose = SimulatedArm.move_to, SimulatedArm.pose

    def turned(at: ToolPose) -> ToolPose:
        return replace(at, yaw=at.yaw + math.pi)

    def move_turned(arm: SimulatedArm, target: ToolPose, speed_m_s: float) -> ToolPose:
        move(arm, turned(target), speed_m_s)
        return arm.pose()

    found = simulated(("pose", lambda arm: turned(pose(arm))), ("move_to", move_turned))
    assert (found["force"].verdict, found["tool x"].verdict) == ("ok", "failed")
    assert "fix what is seen to the side where x points" in found["tool x"].found


def test_without_leave_nothing_moves(monkeypatch: pytest.MonkeyPatch) -> None:
    arm = ObedientArm()
    monkeypatch.setattr("baggie.commissioning.doctor.open_workcell", lambda *_: cell(arm))
    findings = examine(DoctorOptions(move="no"))
    assert {f.verdict for f in findings if f.check in {*health.MOVING, *HELPED}} == {"not tried"}
    assert not arm.speeds


def test_nothing_moves_before_the_camera_works(frozen: ObedientArm) -> None:
    findings = examine(DoctorOptions(move="yes"))
    with pytest.raises(
        BaggieError, match="1 of 13 checks failed: pictures: eye shows the same picture twice"
    ):
        require_healthy(findings)
    assert not frozen.speeds


def test_a_workcell_file_that_cannot_be_read_is_a_finding(tmp_path: Path) -> None:
    (finding,) = examine(DoctorOptions(str(tmp_path / "nowhere.yaml")))
    assert (finding.check, finding.verdict) == ("workcell", "failed")
    assert "no workcell file" in finding.found


@pytest.mark.usefixtures("frozen")
def test_all_findings_are_on_stdout_when_one_has_failed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor", "--json"]) == 1
    printed = capsys.readouterr()
    findings = json.loads(printed.out)["findings"]
    assert {finding["check"] for finding in findings} == {"workcell", *health.STILL, *health.MOVING, *HELPED}
    assert [f["check"] for f in findings if f["verdict"] == "failed"] == ["pictures"]
    assert printed.err.startswith("error: 1 of 13 checks failed")
    assert len(printed.err.splitlines()) == 1


@pytest.mark.usefixtures("frozen")
def test_people_get_a_table_on_stdout(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor"]) == 1
    table = capsys.readouterr().out
    assert all(name in table for name in ("pictures", "failed", "not tried", *health.STILL))
