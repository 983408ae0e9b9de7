import errno
import io
import json
import math
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import baggie.collect.patience as help_module
import baggie.data.writer
from baggie import seeds
from baggie.calibration.files import REFERENCE_FILE
from baggie.collect.collect import collect
from baggie.collect.machine import helped
from baggie.collect.patience import Awaited
from baggie.collect.recording import Recording
from baggie.collect.self_taught import COVERAGE_FILE, _open_worker, coverage, missing_sittings, what_opens
from baggie.data import open_dataset
from baggie.errors import BaggieError, BaggieWarning, DataError
from baggie.geometry import Rectangle
from baggie.operator import Line, Nobody, TerminalOperator
from baggie.options.collecting import CollectOptions
from helpers.fake_workcell import open_fake, open_faulty, open_unhelped
from helpers.scripted import Scripted
from helpers.streaming import Here


def assert_same(a: Path, b: Path) -> None:
    first, second = open_dataset(a), open_dataset(b)
    assert first.attempt_ids.tolist() == second.attempt_ids.tolist()
    for name, values in first.numbers().items():
        if name != "episode_index":  # the order of arrival
            assert np.array_equal(values, second.numbers()[name], equal_nan=values.dtype.kind == "f"), name
    for one, other in zip(first, second, strict=True):
        assert np.array_equal(one.before.color, other.before.color)
        assert np.array_equal(one.after.color, other.after.color)


collect_here = partial(collect, executor=Here())
"""No process of its own for a collection of few attempts."""


