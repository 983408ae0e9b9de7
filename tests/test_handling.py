"""How a thing is handled follows from what it is and what the arm can do."""

from __future__ import annotations

import json
import math
import re
import shutil
import sys
from dataclasses import asdict, fields, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import baggie
from baggie.cameras.camera import Camera
from baggie.cli.main import main
from baggie.commissioning.check import _object_height_m
from baggie.commissioning.doctor import examine
from baggie.errors import BaggieError, LimitError
from baggie.geometry import PlanarPose, ToolPose
from baggie.options.commissioning import CheckOptions, DoctorOptions
from baggie.robot.arm import ArmInfo
from baggie.robot.handling_rules import ROOM_M, Thing, contradiction, handled
from baggie.robot.limits import GuardedArm
from baggie.robot.primitives import Handling, pick, place, rehearse
from baggie.types import PickPlace
from baggie.workcell import config
from baggie.workcell.workcell import WorkcellSettings
from baggie.workcell.workcell_file import BagEntry, HandlingEntry, read_workcell_file
from helpers.recording_arm import RecordingArm, TimelessCell

LIMITS = WorkcellSettings().limits
HAND = ArmInfo("hand", max_width_m=0.08, max_speed_m_s=1.7, max_force_n=70.0)
CUBE = Thing((0.065, 0.065, 0.065), hard=True)
EXAMPLE = Path(__file__).parents[1] / "examples" / "04_own_arm.py"

sides = st.floats(0.012, 0.12)
things = st.builds(
    lambda length, width, height, hard: Thing((length, width, height), hard, long=length >= 1.2 * width),
    sides,
    sides,
    st.floats(0.013, 0.12),
    st.booleans(),
)
arms = st.builds(
    lambda width, speed, force: ArmInfo("any", width, speed, force),
    st.floats(0.04, 0.14),
    st.floats(0.05, 2.0),
    st.floats(5.0, 100.0),
)


def test_the_usual_bag_is_handled_as_ever() -> None:
    assert handled(BagEntry().thing, LIMITS).handling == Handling()
    assert handled(BagEntry().thing, LIMITS, HAND).handling == Handling()


def test_a_file_has_an_entry_for_all_of_it() -> None:
    assert set(HandlingEntry.model_fields) == {field.name for field in fields(Handling)}


@given(things, arms)
def test_what_follows_contradicts_nothing_unless_the_hand_is_too_narrow(thing: Thing, arm: ArmInfo) -> None:
    found = handled(thing, LIMITS, arm)
    line = contradiction(found.handling, thing, LIMITS, arm)
    if thing.hard and thing.gripped_m + 2 * ROOM_M > arm.max_width_m:
        assert line is not None
        assert re.search("the bag is hard and .* take a narrower one, or another gripper", line)
        return
    assert line is None
    assert "written" not in found.sources.values()
    gate = GuardedArm(RecordingArm(), LIMITS)
    gate.info = arm
    way = rehearse(gate, PickPlace(PlanarPose(0.5, 0.1), PlanarPose(0.4, -0.1)), found.handling)
    height = thing.size_m[2]
    assert way, "the gate lets all of it through"
    assert found.handling.approach_z_m >= height + 0.05, "the open fingers arrive above it"
    if thing.hard:
        h = found.handling
        assert h.pick_z_m < height
        assert height - h.pick_z_m <= max(0.041, height / 2), "the palm stays off its top"
        assert h.travel_z_m - h.pick_z_m >= height, "what is carried passes over another such thing"
        assert h.release_width_m > thing.gripped_m
        assert h.empty_width_m < min(thing.size_m)


@given(
    things, arms, st.dictionaries(st.sampled_from([f.name for f in fields(Handling)]), st.floats(0.01, 0.2))
)
def test_what_is_written_wins(thing: Thing, arm: ArmInfo, written: dict[str, float]) -> None:
    found = handled(thing, LIMITS, arm, written)
    values = asdict(found.handling)
    assert {name: values[name] for name in written} == written
    assert {name for name, source in found.sources.items() if source == "written"} == set(written)
    assert found.sources.keys() == values.keys()


