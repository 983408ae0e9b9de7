"""Nothing recorded is lost or doubled: killed at any moment, on a full disk, with files cut off."""

from __future__ import annotations

import errno
import itertools
import json
import multiprocessing
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from baggie.data import DatasetWriter, open_dataset
from baggie.errors import DataError
from synthetic import TASK, make_attempt

SIZE = (64, 36)


def writer(root: Path) -> DatasetWriter:
    return DatasetWriter(root, task=TASK, robot_type="drawn", picture_size=SIZE, collection={"seed": 0})


def append(root: Path, *ids: int) -> None:
    with writer(root) as recording:
        for i in ids:
            recording.append(make_attempt(i, np.random.default_rng(i), SIZE))


def expect_whole(root: Path, ids: set[int]) -> None:
    """The dataset holds these attempts, each once, and LeRobot sees exactly as many files."""
    dataset = open_dataset(root)
    assert dataset.attempt_ids.tolist() == sorted(ids)
    for attempt in dataset:
        expected = make_attempt(attempt.attempt_id, np.random.default_rng(attempt.attempt_id), SIZE)
        np.testing.assert_array_equal(attempt.before.color, expected.before.color)
        assert attempt.after is not None
        assert expected.after is not None
        np.testing.assert_array_equal(attempt.after.color, expected.after.color)
        assert attempt.outcome == expected.outcome


def expect_clean(root: Path, ids: set[int]) -> None:
    """As `expect_whole`, and nothing is left over."""
    expect_whole(root, ids)
    index = root / "attempts/index.parquet"
    if index.exists():
        assert set(pq.read_table(index)["attempt_id"].to_pylist()) <= ids
    for pattern in ("data/*/*", "meta/episodes/*/*", "attempts/*/*"):
        assert len(list(root.glob(pattern))) == len(ids), pattern
    assert list(root.glob(".baggie/partial/*")) == []
    stats = json.loads((root / "meta/stats.json").read_text())
    assert stats["action"]["count"] == [len(ids)]
    frames = [pq.read_table(path) for path in sorted(root.glob("data/*/*.parquet"))]
    assert [frame["episode_index"][0].as_py() for frame in frames] == list(range(len(ids)))
    assert {frame["annotation.attempt_id"][0].as_py() for frame in frames} == ids


def _die_at(step: int, root: Path) -> None:
    """Append attempt 7, dying instead of the `step`-th renaming of a file to its place."""
    calls, replace = 0, os.replace

    def dying(source: Path, target: Path) -> None:
        nonlocal calls
        calls += 1
        if calls == step:
            os._exit(9)
        replace(source, target)

    os.replace = dying  # type: ignore[assignment]
    append(root, 7)


@pytest.mark.parametrize("before", [(), (3, 1)])
def test_dying_at_any_step_loses_and_doubles_nothing(tmp_path: Path, before: tuple[int, ...]) -> None:
    outcomes = []
    for step in itertools.count(1):
        root = tmp_path / str(step)
        append(root, *before)
        child = multiprocessing.get_context("fork").Process(target=_die_at, args=(step, root))
        child.start()
        child.join()
        expect_whole(root, set(open_dataset(root).attempt_ids.tolist()))  # readable before any repair
        with writer(root) as recording:
            present = recording.attempt_ids
        assert set(before) <= present <= {*before, 7}
        if present:
            expect_clean(root, present)
        outcomes.append((child.exitcode, 7 in present))
        if child.exitcode == 0:
            break
        append(root, *({7, 8} - present))
        expect_clean(root, {*before, 7, 8})
    # Removed as long as the frame is not in its place; completed from then on, before statistics, description
    # and index; there when append returned.
    removed, completed = (9, False), (9, True)
    assert outcomes == [removed] * (len(outcomes) - 4) + [completed] * 3 + [(0, True)]


_RECORD = """
import sys, numpy as np
sys.path.insert(0, sys.argv[2])
from pathlib import Path
from test_data_safety import SIZE, make_attempt, writer
with writer(Path(sys.argv[1])) as recording:
    for i in range(12):
        if i not in recording.attempt_ids:
            recording.append(make_attempt(i, np.random.default_rng(i), SIZE))
            print(i, flush=True)
print("done", flush=True)
"""


