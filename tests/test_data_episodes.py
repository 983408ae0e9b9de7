"""Attempts that belong to an episode, and pictures from straight above: stored, read back, and as LeRobot sees them."""

from __future__ import annotations

import dataclasses
import itertools
import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from baggie.data import DatasetWriter, open_dataset
from baggie.data.lerobot import DTYPES, IMAGE
from baggie.data.record import MAX_HEIGHT_M, decode_height, encode_height
from baggie.errors import BaggieError, DataError
from baggie.geometry import Grid
from baggie.types import Attempt, Observation
from helpers.same import expect_same
from helpers.synthetic import TASK, make_attempt

SIZE = (64, 36)
GRID = Grid((0.3, 0.3 + 64 * 0.005), (-0.09, 0.09), (0.0, 0.3), 0.005)


def writer(root: Path) -> DatasetWriter:
    return DatasetWriter(root, task=TASK, robot_type="drawn", picture_size=SIZE)


def make(attempt_id: int, episode: int | None, step: int = 0, reward: float | None = None) -> Attempt:
    attempt = make_attempt(attempt_id, np.random.default_rng(attempt_id), SIZE)
    return dataclasses.replace(attempt, episode=episode, step=step, reward=reward)


def seen_from_above(seed: int = 0, grid: Grid = GRID) -> Observation:
    rng = np.random.default_rng(seed)
    color = rng.integers(0, 256, (*grid.shape, 3), np.uint8)
    return Observation(color, time=3.5, grid=grid, height=rng.random(grid.shape, np.float32) * 0.3)


def record(root: Path, attempts: Sequence[Attempt]) -> None:
    with writer(root) as recording:
        for attempt in attempts:
            recording.append(attempt)


def refusal(recording: DatasetWriter, attempt: Attempt) -> str:
    with pytest.raises(DataError) as caught:
        recording.append(attempt)
    assert "\n" not in str(caught.value)
    return str(caught.value)


MIXED = [
    make(40, None),
    make(41, 7, 0, 0.25),
    make(42, 7, 1, 0.0),
    make(43, 7, 2, 0.75),
    make(3, 2, 0),
    make(2, 2, 1),
    make(1, None, reward=0.5),
    *(make(50 + step, 0, step, 1 / 6) for step in range(6)),
]
"""An episode that is done, one in which nobody counts, and one whose sixths sum to less than 1; two stand alone."""
LENGTHS = [1, 3, 2, 1, 6]


def test_episodes_are_read_back(tmp_path: Path) -> None:
    record(tmp_path, MIXED[:5])
    record(tmp_path, MIXED[5:])  # in the middle of an episode
    dataset = open_dataset(tmp_path)
    expected = sorted(MIXED, key=lambda attempt: attempt.attempt_id)
    for attempt, original in zip(dataset, expected, strict=True):
        expect_same(attempt, original)
    assert dataset.episodes.tolist() == [-1 if a.episode is None else a.episode for a in expected]
    numbers = dataset.numbers()
    assert numbers["episode"].tolist() == dataset.episodes.tolist()
    assert numbers["step"].tolist() == [a.step for a in expected]
    np.testing.assert_array_equal(
        numbers["reward"], [np.nan if a.reward is None else a.reward for a in expected]
    )
    for picture, original in zip(dataset.colors(), expected, strict=True):
        np.testing.assert_array_equal(picture, original.before.color)
    assert dataset.grid is None
    with writer(tmp_path) as recording:
        assert recording.episodes == {7: 3, 2: 2, 0: 6}


def test_lerobot_sees_episodes_of_several_frames(tmp_path: Path) -> None:
    record(tmp_path, MIXED)
    info = json.loads((tmp_path / "meta/info.json").read_text())
    assert (info["total_episodes"], info["total_frames"]) == (len(LENGTHS), sum(LENGTHS))
    assert (info["fps"], info["splits"]) == (1, {"train": f"0:{len(LENGTHS)}"})
    done, start = [], 0
    dataset = open_dataset(tmp_path)
    for episode, length in enumerate(LENGTHS):
        file = f"chunk-000/file-{episode:03d}.parquet"
        frames = pq.read_table(tmp_path / "data" / file)
        assert frames["frame_index"].to_pylist() == list(range(length))
        assert frames["timestamp"].to_pylist() == [step / info["fps"] for step in range(length)]
        assert frames["index"].to_pylist() == list(range(start, start + length))
        assert frames["annotation.attempt_id"].to_pylist() == [
            a.attempt_id for a in MIXED[start : start + length]
        ]
        done.append(frames["next.done"].to_pylist())
        described = pq.read_table(tmp_path / "meta/episodes" / file).to_pylist()[0]
        assert described["length"] == length
        assert (described["dataset_from_index"], described["dataset_to_index"]) == (start, start + length)
        rows = [dataset.attempt_ids.tolist().index(a.attempt_id) for a in MIXED[start : start + length]]
        pixels = dataset.colors(rows).reshape(-1, 3) / 255
        for name in (*DTYPES, IMAGE):
            values = (
                pixels if name == IMAGE else np.array(frames[name].to_pylist(), float).reshape(length, -1)
            )
            expect_stats({k: described[f"stats/{name}/{k}"] for k in STATS}, values, length)
        start += length
    # Without rewards nobody knows when it is done.
    assert done == [[True], [False, False, True], [False, False], [True], [False] * 5 + [True]]
    stats = json.loads((tmp_path / "meta/stats.json").read_text())
    actions = np.float32(dataset.numbers()["executed"]).astype(float)
    expect_stats(stats["action"], actions, len(MIXED))
    expect_stats(stats[IMAGE], dataset.colors().reshape(-1, 3) / 255, len(MIXED))
    expect_stats(stats["next.done"], np.array([*itertools.chain(*done)], float)[:, None], len(MIXED))