@pytest.mark.parametrize(
    ("thing", "written", "line"),
    [
        (
            CUBE,
            {"release_width_m": 0.035},
            r"release_width_m is 0\.035, which never lets go .* 0\.065 m wide; raise it to 0\.07",
        ),
        (
            CUBE,
            {"open_width_m": 0.07},
            r"open_width_m is 0\.07, a hand needs 0\.075 to go over .* 0\.065 m wide",
        ),
        (CUBE, {"empty_width_m": 0.07}, r"empty_width_m is 0\.07, .* a hand that holds it counts as empty"),
        (CUBE, {"approach_z_m": 0.06}, r"approach_z_m is 0\.06, the bag is 0\.065 m high; raise it"),
        (
            Thing((0.05, 0.05, 0.01), hard=True),
            {},
            r"pick_z_m is 0\.012, .* so the fingers close above it",
        ),
        (
            Thing((0.075, 0.075, 0.03), hard=True),
            {},
            r"0\.075 m wide, the gripper of hand opens to 0\.08, and needs",
        ),
        (BagEntry().thing, {"fast_m_s": 1.0}, r"fast_m_s is 1, hand moves at up to 0\.5 m/s; lower it"),
        (
            BagEntry().thing,
            {"open_width_m": 0.09},
            r"open_width_m is 0\.09, the gripper of hand opens to 0\.08",
        ),
        (
            BagEntry().thing,
            {"release_width_m": 0.09},
            r"release_width_m is 0\.09, the gripper of hand opens to 0\.08",
        ),
        (
            BagEntry().thing,
            {"grasp_force_n": 25.0},
            r"grasp_force_n is 25, the gripper of hand squeezes with up to 20 N",
        ),
    ],
)
def test_a_contradiction_is_said_in_one_line(thing: Thing, written: dict[str, float], line: str) -> None:
    arm = replace(HAND, max_speed_m_s=0.5, max_force_n=20.0)
    said = contradiction(handled(thing, LIMITS, arm, written).handling, thing, LIMITS, arm)
    assert said is not None
    assert re.search(line, said)
    assert "\n" not in said


def test_a_long_hard_thing_is_gripped_across_its_narrow_side() -> None:
    long = Thing((0.15, 0.05, 0.04), hard=True, long=True)
    assert contradiction(handled(long, LIMITS, HAND).handling, long, LIMITS, HAND) is None
    assert handled(long, LIMITS, HAND).handling.release_width_m == pytest.approx(0.07)


def test_a_hard_thing_presses_no_more_than_the_limits_say() -> None:
    """On an arm that reacts in 50 ms and is as stiff as 6 N/mm: at 0.35 m/s it would press over 100 N."""
    h = handled(CUBE, LIMITS, HAND).handling
    assert h.land_force_n + 6000.0 * 0.05 * h.feel_m_s < LIMITS.max_contact_force_n
    assert h.land_force_n + 6000.0 * 0.05 * Handling().feel_m_s > 100
    gentle = handled(CUBE, replace(LIMITS, max_contact_force_n=20.0), HAND).handling
    assert gentle.feel_m_s < h.feel_m_s


def carrying(width: float, thing: Thing) -> tuple[TimelessCell, RecordingArm]:
    arm = RecordingArm(width=width)
    settings = WorkcellSettings(handling=handled(thing, LIMITS, arm.info).handling)
    return TimelessCell(arm, cast(Camera, None), settings), arm


def test_a_wide_hard_thing_is_let_go_of_and_put_down() -> None:
    cell, arm = carrying(0.065, CUBE)
    outcome = cell.execute(PickPlace(PlanarPose(0.5, 0.1), PlanarPose(0.45, -0.1)))
    assert outcome.success
    assert arm.width > 0.07
    assert not cell.put_down()
    arm.at, arm.width = ToolPose(0.5, 0.1, 0.25), 0.065  # as a run that was ended left it
    assert cell.put_down()
    assert arm.width > 0.07


