"""What is written is what is read, to the bit, and nothing else is accepted."""

from __future__ import annotations

import dataclasses
import json
import math
import stat
import tempfile
from pathlib import Path

import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from baggie.data import Dataset, DatasetWriter, open_dataset
from baggie.data.lerobot import DTYPES, IMAGE, NUMERIC_FEATURES
from baggie.errors import BaggieWarning, DataError
from baggie.geometry import Grid, PlanarPose
from baggie.types import Attempt, Intrinsics, Observation, Outcome, PickPlace, Truth
from helpers.same import expect_same
from helpers.synthetic import TASK, make_attempt

SIZE = (64, 36)


def writer(root: Path, size: tuple[int, int] = SIZE, **collection: object) -> DatasetWriter:
    return DatasetWriter(root, task=TASK, robot_type="drawn", picture_size=size, collection=collection)


def record(root: Path, ids: list[int], seed: int = 0) -> list[Attempt]:
    rng = np.random.default_rng(seed)
    attempts = [make_attempt(i, rng, SIZE, failure="missed-grasp" if i % 5 == 2 else None) for i in ids]
    with writer(root) as recording:
        for attempt in attempts:
            recording.append(attempt)
    return attempts


finite = st.floats(-1e6, 1e6)
numbers = st.floats(allow_nan=True, allow_infinity=True)
poses = st.builds(PlanarPose, finite, finite, finite)
heights = st.none() | st.floats(0.0, 1.0)
actions = st.builds(PickPlace, poses, poses, heights, heights, st.floats(0.0, 1.0))
layers = st.none() | st.integers(0, 8)
corners = hnp.arrays(float, (4, 2), elements=st.one_of(finite, st.just(math.nan)))
seeds = st.integers(0, 2**32)
colors = seeds.map(lambda seed: np.random.default_rng(seed).integers(0, 256, (36, 64, 3), np.uint8))
millimetres = seeds.map(lambda seed: np.random.default_rng(seed).integers(0, 2**16, (36, 64)))
depths = millimetres.map(lambda mm: (mm / 1000).astype(np.float32))
cameras = st.builds(
    Intrinsics,
    st.just(SIZE[0]),
    st.just(SIZE[1]),
    hnp.arrays(float, (3, 3), elements=finite),
    st.sampled_from([0, 4, 5, 8]).flatmap(lambda n: hnp.arrays(float, n, elements=finite)),
)
metres = st.floats(-2, 2)


def grid_of(x: float, y: float, z: float, pixel_m: float) -> Grid:
    """A grid of SIZE pixels."""
    return Grid((x, x + SIZE[0] * pixel_m), (y, y + SIZE[1] * pixel_m), (z, z + 0.3), pixel_m)


grids = st.builds(grid_of, metres, metres, metres, st.floats(1e-3, 1e-2))
ten_micrometres = seeds.map(lambda seed: np.random.default_rng(seed).integers(0, 2**16, (36, 64)))
heights = ten_micrometres.map(lambda steps: (steps / 100_000).astype(np.float32))
of_cameras = st.builds(Observation, colors, st.none() | depths, st.none() | cameras, finite)
orthographic = st.builds(Observation, colors, st.none(), st.none(), finite, grids, st.none() | heights)
observations = of_cameras | orthographic
outcomes = st.builds(
    Outcome,
    actions,
    st.sampled_from([None, "missed-grasp", "dropped", "lost-bag", "unreachable", "stalled"]),
    numbers,
    numbers,
    numbers,
    numbers,
    st.integers(0, 2**62),
    st.dictionaries(st.text(max_size=8), numbers, max_size=3),
)
whole = st.integers(-(2**63), 2**63 - 1)
attempts = st.builds(
    Attempt,
    st.integers(0, 2**40),
    st.just(TASK),
    observations,
    st.none() | observations,
    actions,
    outcomes,
    corners,
    corners,
    whole,
    whole,
    st.floats(0, 2e9),
    st.none() | st.builds(Truth, poses, poses),
    st.none() | st.integers(0, 2**63 - 1),
    st.just(0),
    st.none() | numbers,
    st.none() | st.integers(0, 8),
    layers,
    layers,
    st.lists(poses, max_size=2).map(tuple),
)