STATS = ("min", "max", "mean", "std", "q01", "q10", "q50", "q90", "q99", "count")


def expect_stats(stats: dict[str, list[float]], values: np.ndarray, count: int) -> None:
    expected = {"min": values.min(0), "max": values.max(0), "mean": values.mean(0), "std": values.std(0)}
    for key, q in {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}.items():
        expected[key] = np.quantile(values, q, axis=0)
    for key, value in expected.items():
        np.testing.assert_allclose(np.ravel(stats[key]), value, rtol=1e-9, atol=1e-9, err_msg=key)
    assert stats["count"] == [count]


def test_more_frames_leave_the_earlier_ones_where_they_are(tmp_path: Path) -> None:
    """So that a reader who knows where a picture lies finds it, whatever the writer does meanwhile."""
    path = tmp_path / "data/chunk-000/file-000.parquet"
    with writer(tmp_path) as recording:
        recording.append(make(0, 5))
        before = open_dataset(tmp_path)
        rows = path.read_bytes()[: pq.ParquetFile(path).metadata.row_group(0).total_byte_size]
        recording.append(make(1, 5, 1, 1.0))
        assert path.read_bytes().startswith(rows)
        np.testing.assert_array_equal(before.colors()[0], make(0, 5).before.color)
        for attempt_id in (0, 1):
            record = pq.read_table(
                tmp_path / f"attempts/chunk-000/attempt-{attempt_id:06d}.parquet"
            ).to_pylist()[0]
            png = path.read_bytes()[record["before_offset"] :][: record["before_length"]]
            assert png == pq.read_table(path)[IMAGE].to_pylist()[attempt_id]["bytes"]
    pq.write_table(pq.read_table(path), path, compression="gzip")  # by another program
    for row, picture in enumerate(open_dataset(tmp_path).colors()):
        np.testing.assert_array_equal(picture, make(row, 5).before.color)


def test_steps_come_in_order_and_episodes_one_after_the_other(tmp_path: Path) -> None:
    with writer(tmp_path) as recording:
        assert "step 0 of episode 4, got 1" in refusal(recording, make(0, 4, 1))
        assert "stands alone, got 1" in refusal(recording, make(0, None, 1))
        assert "0 or more, got -2" in refusal(recording, make(0, -2))
        recording.append(make(0, 4))
        assert "step 1 of episode 4, got 0" in refusal(recording, make(1, 4))
        assert "step 1 of episode 4, got 2" in refusal(recording, make(1, 4, 2))
        recording.append(make(1, 4, 1))
        recording.append(make(2, 5))
        assert "expected episode 4 to be the last" in refusal(recording, make(3, 4, 2))
    with writer(tmp_path) as recording:
        assert "expected episode 4 to be the last" in refusal(recording, make(3, 4, 2))
        recording.append(make(3, 5, 1))
        recording.append(make(4, None))
        assert "expected episode 5 to be the last" in refusal(recording, make(5, 5, 2))
    assert open_dataset(tmp_path).episodes.tolist() == [4, 4, 5, 5, -1]


def test_after_is_the_next_ones_before(tmp_path: Path) -> None:
    first, second = (dataclasses.replace(make(i, 3, i), after=None) for i in range(2))
    record(tmp_path, [first, second, make(2, None)])
    dataset = open_dataset(tmp_path)
    assert dataset[0].after is None
    expect_same(dataset.after(0), second.before)
    assert dataset.after(1) is None
    expect_same(dataset.after(-1), make(2, None).after)
    assert dataset[:1].after(0) is None


_NEW = [
    "episode",
    "step",
    "reward",
    "before_grid",
    "after_grid",
    "before_height",
    "after_height",
    "object_symmetry",
]


@pytest.mark.parametrize("index", ["old", "gone"])
def test_recordings_from_before_there_were_episodes(tmp_path: Path, index: str) -> None:
    record(tmp_path, [make(i, None) for i in (3, 0)])
    for path in tmp_path.glob("attempts/**/*.parquet"):
        table = pq.read_table(path)
        pq.write_table(table.drop_columns([name for name in _NEW if name in table.column_names]), path)
    if index == "gone":
        (tmp_path / "attempts/index.parquet").unlink()
    for _ in range(2):
        dataset = open_dataset(tmp_path)
        for attempt in dataset[:2]:
            expect_same(attempt, make(attempt.attempt_id, None))
        assert dataset.episodes.tolist()[:2] == [-1, -1]
        assert dataset.numbers()["step"].tolist()[:2] == [0, 0]
        assert np.isnan(dataset.numbers()["reward"].astype(float)[:2]).all()
        if len(dataset) == 2:
            record(tmp_path, [make(5, 0), make(6, 0, 1, 1.0), make(7, None)])
    assert dataset.episodes.tolist() == [-1, -1, 0, 0, -1]
    expect_same(dataset[3], make(6, 0, 1, 1.0))