@pytest.mark.parametrize("width", [0.01, 0.05, 0.065, 0.07])
def test_whatever_is_in_the_hand_is_put_down(width: float) -> None:
    cell, arm = carrying(width, BagEntry().thing)
    arm.width = width
    assert cell.put_down()


def test_a_hand_that_closed_on_next_to_nothing_does_not_hold_a_cube() -> None:
    h = handled(CUBE, LIMITS, HAND).handling
    assert not pick(RecordingArm(width=0.01), PlanarPose(0.5, 0.0), h).held
    held = pick(arm := RecordingArm(width=0.065), PlanarPose(0.5, 0.0), h)
    assert held.held
    assert held.pose.z == pytest.approx(0.0325)
    assert place(arm, PlanarPose(0.4, 0.0), h).held


# on stacks


class StackArm(RecordingArm):
    """Feels as little as `feels_n`; its tool touches something at a height, and may sink in further."""

    def __init__(self, top_z: float, feels_n: float = 0.1) -> None:
        super().__init__()
        self.info = replace(self.info, feels_n=feels_n)
        self.top_z, self.forces = top_z, list[float]()

    def lower_until_contact(self, z_min: float, speed_m_s: float, force_n: float) -> ToolPose:
        self._floor = self.top_z if force_n < 5.0 else -math.inf
        self.forces.append(force_n)
        return super().lower_until_contact(z_min, speed_m_s, force_n)


STACK = PickPlace(PlanarPose(0.5, 0.1), PlanarPose(0.45, -0.1))
heights = st.floats(0.0, 0.15)


@given(heights, heights, st.floats(0.0, 0.15))
def test_the_hand_goes_as_low_as_follows_from_what_lies_there_and_passes_over_the_rest(
    pick_on: float, place_on: float, tallest: float
) -> None:
    arm, h = RecordingArm(), Handling()
    cell = TimelessCell(arm, cast(Camera, None), WorkcellSettings())
    outcome = cell.execute(replace(STACK, pick_on_m=pick_on, place_on_m=place_on, tallest_m=tallest))
    assert outcome.pick_z_m == pytest.approx(max(pick_on - 0.012, 0.0) + h.pick_z_m)
    assert outcome.place_z_m == pytest.approx(place_on + h.place_z_m)
    start = arm.poses.index(outcome.executed.pick.at_height(outcome.pick_z_m))
    aside = [
        (here, there) for here, there in pairwise(arm.poses[start:]) if (here.x, here.y) != (there.x, there.y)
    ]
    assert aside
    over = max(place_on, tallest)
    assert all(min(here.z, there.z) >= over + h.travel_z_m - 0.01 for here, there in aside)


def test_what_is_hard_is_taken_where_it_is_counted_and_what_is_felt_for_is_not_taken_lower() -> None:
    h, action = Handling(), replace(STACK, pick_on_m=0.05)
    hard = TimelessCell(RecordingArm(), cast(Camera, None), WorkcellSettings(object_hard=True))
    assert hard.execute(action).pick_z_m == pytest.approx(0.05 + h.pick_z_m)
    feels = TimelessCell(StackArm(0.09), cast(Camera, None), WorkcellSettings())
    assert feels.execute(action).pick_z_m == pytest.approx(0.09 - h.sink_m)


def test_an_action_that_says_nothing_of_heights_is_for_the_table() -> None:
    plain, said = RecordingArm(), RecordingArm()
    for arm, action in ((plain, STACK), (said, replace(STACK, pick_on_m=0.0, place_on_m=0.0, tallest_m=0.0))):
        TimelessCell(arm, cast(Camera, None), WorkcellSettings()).execute(action)
    assert plain.poses == said.poses


