"""A robot and a camera that nobody here wrote: the example, and the whole way with it, judged by its own truth."""

from __future__ import annotations

import socket
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from baggie.errors import ArmError, BaggieError, CameraError
from baggie.workcell.config import open_workcell
from baggie.workcell.workcell_file import read_workcell_file

ROOT = Path(__file__).parents[1]
sys.path.append(str(ROOT / "benchmarks"))

import foreign_cell  # noqa: E402 -- benchmarks are no package
from foreign_cell import CUBE_M  # noqa: E402


@pytest.fixture
def nobody_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The example's workcell file, its simulator not running."""
    monkeypatch.setattr(sys, "path", sys.path[:])
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    for file in foreign_cell.EXAMPLE.glob("*.*"):
        (tmp_path / file.name).write_text(file.read_text().replace("8765", str(port)))
    return tmp_path / "cell.yaml"


def test_where_the_simulator_does_not_run_arm_and_camera_say_so_in_a_line(nobody_there: Path) -> None:
    cell = open_workcell(nobody_there)  # nothing is connected before it is used
    for use, error in ((cell.arm.pose, ArmError), (cell.camera.look, CameraError)):
        with pytest.raises(error, match=r"does not answer at port \d+ \(.+\); start simulator\.py$"):
            use()
    cell.close()


def test_the_example_opens_wide_enough_for_its_cube_and_lands_it_slowly(nobody_there: Path) -> None:
    cell = open_workcell(nobody_there)
    handling, written = cell.settings.handling, read_workcell_file(nobody_there)
    assert cell.settings.object_size_m == (CUBE_M,) * 3
    assert handling.release_width_m > CUBE_M
    assert handling.pick_z_m == CUBE_M / 2
    assert handling.fast_m_s == cell.arm.info.max_speed_m_s
    assert handling.feel_m_s < 0.1
    assert not written.handling.written, "all of it follows"
    cell.close()


@pytest.fixture(scope="module")
def came(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, Any]]:
    """What came of each step, in order; each is a documented command, and fails here where it fails."""
    try:
        foreign_cell.python_with_pybullet()
    except BaggieError as error:
        pytest.skip(str(error))
    return foreign_cell.whole_way(foreign_cell.Options(out=tmp_path_factory.mktemp("foreign")))


@pytest.mark.slow
def test_the_foreign_cell_is_calibrated_and_examined(came: dict[str, dict[str, Any]]) -> None:
    assert "felt 3 times" in came["contracts"]["found"][0]
    assert came["calibrate image-to-robot"]["leave_one_out_mm"] < 2
    findings = came["doctor"]["findings"]
    assert {finding["check"] for finding in findings} > {
        "pictures",
        "view",
        "corners",
        "touch",
        "force",
        "tool x",
    }
    assert [finding for finding in findings if finding["verdict"] != "ok"] == []


@pytest.mark.slow
def test_a_night_in_the_foreign_cell(came: dict[str, dict[str, Any]]) -> None:
    night = came["collect"]
    assert night["attempts"] == 40
    assert night["succeeded"] >= 38
    assert len(night["landed_cm"]) == night["succeeded"]
    assert np.median(night["gripped_cm"]) < 0.3
    assert np.median(night["landed_cm"]) < 0.3
    assert max(night["landed_cm"]) < 2, "what counts as a success is one"


@pytest.mark.slow
def test_the_foreign_cell_s_cube_is_moved_to_goals(
    came: dict[str, dict[str, Any]], below: Callable[[str, float, float], None]
) -> None:
    moved = came["evaluate"]
    assert len(moved["distance_cm"]) == 10
    below("the median distance of the foreign cell's cube, cm", float(np.median(moved["distance_cm"])), 0.5)
    assert sum(distance <= 2 for distance in moved["distance_cm"]) >= 9
    assert moved["robot"] == "PyBullet's Panda"
    assert "cell.yaml" in Path(came["report"]["page"]).read_text()


@pytest.mark.slow
@pytest.mark.parametrize("step", ["contracts", "doctor", "collect", "evaluate"])
def test_the_foreign_cell_s_table_is_pressed_no_harder_than_the_limits_allow(
    came: dict[str, dict[str, Any]], step: str
) -> None:
    limits = read_workcell_file(foreign_cell.EXAMPLE / "cell.yaml").limits
    assert came[step]["pressed_n"] < limits.max_contact_force_n
