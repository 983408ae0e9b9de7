import json
from pathlib import Path

import numpy as np
import pytest

from baggie.cli import main
from baggie.commissioning import health
from baggie.commissioning.doctor import DoctorOptions, examine, require_healthy
from baggie.errors import ArmError, BaggieError, CameraError
from baggie.types import Observation
from baggie.workcell.workcell import Workcell, WorkcellSettings
from recording_arm import RecordingArm, TimelessCell


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
    monkeypatch.setattr("baggie.workcell.config.open_workcell", lambda *_: cell(arm, Eye(frozen=True)))
    return arm


def test_a_healthy_arm_passes_and_moves_slowly() -> None:
    arm = ObedientArm()
    for check in health.MOVING.values():
        assert check(cell(arm))
    assert arm.speeds
    assert max(arm.speeds) <= 0.1


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
    asked: list[str] = []

    def leave(question: str) -> bool:
        asked.append(question)
        return True

    findings = examine(DoctorOptions(), leave)
    require_healthy(findings)
    found = {finding.check: finding.verdict for finding in findings}
    assert len(asked) == 1
    assert list(found) == ["workcell", *health.STILL, *health.MOVING]
    sick = {name for name, verdict in found.items() if verdict != "ok"}
    assert sick == {"calibrations", "view"}, "a fresh cell has none"


def test_without_leave_nothing_moves(monkeypatch: pytest.MonkeyPatch) -> None:
    arm = ObedientArm()
    monkeypatch.setattr("baggie.workcell.config.open_workcell", lambda *_: cell(arm))
    findings = examine(DoctorOptions(move="no"))
    assert {f.verdict for f in findings if f.check in health.MOVING} == {"not tried"}
    assert not arm.speeds


def test_nothing_moves_before_the_camera_works(frozen: ObedientArm) -> None:
    findings = examine(DoctorOptions(move="yes"))
    with pytest.raises(
        BaggieError, match="1 of 11 checks failed: pictures: eye shows the same picture twice"
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
    assert {finding["check"] for finding in findings} >= {"workcell", *health.STILL, *health.MOVING}
    assert [f["check"] for f in findings if f["verdict"] == "failed"] == ["pictures"]
    assert printed.err.startswith("error: 1 of 11 checks failed")
    assert len(printed.err.splitlines()) == 1


@pytest.mark.usefixtures("frozen")
def test_people_get_a_table_on_stdout(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor"]) == 1
    table = capsys.readouterr().out
    assert all(name in table for name in ("pictures", "failed", "not tried", *health.STILL))