@pytest.fixture(scope="module")
def reference(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("reference") / "data"
    collect(CollectOptions(out=out, attempts=14, seed=3, workers=1), open_fake)
    return out


def test_collects_exactly_what_was_asked_for(reference, capsys):
    summary = collect(CollectOptions(out=reference, attempts=14, seed=3), open_fake)
    assert "recorded already" in capsys.readouterr().err
    assert open_dataset(reference).attempt_ids.tolist() == list(range(14))
    assert summary["attempts"] == 14
    assert summary["succeeded"] + sum(summary["failed"].values()) == 14
    assert summary["attempts_per_minute"] is None
    assert 0.1 < summary["coverage"] <= 1.0
    assert (reference / COVERAGE_FILE).stat().st_size > 1000
    assert json.loads(json.dumps(summary)) == summary


def test_the_same_seed_gives_the_same_arrays_whatever_the_workers(reference, tmp_path):
    collect(CollectOptions(out=tmp_path / "a", attempts=14, seed=3, workers=2), open_fake)
    assert_same(reference, tmp_path / "a")


def test_the_calibration_is_saved_as_a_policy_and_kept(reference):
    from baggie.policies import ColorMaskPolicy, load_policy

    policy = load_policy(reference / "calibration")
    assert isinstance(policy, ColorMaskPolicy)
    assert policy.object_color == open_fake().settings.object_color
    before = (reference / "calibration" / "image-to-robot.yaml").stat().st_mtime_ns
    collect(CollectOptions(out=reference, attempts=14, seed=3), open_fake)
    assert (reference / "calibration" / "image-to-robot.yaml").stat().st_mtime_ns == before


def test_another_seed_gives_another_recording_and_is_not_mixed_in(reference):
    with pytest.raises(DataError, match="seed"):
        collect(CollectOptions(out=reference, attempts=14, seed=4), open_fake)


def test_another_scenery_is_not_mixed_in(reference):
    with pytest.raises(DataError, match="scenery = 'plain', not 'varied'"):
        collect(CollectOptions(out=reference, attempts=14, seed=3, scenery="varied"), open_fake)


def test_another_bag_or_table_of_a_workcell_file_is_not_mixed_in(tmp_path):
    file, out = tmp_path / "cell.yaml", tmp_path / "data"

    def go_on(written, attempts):
        file.write_text(written)
        given = CollectOptions(out=out, attempts=attempts, workers=1, workcell=file)
        return collect_here(given, open_fake)["attempts"]

    bag = "arm: sim\nbag: {length_m: 0.13, width_m: 0.13}\n"
    assert go_on(bag, 1) == 1
    assert go_on(f"# slower\n{bag}limits: {{max_speed_m_s: 1.3}}\n", 2) == 2
    for other in (bag.replace("0.13", "0.12"), f"{bag}workspace: {{x: [0.4, 0.6]}}\n"):
        with pytest.raises(DataError, match="recorded with workcell"):
            go_on(other, 3)
    with pytest.raises(DataError, match="recorded with workcell"):
        collect_here(CollectOptions(out=out, attempts=3, workers=1), open_fake)
    settings = out / "attempts/collection.json"
    content = json.loads(settings.read_text())
    del content["collection"]["workcell"]  # as an older version wrote it
    settings.write_text(json.dumps(content))
    assert go_on(bag, 3) == 3


def test_a_recording_says_which_arm_moved(reference, tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", sys.path[:])
    assert open_dataset(reference).settings.robot_type == "fake"
    shutil.copy(Path(__file__).parents[1] / "examples" / "04_own_arm.py", tmp_path / "recorded_arm.py")
    file = tmp_path / "cell.yaml"
    file.write_text("arm: {kind: python, factory: 'recorded_arm:open_arm'}\ncamera: 0\n")
    _, robot, _ = what_opens(CollectOptions(out=tmp_path / "data", workcell=file))
    assert robot == "imaginary arm"
    file.write_text("arm: {kind: franka, host: 192.0.2.1}\ncamera: 0\n")
    assert what_opens(CollectOptions(out=tmp_path / "data", workcell=file))[1] == "FR3"


@pytest.mark.parametrize(
    ("before", "goes_on"), [("python", True), ("lerobot", True), ("simulated FR3", False)]
)
def test_an_older_recording_that_did_not_say_which_goes_on(tmp_path, before, goes_on):
    options = CollectOptions(out=tmp_path, attempts=1, workers=1)
    collect_here(options, open_fake)
    settings = tmp_path / "attempts/collection.json"
    settings.write_text(settings.read_text().replace('"fake"', f'"{before}"'))
    if goes_on:
        assert collect_here(options, open_fake)["attempts"] == 1
    else:
        with pytest.raises(DataError, match="robot_type = 'simulated FR3', not 'fake'"):
            collect_here(options, open_fake)


def test_a_bag_of_the_usual_height_is_recorded_as_ever(tmp_path):
    file, out = tmp_path / "cell.yaml", tmp_path / "data"
    table = []
    for bag in ("", "bag: {height_m: 0.03, hard: false}\n", "bag: {height_m: 0.05, hard: true}\n"):
        file.write_text(f"arm: {{kind: franka, host: 192.0.2.1}}\ncamera: 0\n{bag}")
        table.append(what_opens(CollectOptions(out=out, workcell=file))[2]["workcell"]["bag"])
    assert set(table[0]) == {"length_m", "width_m", "mass_kg", "color"}
    assert table[1] == table[0]
    assert (table[2]["height_m"], table[2]["hard"]) == (0.05, True)


def test_a_workspace_out_of_reach_is_one_clear_line(tmp_path):
    file = tmp_path / "cell.yaml"
    file.write_text("workspace: {x: [3.5, 4.5]}\n")
    options = CollectOptions(out=tmp_path / "data", attempts=1, workers=1, workcell=file)
    with pytest.raises(
        BaggieError, match=r"of 24 places of the workspace, x 3\.50\..4\.50 m.*, saw it in 0: "
    ):
        collect(options)


def test_what_is_kept_for_evaluation_is_not_collected(tmp_path):
    with pytest.raises(BaggieError, match="among plain, varied, got 'unseen'"):
        collect(CollectOptions(out=tmp_path / "a", scenery="unseen"), open_fake)
    with pytest.raises(BaggieError, match="with --workcell"):
        collect(CollectOptions(out=tmp_path / "a", scenery="varied", workcell=Path("cell.yaml")), open_fake)
    assert not (tmp_path / "a").exists()


def test_the_command_goes_on_with_the_same_scenery():
    assert "--scenery varied" in CollectOptions(out=Path("a"), scenery="varied").command()
    assert "--scenery" not in CollectOptions(out=Path("a")).command()


@pytest.mark.parametrize(("scenery", "kept"), [("plain", True), ("varied", False)])
def test_a_picture_to_compare_with_is_kept_where_bumps_are_watched_for(tmp_path, scenery, kept):
    collect_here(CollectOptions(out=tmp_path, attempts=1, workers=1, scenery=scenery), open_fake)
    assert (tmp_path / "calibration" / REFERENCE_FILE).exists() == kept


def test_without_a_reference_nothing_is_watched(reference):
    from baggie.policies import load_policy

    opened = []
    recording = Recording("", 0, 0, (320, 180))
    image_to_robot = load_policy(reference / "calibration").image_to_robot
    _open_worker(
        lambda number: opened.append(open_fake(number)) or opened[0],
        image_to_robot,
        recording,
        None,
        Nobody(),
    )
    assert opened[0].watch is None


CHILD = """
import sys
from pathlib import Path
from baggie.collect.self_taught import what_opens
from baggie.collect import CollectOptions, collect
from helpers.fake_workcell import open_slowly
if __name__ == "__main__":
    collect(CollectOptions(out=Path(sys.argv[1]), attempts=14, seed=3, workers=2), open_slowly)
"""


def start(out: Path, tmp_path: Path) -> subprocess.Popen[str]:
    script = tmp_path / "child.py"
    script.write_text(CHILD)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])}
    return subprocess.Popen(
        [sys.executable, str(script), str(out)], env=environment, stderr=subprocess.PIPE, text=True
    )