@settings(max_examples=25, deadline=None)
@given(attempts)
def test_reading_gives_back_what_was_written(attempt: Attempt) -> None:
    with tempfile.TemporaryDirectory() as folder:
        with writer(Path(folder)) as recording:
            recording.append(attempt)
        expect_same(open_dataset(folder)[0], attempt)


def test_attempts_are_sorted_by_id_and_episodes_by_arrival(tmp_path: Path) -> None:
    written = {attempt.attempt_id: attempt for attempt in record(tmp_path, [7, 2, 9, 0])}
    dataset = open_dataset(tmp_path)
    assert dataset.attempt_ids.tolist() == [0, 2, 7, 9]
    assert dataset.numbers()["episode_index"].tolist() == [3, 1, 0, 2]
    for attempt in dataset:
        expect_same(attempt, written[attempt.attempt_id])
    pictures = dataset.colors()
    for attempt, picture in zip(dataset, pictures, strict=True):
        np.testing.assert_array_equal(picture, attempt.before.color)


def test_views_are_lists_of_attempts(tmp_path: Path) -> None:
    record(tmp_path, list(range(8)))
    dataset = open_dataset(tmp_path)
    assert [a.attempt_id for a in dataset[2:7:2]] == [2, 4, 6]
    assert dataset[-1].attempt_id == dataset[5:][-1].attempt_id == 7
    successful = dataset.successful()
    assert isinstance(successful, Dataset)
    assert successful.attempt_ids.tolist() == [0, 1, 3, 4, 5, 6]
    np.testing.assert_array_equal(successful.colors([2, -1]), dataset.colors([3, 6]))
    assert len(dataset[3:3]) == 0
    assert dataset[3:3].numbers()["executed"].shape == (0, 6)
    with pytest.raises(IndexError):
        dataset[8]


def test_numbers_are_those_of_the_attempts(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    plain = dataclasses.replace(make_attempt(1, rng, SIZE), truth=None, after=None)
    with writer(tmp_path) as recording:
        recording.append(plain)
        recording.append(make_attempt(0, rng, SIZE, failure="dropped"))
    dataset = open_dataset(tmp_path)
    numbers = dataset.numbers()
    for row, attempt in enumerate(dataset):
        np.testing.assert_array_equal(numbers["executed"][row], attempt.outcome.executed.to_array())
        np.testing.assert_array_equal(numbers["commanded"][row], attempt.commanded.to_array())
        np.testing.assert_array_equal(numbers["box_before"][row], attempt.box_before)
        assert numbers["time"][row] == attempt.time
        assert numbers["success"][row] == attempt.outcome.success
        assert numbers["timings_s.pick"][row] == attempt.outcome.timings_s["pick"]
    assert np.isfinite(numbers["truth_before"][0]).all()
    assert np.isnan(numbers["truth_before"][1]).all()
    assert np.isnan(numbers["after_time"][1])


def test_pictures_and_corners_are_stored_at_the_recorded_size(tmp_path: Path) -> None:
    attempt = make_attempt(0, np.random.default_rng(0), (1280, 720))
    with writer(tmp_path, (640, 360)) as recording:
        recording.append(attempt)
    stored = open_dataset(tmp_path)[0]
    expect_same(stored.before, attempt.before.resized(640, 360))
    np.testing.assert_allclose(stored.box_before, (attempt.box_before + 0.5) / 2 - 0.5, atol=1e-12)
    # The corners still lie on the bag: it is red inside them and not beyond.
    inside = np.zeros((360, 640), np.uint8)
    cv2.fillPoly(inside, [np.round(stored.box_before).astype(np.int32)], 1)
    red = stored.before.color[..., 0].astype(int) - stored.before.color[..., 1] > 60
    assert (red & (inside == 1)).sum() > 0.98 * red.sum() > 500


def test_colors_may_be_resized(tmp_path: Path) -> None:
    record(tmp_path, [0, 1])
    dataset = open_dataset(tmp_path)
    small = dataset.colors(size=(32, 18), threads=1)
    for picture, attempt in zip(small, dataset, strict=True):
        np.testing.assert_array_equal(picture, attempt.before.resized(32, 18).color)


def test_depth_that_cannot_be_stored_is_unknown(tmp_path: Path) -> None:
    depth = np.full((SIZE[1], SIZE[0]), 1.2344, np.float32)
    depth[0, :4] = [np.nan, np.inf, -1.0, 70.0]
    attempt = make_attempt(0, np.random.default_rng(0), SIZE)
    attempt = dataclasses.replace(attempt, before=dataclasses.replace(attempt.before, depth=depth))
    with writer(tmp_path) as recording:
        recording.append(attempt)
    read = open_dataset(tmp_path)[0].before.depth
    assert read is not None
    assert read[0, :4].tolist() == [0, 0, 0, 0]
    assert (read[1:] == np.float32(1.234)).all()


def test_an_attempt_is_recorded_once(tmp_path: Path) -> None:
    record(tmp_path, [0, 1])
    with writer(tmp_path) as recording:
        assert recording.attempt_ids == {0, 1}
        with pytest.raises(DataError, match=r"attempt 1 is in .+ already"):
            recording.append(make_attempt(1, np.random.default_rng(5), SIZE))
        recording.append(make_attempt(2, np.random.default_rng(5), SIZE))
    assert open_dataset(tmp_path).attempt_ids.tolist() == [0, 1, 2]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"task": "sing"}, "is of task 'sing'"),
        ({"attempt_id": -1}, "must be 0 or more"),
        ({"seed": 2**63}, "cannot be stored"),
        ({"box_before": np.zeros((3, 2))}, r"must be \(4, 2\)"),
    ],
)
def test_what_cannot_be_stored_is_refused_and_harms_nothing(
    tmp_path: Path, change: dict[str, object], message: str
) -> None:
    attempt = make_attempt(0, np.random.default_rng(0), SIZE)
    with writer(tmp_path) as recording:
        with pytest.raises(DataError, match=message):
            recording.append(dataclasses.replace(attempt, **change))  # type: ignore[arg-type]
        recording.append(attempt)
    expect_same(open_dataset(tmp_path)[0], attempt)