@given(st.floats(0.05, 0.15))
def test_where_nobody_knows_how_high_a_soft_thing_lies_it_is_felt_for(top: float) -> None:
    arm, h = StackArm(top), Handling()
    assert pick(arm, STACK.pick, h, None).pose.z == pytest.approx(max(top - h.sink_m, h.pick_z_m))
    assert place(arm, STACK.place, h, None).pose.z == pytest.approx(max(top - h.press_m, h.place_z_m))
    assert arm.forces == [h.top_force_n, h.touch_force_n, h.stand_force_n, h.land_force_n]


def test_what_is_higher_than_counted_stops_the_hand() -> None:
    arm = RecordingArm(floor_z=0.15)
    arm.info = replace(arm.info, feels_n=0.1)
    assert place(arm, STACK.place, Handling(), 0.05).pose.z == pytest.approx(0.15)


@given(st.floats(0.05, 0.15), st.floats(-0.01, 0.01))
def test_an_arm_that_feels_corrects_a_counted_height_by_touch(top: float, off: float) -> None:
    h = Handling()
    for arm, lands in ((StackArm(top), top - h.press_m), (StackArm(top, feels_n=5.0), top + off)):
        counted = top + off - h.place_z_m
        assert place(arm, STACK.place, h, counted).pose.z == pytest.approx(
            max(lands, top + off - 0.012) if arm.info.feels_n < 1 else lands
        )


def test_an_arm_that_feels_too_little_says_so_and_does_not_come_down() -> None:
    arm = StackArm(0.05, feels_n=2.0)
    cell = TimelessCell(arm, cast(Camera, None), WorkcellSettings())
    with pytest.raises(
        LimitError, match=r"expected an arm that feels 0\.7 N.*which feels 2 N; say the height"
    ):
        cell.execute(replace(STACK, pick_on_m=None))
    assert not arm.forces


# in a workcell file