def wait_for_attempts(out: Path, count: int, child: subprocess.Popen[str]) -> None:
    deadline = time.monotonic() + 60
    while len(list(out.glob("attempts/*/*.parquet"))) < count:
        assert child.poll() is None, child.stderr.read()
        assert time.monotonic() < deadline
        time.sleep(0.02)


def children_of(pid: int) -> list[int]:
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text().rsplit(")", 1)[1].split()
        except OSError:
            continue
        if int(fields[1]) == pid:
            found.append(int(stat.parent.name))
    return found


def running(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0]
    except OSError:
        return False
    return state != "Z"


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc: runs on Linux")
@pytest.mark.parametrize("counts", [(5,), pytest.param((2, 8), marks=pytest.mark.slow)])
def test_killed_it_ends_with_every_attempt_once_and_no_orphans(reference, tmp_path, counts):
    out = tmp_path / "data"
    for count in counts:
        child = start(out, tmp_path)
        wait_for_attempts(out, count, child)
        workers = children_of(child.pid)
        assert workers
        child.kill()
        child.wait()
        deadline = time.monotonic() + 10
        while any(running(pid) for pid in workers):
            assert time.monotonic() < deadline, "a worker outlived the collection"
            time.sleep(0.05)
    collect_here(CollectOptions(out=out, attempts=14, seed=3, workers=1), open_fake)
    assert_same(reference, out)


def test_ctrl_c_saves_and_says_how_to_go_on(tmp_path):
    out = tmp_path / "data"
    child = start(out, tmp_path)
    wait_for_attempts(out, 3, child)
    child.send_signal(signal.SIGINT)
    _, errors = child.communicate(timeout=30)
    recorded = len(open_dataset(out))
    assert recorded >= 3
    assert f"interrupted with {recorded} of 14" in errors
    assert re.search(r"baggie collect --task bag-place --attempts 14 --seed 3 --cell 0 --out \S+data", errors)
    assert "KeyboardInterrupt" in errors  # the command line turns it into exit status 130


def test_a_full_disk_is_one_line_and_loses_nothing(tmp_path, monkeypatch):
    write_all, calls = baggie.data.writer.write_all, []

    def full(files, partial):
        calls.append(files)
        if len(calls) == 6:  # what is repaired, the settings, then attempts
            raise OSError(errno.ENOSPC, "No space left on device")
        write_all(files, partial)

    options = CollectOptions(out=tmp_path, attempts=5, seed=3, workers=1)
    with monkeypatch.context() as patch:
        patch.setattr(baggie.data.writer, "write_all", full)
        with pytest.raises(DataError, match="no space left") as caught:
            collect_here(options, open_fake)
    assert "\n" not in str(caught.value)
    assert len(open_dataset(tmp_path)) == 3
    assert collect_here(options, open_fake)["attempts"] == 5


def test_a_picture_that_cannot_be_written_costs_no_numbers(tmp_path):
    (tmp_path / COVERAGE_FILE).mkdir()
    with pytest.warns(BaggieWarning, match=f"{COVERAGE_FILE} cannot be written"):
        summary = collect_here(CollectOptions(out=tmp_path, attempts=2, seed=3, workers=1), open_fake)
    assert summary["attempts"] == 2
    assert "coverage_picture" not in summary


def test_nobody_to_help_stops_the_collection_and_keeps_what_there_is(tmp_path):
    options = CollectOptions(out=tmp_path, attempts=13, seed=3, workers=1)
    with pytest.raises(BaggieError, match="not in sight"):
        collect_here(options, open_unhelped)
    dataset = open_dataset(tmp_path)
    assert dataset.attempt_ids.tolist() == list(range(11))
    assert dataset.failures[-1] == "lost-bag"