def test_a_dataset_is_continued_only_with_its_own_settings(tmp_path: Path) -> None:
    with writer(tmp_path, seed=0, color=(200, 40, 40)):
        pass
    with writer(tmp_path, seed=0, color=(200, 40, 40)):
        pass
    with pytest.raises(DataError, match="recorded with seed = 0, not 1"):
        writer(tmp_path, seed=1, color=(200, 40, 40))
    with pytest.raises(DataError, match=r"picture_size = \(64, 36\), not \(32, 18\)"):
        writer(tmp_path, (32, 18), seed=0, color=(200, 40, 40))
    assert dict(open_dataset(tmp_path).collection) == {"seed": 0, "color": [200, 40, 40]}
    with pytest.raises(DataError, match="must be JSON"):
        writer(tmp_path / "other", rng=np.random.default_rng(0))


def test_a_simulated_dataset_goes_on_under_other_physics_and_says_so(tmp_path: Path) -> None:
    with writer(tmp_path, seed=0):
        pass
    with (
        pytest.warns(BaggieWarning, match=r"other simulated physics \(1, now 2\)"),
        writer(tmp_path, seed=0, physics=2),
    ):
        pass
    assert dict(open_dataset(tmp_path).collection) == {"seed": 0}


def test_only_one_writer_at_a_time(tmp_path: Path) -> None:
    with writer(tmp_path) as first:
        with pytest.raises(DataError, match="being recorded into already"):
            writer(tmp_path)
        first.append(make_attempt(0, np.random.default_rng(0), SIZE))
    with pytest.raises(DataError, match="is closed"):
        first.append(make_attempt(1, np.random.default_rng(0), SIZE))
    writer(tmp_path).close()


def test_reading_writes_nothing(tmp_path: Path) -> None:
    record(tmp_path, [0, 1, 2])
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")}
    dataset = open_dataset(tmp_path)
    list(dataset)
    dataset.colors()
    dataset.numbers()
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")} == before
    assert all(not path.stat().st_mode & stat.S_IXUSR for path in before if path.is_file())