def test_how_an_object_looks_turned_is_said_by_each_attempt_and_by_older_recordings_of_all(
    tmp_path: Path,
) -> None:
    with DatasetWriter(
        tmp_path, task=TASK, robot_type="drawn", picture_size=SIZE, collection={"object_symmetry": 2}
    ) as writer:
        for i, symmetry in enumerate((4, 0, None)):
            writer.append(dataclasses.replace(make(i, None), object_symmetry=symmetry))
    dataset = open_dataset(tmp_path)
    assert [attempt.object_symmetry for attempt in dataset] == [4, 0, 2]
    said = dataset.numbers()["object_symmetry"]
    assert np.array_equal(said, [4, 0, np.nan], equal_nan=True)


def test_another_column_may_not_be_missing(tmp_path: Path) -> None:
    record(tmp_path, [make(0, None)])
    path = tmp_path / "attempts/chunk-000/attempt-000000.parquet"
    pq.write_table(pq.read_table(path).drop_columns(["executed"]), path)
    with pytest.raises(DataError, match=r"attempt-000000\.parquet lacks the column executed"):
        _ = open_dataset(tmp_path)[0]


@settings(max_examples=50, deadline=None)
@given(hnp.arrays(float, (5, 7), elements=st.floats(0, MAX_HEIGHT_M)))
def test_heights_come_back_to_five_micrometres(metres: np.ndarray) -> None:
    height = metres.astype(np.float32)
    back = decode_height(encode_height(height), Path("x"))
    assert back.dtype == np.float32
    np.testing.assert_allclose(back, height, rtol=0, atol=5e-6 + 6e-8)
    np.testing.assert_array_equal(decode_height(encode_height(back), Path("x")), back)
    assert (back[height == 0] == 0).all()


def test_pictures_from_above_are_read_back(tmp_path: Path) -> None:
    views = [seen_from_above(seed) for seed in range(3)]
    record(
        tmp_path,
        [
            dataclasses.replace(make(i, 0, i), before=views[i], after=views[2] if i else None)
            for i in range(2)
        ],
    )
    dataset = open_dataset(tmp_path)
    assert dataset.grid == GRID
    for attempt, view in zip(dataset, views, strict=False):
        assert attempt.before.grid == GRID
        np.testing.assert_array_equal(attempt.before.color, view.color)
        np.testing.assert_allclose(attempt.before.height, view.height, rtol=0, atol=5.1e-6)
    assert dataset[1].after is not None
    np.testing.assert_allclose(dataset[1].after.height, views[2].height, rtol=0, atol=5.1e-6)
    heights = dataset.heights()
    assert heights.dtype == np.float32
    assert heights.shape == (2, *GRID.shape)
    np.testing.assert_array_equal(dataset.heights([-1, 0], threads=1), heights[::-1])
    assert dataset.heights([]).shape == (0, *GRID.shape)
    # LeRobot would make an input of a picture of heights.
    features = json.loads((tmp_path / "meta/info.json").read_text())["features"]
    assert [name for name, feature in features.items() if feature["dtype"] == "image"] == [IMAGE]


def test_pictures_from_above_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    view = seen_from_above()
    other = Grid((0.0, 64 * 0.01), (0.0, 36 * 0.01), pixel_m=0.01)
    assert view.height is not None
    with writer(tmp_path) as recording:

        def refused(**changes: object) -> str:
            before = dataclasses.replace(view, **changes)  # type: ignore[arg-type]
            return refusal(recording, dataclasses.replace(make(0, None), before=before))

        assert "with one; take both from one fuse()" in refused(height=view.height[:-1])
        assert "without one" in refused(grid=None)
        assert "as large as its grid" in refused(grid=Grid())
        assert "from 0 to 0.65535 m" in refused(height=view.height + 1)
        assert "from 0 to 0.65535 m" in refused(height=view.height - 1)
        assert "from 0 to 0.65535 m" in refused(height=np.full_like(view.height, np.nan))
        with pytest.raises(BaggieError, match="expected an orthographic picture of 160 x 320"):
            recording.append(dataclasses.replace(make(0, None), before=seen_from_above(grid=Grid())))
        recording.append(dataclasses.replace(make(0, None), before=view))
        recording.append(dataclasses.replace(make(1, None), before=seen_from_above(grid=other)))
        recording.append(make(2, None))
    dataset = open_dataset(tmp_path)
    with pytest.raises(DataError, match="one grid, got 3"):
        _ = dataset.grid
    assert dataset[:1].grid == GRID
    with pytest.raises(DataError, match="got none in attempt 2"):
        dataset.heights()
    assert dataset.heights([0, 1]).shape == (2, *GRID.shape)