def test_a_person_who_is_there_is_asked_and_it_goes_on(tmp_path, monkeypatch):
    laid_back = tmp_path / "laid-back"
    monkeypatch.setenv("LAID_BACK", str(laid_back))
    person = Scripted("", "", meanwhile=lambda _: laid_back.touch() if len(person.asked) == 2 else None)
    options = CollectOptions(out=tmp_path / "data", attempts=13, seed=3, workers=1)
    assert collect(options, open_unhelped, operator=person)["attempts"] == 13
    assert person.asked == ["the object is not in sight: put it back into the workspace"] * 2


def test_a_person_who_leaves_the_terminal_stops_it(tmp_path, monkeypatch):
    monkeypatch.setattr(TerminalOperator, "attended", True)
    monkeypatch.setattr(sys, "stdin", io.StringIO())  # Ctrl-D
    options = CollectOptions(out=tmp_path, attempts=13, seed=3, workers=1)
    with pytest.raises(BaggieError, match="not in sight"):
        collect_here(options, open_unhelped)


def test_without_a_terminal_it_waits_as_long_as_told(tmp_path, monkeypatch, capsys):
    laid_back = tmp_path / "laid-back"
    monkeypatch.setenv("LAID_BACK", str(laid_back))
    monkeypatch.setattr(help_module, "LOOK_AGAIN_S", 0.01)
    options = CollectOptions(out=tmp_path / "data", attempts=13, seed=3, workers=1, wait=0.002)
    with pytest.raises(BaggieError, match=r"^collecting stopped: .* the same command goes on$"):
        collect_here(options, open_unhelped)
    assert "Waiting 0.002 minutes" in capsys.readouterr().err
    laid_back.touch()
    assert collect_here(options, open_unhelped)["attempts"] == 13


@given(st.integers(0, 600), st.lists(st.integers(1, 40), min_size=100, max_size=100))
def test_a_wait_lasts_as_long_as_told_and_ends_with_a_look(wait_s, looking_s):
    now, person = [0], Scripted(attended=False)
    awaited = Awaited(person, wait_s, sleep=lambda s: now.append(now[-1] + s), clock=lambda: now[-1])
    for seconds in looking_s:
        slept_from = now[-1]
        if not helped(awaited, "gone"):
            break
        assert slept_from < now[-1] <= wait_s
        now.append(now[-1] + seconds)
    assert now[-1] >= wait_s
    assert len(person.told) == (wait_s > 0)


def test_each_trouble_has_a_wait_of_its_own():
    now, person = [0.0], Scripted(attended=False)
    awaited = Awaited(person, 50.0, sleep=lambda s: now.append(now[-1] + s), clock=lambda: now[-1])
    for _ in range(3):
        assert [helped(awaited, "gone") for _ in range(3)] == [True, True, False]
        awaited.worked()
    assert now[-1] == 150.0
    assert person.told == [Line("gone. Waiting 0.833333 minutes for somebody to help")] * 3


def test_where_only_the_simulator_could_help_nobody_is_asked():
    person = Scripted("")
    assert not helped(Awaited(person, 0.0, can_help=False), "gone")
    assert not person.asked


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"wait": -1.0}, "--wait"),
        ({"wait": math.nan}, "--wait"),
        ({"task": "juggle"}, "bag-place"),
        ({"attempts": 0}, "attempts"),
        ({"seed": -1}, "seed"),
        ({"workers": 0}, "workers"),
    ],
)
def test_impossible_options_are_one_clear_line(tmp_path, change, match):
    with pytest.raises(BaggieError, match=match):
        collect(CollectOptions(out=tmp_path, **change), open_fake)


def test_a_fault_of_arm_or_camera_is_waited_out(tmp_path, reference, monkeypatch, capsys):
    monkeypatch.setenv("FAULTS_LEFT", str(tmp_path / "left"))
    (tmp_path / "left").write_text("1")
    collect_here(CollectOptions(out=tmp_path / "data", attempts=4, seed=3, workers=1), open_faulty)
    assert "the cable came off. Trying again in 1 s\n" in capsys.readouterr().err
    assert (tmp_path / "left").read_text() == "0"
    first, again = open_dataset(reference), open_dataset(tmp_path / "data")
    assert again.attempt_ids.tolist() == [0, 1, 2, 3]
    for one, other in zip(
        first, again, strict=False
    ):  # a repeatable cell: the same attempts, none of them halved
        assert np.array_equal(one.after.color, other.after.color)


def test_one_arm_is_not_shared_by_workers(tmp_path):
    file = tmp_path / "cell.yaml"
    file.write_text("arm: {kind: franka, host: 192.0.2.1}\ncamera: 0\n")
    with pytest.raises(BaggieError, match=r"expected --workers 1 .* one arm, got 2"):
        collect(CollectOptions(out=tmp_path / "data", workcell=file, workers=2))