SLOW_ARM = """
from dataclasses import replace
from own_arm_here import open_arm as usual

def open_arm():
    arm = usual()
    arm.info = replace(arm.info, max_speed_m_s=0.3)
    return arm
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(sys, "path", sys.path[:])
    for module in ("own_arm_here", "slow_arm"):
        monkeypatch.delitem(sys.modules, module, raising=False)
    shutil.copy(EXAMPLE, tmp_path / "own_arm_here.py")
    (tmp_path / "slow_arm.py").write_text(SLOW_ARM)
    writer = cv2.VideoWriter(str(tmp_path / "table.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 10, (64, 48))
    writer.write(np.zeros((48, 64, 3), np.uint8))
    writer.release()
    return tmp_path


def written(folder: Path, more: str = "", module: str = "own_arm_here") -> Path:
    path = folder / "cell.yaml"
    arm = f"{{kind: python, factory: '{module}:open_arm'}}"
    path.write_text(f"arm: {arm}\ncamera: {folder / 'table.avi'}\n{more}")
    return path


CUBE_ENTRY = "bag: {length_m: 0.065, width_m: 0.065, height_m: 0.065, hard: true}\n"


def test_a_hard_cube_in_a_file_is_handled_as_one(folder: Path) -> None:
    cell = baggie.open_workcell(written(folder, CUBE_ENTRY))
    h = cell.settings.handling
    assert cell.settings.object_size_m == (0.065, 0.065, 0.065)
    assert h.release_width_m > 0.07
    assert h.feel_m_s < 0.06
    cell.close()


def test_show_says_what_is_written_and_what_follows(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = written(folder, f"{CUBE_ENTRY}handling: {{carry_m_s: 0.4}}\n")
    assert main(["workcell", "show", str(path), "--json"]) == 0
    shown: dict[str, Any] = json.loads(capsys.readouterr().out)
    handling = shown["handling"]
    assert handling["carry_m_s"] == {"value": 0.4, "source": "written"}
    assert handling["pick_z_m"] == {"value": 0.0325, "source": "the object"}
    assert handling["open_width_m"] == {"value": 0.08, "source": "the gripper"}
    assert handling["touch_force_n"]["source"] == "default"
    assert "imaginary arm" in shown["gripper"]
    assert main(["workcell", "show", str(path)]) == 0
    assert "carry m s: value 0.4, source written" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("more", "module", "line"),
    [
        (
            f"{CUBE_ENTRY}handling: {{release_width_m: 0.035}}\n",
            "own_arm_here",
            "never lets go of a hard bag",
        ),
        (
            "handling: {fast_m_s: 0.5}\n",
            "slow_arm",
            r"fast_m_s is 0\.5, imaginary arm moves at up to 0\.3 m/s",
        ),
        (CUBE_ENTRY.replace("0.065", "0.08"), "own_arm_here", "another gripper"),
    ],
)
def test_what_contradicts_is_refused_by_all_that_open_it(
    folder: Path, capsys: pytest.CaptureFixture[str], more: str, module: str, line: str
) -> None:
    path = written(folder, more, module)
    with pytest.raises(BaggieError, match=line) as raised:
        baggie.open_workcell(path)
    assert "cell.yaml" in str(raised.value)
    assert main(["workcell", "show", str(path)]) == 1
    assert re.search(line, capsys.readouterr().err)
    (finding,) = examine(DoctorOptions(str(path), move="no"))
    assert finding.verdict == "failed"
    assert re.search(line, finding.found)


def test_a_slow_arm_is_asked_for_no_more_than_it_can(folder: Path) -> None:
    cell = baggie.open_workcell(written(folder, module="slow_arm"))
    assert (cell.settings.handling.fast_m_s, cell.settings.handling.carry_m_s) == (0.3, 0.3)
    cell.close()


def test_show_does_without_an_arm_that_cannot_be_made_here(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["workcell", "show", str(written(folder, module="not_here")), "--json"]) == 0
    assert "not known here" in json.loads(capsys.readouterr().out)["gripper"]


@pytest.mark.parametrize("more", ["", "bag: {length_m: 0.15, width_m: 0.1}\n"])
def test_simulated_bags_are_handled_as_ever(tmp_path: Path, more: str) -> None:
    path = tmp_path / "cell.yaml"
    path.write_text(f"arm: sim\n{more}")
    assert read_workcell_file(path).handled().handling == Handling()


@pytest.mark.parametrize(
    ("bag", "line"),
    [
        ("height_m: 0.05", r"bag\.height_m is 0\.05, a simulated bag rests 0\.03 m high; leave it out"),
        ("hard: true", r"bag\.hard is true, a simulated bag is soft; leave it out"),
        ("length_m: 0.05, width_m: 0.05", r"bag\.length_m is 0\.05, expected 0\.06 to 0\.2 .* seem empty"),
        ("length_m: 0.1, width_m: 0.13", r"the longer side as length_m, got 0\.1 and a width_m of 0\.13"),
    ],
)
def test_what_a_simulated_bag_cannot_be_is_refused(tmp_path: Path, bag: str, line: str) -> None:
    path = tmp_path / "cell.yaml"
    path.write_text(f"bag: {{{bag}}}\n")
    with pytest.raises(BaggieError, match=line):
        read_workcell_file(path)


def test_a_simulated_bag_may_say_its_own_height(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[WorkcellSettings] = []
    monkeypatch.setattr(
        "baggie.workcell.simulated.SimulatedWorkcell", lambda _cell, settings, **_: opened.append(settings)
    )
    path = tmp_path / "cell.yaml"
    path.write_text("bag: {height_m: 0.03}\n")
    config._open(read_workcell_file(path), path)
    assert opened[0].object_size_m == WorkcellSettings().object_size_m
    assert opened[0].handling == Handling()


def test_a_learned_map_is_compared_at_half_the_height_that_is_written(folder: Path) -> None:
    file = str(written(folder, CUBE_ENTRY))
    assert _object_height_m(CheckOptions(workcell=file)) == 0.065
    assert _object_height_m(CheckOptions()) == 0.03


@pytest.mark.parametrize("side", [0.02, 0.3])
def test_a_real_bag_may_be_small_or_large(folder: Path, side: float) -> None:
    path = written(folder, f"bag: {{length_m: {side}, width_m: {side}}}\n")
    assert read_workcell_file(path).bag.length_m == side