def test_reading_needs_a_dataset(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="does not exist"):
        open_dataset(tmp_path / "nowhere")
    with pytest.raises(DataError, match="holds no dataset"):
        open_dataset(tmp_path)
    (tmp_path / "meta").mkdir()
    (tmp_path / "meta/info.json").write_text("{}")
    for use in (open_dataset, writer):
        with pytest.raises(DataError, match="LeRobot dataset without"):
            use(tmp_path)


def test_an_empty_dataset_has_no_attempts(tmp_path: Path) -> None:
    writer(tmp_path).close()
    dataset = open_dataset(tmp_path)
    assert len(dataset) == 0
    assert dataset.colors().shape == (0, SIZE[1], SIZE[0], 3)
    assert dataset.numbers()["executed"].shape == (0, 6)


def test_statistics_are_exact(tmp_path: Path) -> None:
    record(tmp_path, [3, 1, 4, 0, 5])
    with writer(tmp_path) as recording:  # continued: the statistics go on from the disk
        for i in (9, 2, 6):
            recording.append(make_attempt(i, np.random.default_rng(i), SIZE))
    stats = json.loads((tmp_path / "meta/stats.json").read_text())
    dataset = open_dataset(tmp_path)
    pixels = dataset.colors().reshape(-1, 3) / 255
    actions = np.float32(dataset.numbers()["executed"]).astype(float)
    for values, name in ((pixels, IMAGE), (actions, "action")):
        expected = {"min": values.min(0), "max": values.max(0), "mean": values.mean(0), "std": values.std(0)}
        for key, q in {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}.items():
            expected[key] = np.quantile(values, q, axis=0)
        for key, value in expected.items():
            np.testing.assert_allclose(np.ravel(stats[name][key]), value, rtol=1e-9, atol=1e-12, err_msg=key)
        assert stats[name]["count"] == [8]
    assert np.shape(stats[IMAGE]["mean"]) == (3, 1, 1)
    assert set(stats) == {IMAGE, *NUMERIC_FEATURES}


def test_lerobots_part_shows_a_policy_no_more_than_it_may_see(tmp_path: Path) -> None:
    record(tmp_path, [0, 1])
    info = json.loads((tmp_path / "meta/info.json").read_text())
    features = info["features"]
    assert [name for name, f in features.items() if f["dtype"] in ("image", "video")] == [IMAGE]
    assert {name for name in features if name.startswith("observation")} == {IMAGE, "observation.state"}
    assert [name for name in features if name.startswith("action")] == ["action"]
    assert features[IMAGE]["names"][2] == "channels"
    assert info["total_episodes"] == info["total_frames"] == 2
    for episode in range(2):
        frame = pq.read_table(tmp_path / f"data/chunk-000/file-{episode:03d}.parquet")
        assert set(frame.column_names) == set(features)
        assert frame["episode_index"].to_pylist() == frame["index"].to_pylist() == [episode]
        for name, dtype in DTYPES.items():
            if features[name]["shape"] == [1]:
                assert str(frame.schema.field(name).type).replace("double", "float64") in (
                    dtype.name,
                    dtype.name.replace("float32", "float"),
                )


def test_wall_clock_survives_float32(tmp_path: Path) -> None:
    attempt = dataclasses.replace(make_attempt(0, np.random.default_rng(0), SIZE), time=1764000000.123456)
    with writer(tmp_path) as recording:
        recording.append(attempt)
    frame = pq.read_table(tmp_path / "data/chunk-000/file-000.parquet")
    assert frame["annotation.time_us"].to_pylist() == [1764000000123456]
    assert open_dataset(tmp_path)[0].time == attempt.time


def test_pictures_are_found_where_another_program_rewrote_the_file(tmp_path: Path) -> None:
    attempts = record(tmp_path, [0, 1])
    path = tmp_path / "data/chunk-000/file-001.parquet"
    pq.write_table(pq.read_table(path), path, compression="gzip")
    np.testing.assert_array_equal(open_dataset(tmp_path).colors([1])[0], attempts[1].before.color)