def test_one_arm_has_one_worker_unless_told_otherwise(tmp_path):
    file, here = tmp_path / "cell.yaml", Here()
    file.write_text("arm: {kind: franka, host: 192.0.2.1}\ncamera: 0\n")
    collect(CollectOptions(out=tmp_path / "data", workcell=file, attempts=1), open_fake, executor=here)
    assert here.workers == [1]


def test_a_workcell_file_is_read_once(reference, tmp_path, monkeypatch):
    file, reads, read = tmp_path / "cell.yaml", [], Path.read_bytes
    file.write_text(f"arm: {{kind: replay, recording: {reference}}}\n")
    monkeypatch.setattr(Path, "read_bytes", lambda path: reads.append(path) or read(path))
    with pytest.raises(BaggieError, match="to describe a workcell with an arm"):  # told when it is opened
        collect(CollectOptions(out=tmp_path / "data", workcell=file))
    assert reads.count(file) == 1


def test_what_cannot_be_repeated_goes_on_where_it_stopped(reference):
    from baggie.policies import load_policy

    cell = open_fake()
    cell.repeatable, cell.script = False, [None] * 5
    image_to_robot = load_policy(reference / "calibration").image_to_robot
    sit = _open_worker(
        lambda _number: cell, image_to_robot, Recording("task", 3, 0, (640, 360)), None, Nobody()
    )
    assert [attempt.attempt_id for (attempt,) in sit((17, 18, 19))] == [17, 18, 19]
    assert len(cell.script) == 2  # nothing was done over again


@pytest.mark.parametrize("symmetry", [4, 2, 0])
def test_an_attempt_says_how_often_a_turn_its_object_looks_the_same(reference, symmetry):
    from baggie.policies import load_policy

    cell = open_fake(miss_rate=0.0)
    image_to_robot = load_policy(reference / "calibration").image_to_robot
    sit = _open_worker(
        lambda _number: cell, image_to_robot, Recording("task", 3, 0, (640, 360)), None, Nobody()
    )
    (first,) = next(iter(sit((0, 1))))
    cell.settings = replace(cell.settings, object_symmetry=symmetry)  # as another scene may
    (second,) = next(iter(sit((0, 1))))
    assert (first.object_symmetry, second.object_symmetry) == (4, symmetry)


def test_a_sitting_that_goes_on_does_not_carry_to_the_same_places_again(reference):
    from baggie.policies import load_policy

    cell = open_fake(miss_rate=0.0)
    cell.repeatable = False
    image_to_robot = load_policy(reference / "calibration").image_to_robot
    sit = _open_worker(
        lambda _number: cell, image_to_robot, Recording("task", 3, 0, (640, 360)), None, Nobody()
    )
    places = [next(iter(sit(tuple(range(first, 10)))))[0].commanded.place for first in range(10)]
    assert len({(place.x, place.y) for place in places}) == 10


def test_where_nobody_knows_the_truth_none_is_recorded(reference, monkeypatch):
    from baggie.policies import load_policy

    cell = open_fake()
    monkeypatch.setattr(cell, "state", lambda: None)
    image_to_robot = load_policy(reference / "calibration").image_to_robot
    sit = _open_worker(
        lambda _number: cell, image_to_robot, Recording("task", 3, 0, (640, 360)), None, Nobody()
    )
    ((attempt,),) = sit((0,))
    assert attempt.outcome.success
    assert attempt.truth is None


def test_missing_ids_are_grouped_by_sitting_early_ones_first():
    assert missing_sittings(25, {0, 1, 2, 12, 30}) == [
        tuple(range(3, 10)),
        (10, 11, 13, 14, 15, 16, 17, 18, 19),
        tuple(range(20, 25)),
    ]
    assert missing_sittings(3, range(10)) == []


def test_coverage_counts_squares_reached():
    area = Rectangle(0.0, 0.10, 0.0, 0.10)
    assert coverage(np.array([[0.01, 0.01], [0.02, 0.03]]), area) == 0.25
    assert coverage(np.zeros((0, 2)), area) == 0.0


def test_streams_of_scenes_never_meet():
    names = [seeds.COLLECTION, seeds.PLACES, seeds.CALIBRATION, seeds.EVALUATION]
    draws = {seeds.generator(name, seed, 0).integers(2**63) for name in names for seed in range(50)}
    assert len(draws) == 200
