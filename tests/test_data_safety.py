"""Nothing recorded is lost or doubled: killed at any moment, on a full disk, with files cut off."""

from __future__ import annotations

import dataclasses
import errno
import itertools
import json
import multiprocessing
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from multiprocessing import forkserver
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from baggie.data import DatasetWriter, open_dataset
from baggie.errors import DataError
from baggie.types import Attempt
from helpers.synthetic import TASK, make_attempt

SIZE = (64, 36)


def writer(root: Path) -> DatasetWriter:
    return DatasetWriter(root, task=TASK, robot_type="drawn", picture_size=SIZE, collection={"seed": 0})


def attempt_of(attempt_id: int) -> Attempt:
    """Attempts from 100 on are the steps of episode 1, from 200 on of episode 2, ...; the others stand alone."""
    attempt = make_attempt(attempt_id, np.random.default_rng(attempt_id), SIZE)
    episode, step = divmod(attempt_id, 100)
    return (
        dataclasses.replace(attempt, episode=episode, step=step, reward=0.3, after=None)
        if episode
        else attempt
    )


def append(root: Path, *ids: int) -> None:
    with writer(root) as recording:
        for i in ids:
            recording.append(attempt_of(i))


def expect_whole(root: Path, ids: set[int]) -> None:
    """The dataset holds these attempts, each once, and LeRobot sees exactly as many files."""
    dataset = open_dataset(root)
    assert dataset.attempt_ids.tolist() == sorted(ids)
    for attempt in dataset:
        expected = attempt_of(attempt.attempt_id)
        np.testing.assert_array_equal(attempt.before.color, expected.before.color)
        assert (attempt.after is None) == (expected.after is None)
        if attempt.after and expected.after:
            np.testing.assert_array_equal(attempt.after.color, expected.after.color)
        assert (attempt.episode, attempt.step) == (expected.episode, expected.step)
        assert attempt.outcome == expected.outcome