def test_kill_9_again_and_again(tmp_path: Path) -> None:
    returned: list[str] = []
    draw = random.Random(0)
    for run in range(3):
        command = [sys.executable, "-c", _RECORD, str(tmp_path / "data"), str(Path(__file__).parent)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as child:
            assert child.stdout is not None
            lines = [child.stdout.readline().strip()]  # it is recording now
            if run < 2:
                time.sleep(draw.uniform(0, 0.2))
                child.send_signal(signal.SIGKILL)
            lines += child.stdout.read().split()
        returned += [line for line in lines if line.isdigit()]
    assert len(returned) == len(set(returned))
    expect_clean(tmp_path / "data", set(range(12)))


def test_a_full_disk_costs_nothing_recorded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = {"fsync": os.fsync, "replace": os.replace}
    calls = 0
    fails_at = 1

    def failing(name: str) -> Callable[..., object]:
        def call(*arguments: object) -> object:
            nonlocal calls
            calls += 1
            if calls == fails_at:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            return real[name](*arguments)  # type: ignore[operator]

        return call

    append(tmp_path, 0)
    with writer(tmp_path) as recording:
        for attempt_id in itertools.count(1):
            attempt = make_attempt(attempt_id, np.random.default_rng(attempt_id), SIZE)
            calls, fails_at = 0, attempt_id
            for name in real:
                monkeypatch.setattr(os, name, failing(name))
            try:
                recording.append(attempt)
            except DataError as error:
                monkeypatch.undo()
                assert str(error).startswith("no space left on the disk")  # noqa: PT017
                assert set(range(attempt_id)) <= set(open_dataset(tmp_path).attempt_ids.tolist())
            else:
                monkeypatch.undo()
                break  # every step of an append has failed once
            if attempt_id not in recording.attempt_ids:  # space was freed
                recording.append(attempt)
    assert attempt_id > 10
    expect_clean(tmp_path, set(range(attempt_id + 1)))


@pytest.mark.parametrize(
    "name",
    [
        "data/chunk-000/file-001.parquet",
        "attempts/chunk-000/attempt-000001.parquet",
        "attempts/collection.json",
        "meta/info.json",
    ],
)
@pytest.mark.parametrize("damage", ["cut", "empty", "gone"])
def test_a_damaged_file_is_named(tmp_path: Path, name: str, damage: str) -> None:
    append(tmp_path, 0, 1, 2)
    path = tmp_path / name
    content = path.read_bytes()
    path.write_bytes(content[: len(content) // 2] if damage == "cut" else b"")
    if damage == "gone":
        path.unlink()
    before = {p: p.read_bytes() for p in tmp_path.rglob("*.parquet")}
    for use in (open_dataset, writer):
        if damage == "gone" and name == "meta/info.json":
            continue  # nothing was counted yet: as if killed before the first attempt was complete
        with pytest.raises(DataError) as caught:
            use(tmp_path)
        assert "\n" not in str(caught.value)
        assert path.name in str(caught.value) or damage == "gone"
    assert {p: p.read_bytes() for p in tmp_path.rglob("*.parquet")} == before  # no good file was removed
    path.write_bytes(content)
    expect_clean(tmp_path, {0, 1, 2})


def test_damage_inside_a_file_is_named_when_it_is_read(tmp_path: Path) -> None:
    append(tmp_path, 0, 1)
    path = tmp_path / "data/chunk-000/file-001.parquet"
    content = bytearray(path.read_bytes())
    start = content.index(b"IDAT")
    content[start - 60 : start + 2000] = bytes(2060)
    path.write_bytes(content)
    dataset = open_dataset(tmp_path)
    assert dataset[0].attempt_id == 0
    with pytest.raises(DataError, match="file-001"):
        dataset.colors()


def test_a_dataset_changed_by_another_tool_is_left_alone(tmp_path: Path) -> None:
    append(tmp_path, 0, 1)
    extra = tmp_path / "data/chunk-000/file-007.parquet"
    extra.write_bytes((tmp_path / "data/chunk-000/file-000.parquet").read_bytes())
    with pytest.raises(DataError, match="changed by another tool"):
        writer(tmp_path)
    assert extra.exists()


@pytest.mark.parametrize("damage", ["gone", "cut", "stale", "other"])
def test_the_index_is_only_a_cache(tmp_path: Path, damage: str) -> None:
    append(tmp_path, 0, 1)
    index = tmp_path / "attempts/index.parquet"
    content = index.read_bytes()
    append(tmp_path, 2)
    if damage == "gone":
        index.unlink()
    elif damage == "other":
        pq.write_table(pq.read_table(index).select(["seed"]), index)
    else:
        index.write_bytes(content if damage == "stale" else content[:-9])
    expect_whole(tmp_path, {0, 1, 2})
    append(tmp_path, 3)
    expect_clean(tmp_path, {0, 1, 2, 3})
    assert pq.read_table(index)["attempt_id"].to_pylist() == [0, 1, 2, 3]