def expect_clean(root: Path, ids: set[int]) -> None:
    """As `expect_whole`, and nothing is left over."""
    expect_whole(root, ids)
    index = root / "attempts/index.parquet"
    if index.exists():
        assert set(pq.read_table(index)["attempt_id"].to_pylist()) <= ids
    lengths = Counter(i // 100 if i >= 100 else -1 - i for i in ids)
    assert len(list(root.glob("attempts/*/*"))) == len(ids)
    for pattern in ("data/*/*", "meta/episodes/*/*"):
        assert len(list(root.glob(pattern))) == len(lengths), pattern
    assert list(root.glob(".baggie/partial/*")) == []
    stats = json.loads((root / "meta/stats.json").read_text())
    assert stats["action"]["count"] == [len(ids)]
    info = json.loads((root / "meta/info.json").read_text())
    assert (info["total_episodes"], info["total_frames"]) == (len(lengths), len(ids))
    start, seen = 0, []
    for episode in range(len(lengths)):
        file = f"chunk-000/file-{episode:03d}.parquet"
        frames = pq.read_table(root / "data" / file)
        row = pq.read_table(root / "meta/episodes" / file).to_pylist()[0]
        length = len(frames)
        assert (row["episode_index"], row["length"]) == (episode, length)
        assert (row["dataset_from_index"], row["dataset_to_index"]) == (start, start + length)
        assert row["stats/action/count"] == [length]
        actions = np.array(frames["action"].to_pylist())
        np.testing.assert_allclose(row["stats/action/mean"], actions.mean(axis=0), atol=1e-12)
        assert frames["episode_index"].to_pylist() == [episode] * length
        assert frames["frame_index"].to_pylist() == frames["timestamp"].to_pylist() == list(range(length))
        assert frames["index"].to_pylist() == list(range(start, start + length))
        seen += frames["annotation.attempt_id"].to_pylist()
        start += length
    assert len(seen) == len(ids)
    assert set(seen) == ids


@pytest.fixture(scope="module")
def exit_code_of() -> Callable[..., int | None]:
    """Runs a function of this file in a process of its own.

    It is forked, so that it begins at once, but not from this process: libraries have threads here, and what is forked
    from a process with threads may hang.
    """
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([__name__])
    with pytest.MonkeyPatch.context() as alone:
        alone.setenv("OPENBLAS_NUM_THREADS", "1")
        alone.setenv("JE_ARROW_MALLOC_CONF", "background_thread:false")
        alone.setenv("PYTHONPATH", os.pathsep.join(sys.path))
        forkserver.ensure_running()

    def run(target: Callable[..., None], *arguments: object) -> int | None:
        child = context.Process(target=target, args=arguments)
        child.start()
        child.join()
        return child.exitcode

    return run


def _die_at(step: int, root: Path, attempt_id: int) -> None:
    """Append an attempt, dying instead of the `step`-th renaming of a file to its place."""
    calls, replace = 0, os.replace

    def dying(source: Path, target: Path) -> None:
        nonlocal calls
        calls += 1
        if calls == step:
            os._exit(9)
        replace(source, target)

    os.replace = dying  # type: ignore[assignment]
    append(root, attempt_id)


@pytest.mark.parametrize(
    ("before", "dying", "next_one"),
    [
        pytest.param((), 7, 8, marks=pytest.mark.slow),
        ((3, 1), 7, 8),
        pytest.param((), 100, 101, marks=pytest.mark.slow),  # begins an episode
        ((3, 100, 101), 102, 103),  # goes on with one
        pytest.param((100, 101), 200, 201, marks=pytest.mark.slow),  # begins another
        pytest.param((3, 100, 101), 7, 200, marks=pytest.mark.slow),  # ends one by standing alone
    ],
)
def test_dying_at_any_step_loses_and_doubles_nothing(
    tmp_path: Path,
    before: tuple[int, ...],
    dying: int,
    next_one: int,
    exit_code_of: Callable[..., int | None],
) -> None:
    outcomes = []
    append(tmp_path / "before", *before)
    for step in itertools.count(1):
        root = shutil.copytree(tmp_path / "before", tmp_path / str(step))
        exit_code = exit_code_of(_die_at, step, root, dying)
        expect_whole(root, set(open_dataset(root).attempt_ids.tolist()))  # readable before any repair
        with writer(root) as recording:
            present = recording.attempt_ids
        assert set(before) <= present <= {*before, dying}
        if present:
            expect_clean(root, present)
        outcomes.append((exit_code, dying in present))
        if exit_code == 0:
            break
        append(root, *sorted({dying, next_one} - present))
        expect_clean(root, {*before, dying, next_one})
    # Removed as long as the frame is not in its place; completed from then on, before statistics, description
    # and index; there when append returned.
    removed, completed = (9, False), (9, True)
    assert outcomes == [removed] * (len(outcomes) - 4) + [completed] * 3 + [(0, True)]


def _repair_dying_at(step: int, root: Path) -> None:
    """Open for writing, dying instead of the `step`-th file put in its place or removed."""
    calls, real = 0, {"replace": os.replace, "unlink": os.unlink}

    def dying(name: str) -> Callable[..., object]:
        def call(*arguments: object) -> object:
            nonlocal calls
            calls += 1
            if calls == step:
                os._exit(9)
            return real[name](*arguments)  # type: ignore[operator]

        return call

    for name in real:
        setattr(os, name, dying(name))
    writer(root).close()


@pytest.mark.parametrize("died_at", [*(pytest.param(n, marks=pytest.mark.slow) for n in (1, 2, 4)), 3])
def test_dying_in_a_repair_is_repaired(
    tmp_path: Path, died_at: int, exit_code_of: Callable[..., int | None]
) -> None:
    """Of a writer that died going on with an episode."""
    append(tmp_path / "died", 3, 100, 101)
    exit_code_of(_die_at, died_at, tmp_path / "died", 102)
    for step in itertools.count(1):
        root = shutil.copytree(tmp_path / "died", tmp_path / str(step))
        exit_code = exit_code_of(_repair_dying_at, step, root)
        writer(root).close()
        expect_clean(root, {3, 100, 101} if died_at < 4 else {3, 100, 101, 102})
        if exit_code == 0:
            break
    assert step > 2


_RECORD = """
import sys
sys.path.insert(0, sys.argv[2])
from pathlib import Path
from test_data_safety import attempt_of, writer
with writer(Path(sys.argv[1])) as recording:
    for i in map(int, sys.argv[3].split(",")):
        if i not in recording.attempt_ids:
            recording.append(attempt_of(i))
            print(i, flush=True)
print("done", flush=True)
"""


@pytest.mark.parametrize(
    "ids", [pytest.param(range(12), marks=pytest.mark.slow), [*range(100, 106), 0, *range(200, 205)]]
)
def test_kill_9_again_and_again(tmp_path: Path, ids: Sequence[int]) -> None:
    returned: list[str] = []
    draw = random.Random(0)
    for run in range(3):
        arguments = [str(tmp_path / "data"), str(Path(__file__).parent), ",".join(map(str, ids))]
        command = [sys.executable, "-c", _RECORD, *arguments]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as child:
            assert child.stdout is not None
            lines = [child.stdout.readline().strip()]  # it is recording now
            if run < 2:
                time.sleep(draw.uniform(0, 0.2))
                child.send_signal(signal.SIGKILL)
            lines += child.stdout.read().split()
        returned += [line for line in lines if line.isdigit()]
    assert len(returned) == len(set(returned))
    expect_clean(tmp_path / "data", set(ids))


@pytest.mark.parametrize("first", [0, 100])
def test_a_full_disk_costs_nothing_recorded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, first: int
) -> None:
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

    append(tmp_path, first)
    with writer(tmp_path) as recording:
        for attempt_id in itertools.count(first + 1):
            attempt = attempt_of(attempt_id)
            calls, fails_at = 0, attempt_id - first
            for name in real:
                monkeypatch.setattr(os, name, failing(name))
            try:
                recording.append(attempt)
            except DataError as error:
                monkeypatch.undo()
                assert str(error).startswith("no space left on the disk")  # noqa: PT017
                assert set(range(first, attempt_id)) <= set(open_dataset(tmp_path).attempt_ids.tolist())
            else:
                monkeypatch.undo()
                break  # every step of an append has failed once
            if attempt_id not in recording.attempt_ids:  # space was freed
                recording.append(attempt)
    assert attempt_id - first > 10
    expect_clean(tmp_path, set(range(first, attempt_id + 1)))


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


@pytest.mark.parametrize("lost", [100, 101, 102])
def test_a_lost_record_of_an_episode_is_noticed(tmp_path: Path, lost: int) -> None:
    append(tmp_path, 7, 100, 101, 102)
    (tmp_path / f"attempts/chunk-000/attempt-{lost:06d}.parquet").unlink()
    before = {p: p.read_bytes() for p in tmp_path.rglob("*.parquet")}
    for use in (open_dataset, writer):
        with pytest.raises(DataError, match="record of"):
            use(tmp_path)
    assert {p: p.read_bytes() for p in tmp_path.rglob("*.parquet")} == before


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
