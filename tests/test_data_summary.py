"""What `baggie inspect` tells."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import pytest

from baggie.data import DatasetWriter, contact_sheet, inspect_dataset, open_dataset
from baggie.data.summary import goal_of
from baggie.errors import DataError
from baggie.geometry import Grid
from baggie.types import Image, Observation
from helpers.synthetic import TASK, WORKSPACE, make_attempt

SIZE = (160, 90)
FAILED = {1: "missed-grasp", 4: "lost-bag", 6: "missed-grasp"}


def load(path: Path) -> Image:
    return np.asarray(PIL.Image.open(path))


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("recording")
    rng = np.random.default_rng(0)
    with DatasetWriter(
        root, task=TASK, robot_type="drawn", picture_size=SIZE, collection={"seed": 3}
    ) as writer:
        for i in range(8):
            attempt = make_attempt(i, rng, SIZE, failure=FAILED.get(i))  # type: ignore[arg-type]
            if attempt.outcome.failure == "lost-bag":
                attempt = dataclasses.replace(attempt, after=None, box_after=np.full((4, 2), np.nan))
            writer.append(attempt)
    return root


def test_inspect_counts_what_was_recorded(recording: Path) -> None:
    summary = json.loads(json.dumps(inspect_dataset(recording)))
    assert summary["attempts"] == 8
    assert summary["succeeded"] == 5
    assert summary["failed"] == {"missed-grasp": 2, "lost-bag": 1}
    assert summary["picture_size"] == list(SIZE)
    assert summary["collection"] == {"seed": 3}
    # The first picture is taken at 0, the last 11.125 s after the eighth attempt began; they begin 20 s apart.
    assert summary["duration_s"] == pytest.approx(7 * 20 + 11.125)
    coverage = summary["coverage"]
    assert WORKSPACE.x_min - 0.01 < coverage["x_m"][0] < coverage["x_m"][1] < WORKSPACE.x_max + 0.01
    assert 8 <= coverage["visited"] <= min(16, coverage["squares"])
    on_disk = sum(path.stat().st_size for path in recording.rglob("*") if path.is_file())
    assert summary["megabytes"] == pytest.approx(on_disk / 1e6, abs=0.06)


@pytest.mark.parametrize(
    ("stamps", "duration_s"),
    [
        pytest.param([(1.8e9, 1.8e9 + 8), (1.8e9 + 8, 1.8e9 + 20)], 20, id="a wall clock"),
        pytest.param([(1.5, 9), (9, 17), (1.5, 8), (8, 18.5)], 15.5 + 17, id="a simulated clock, two scenes"),
        pytest.param([(1.5, None), (9, 17), (1.5, None)], 15.5, id="no picture after"),
    ],
)
def test_duration_is_from_the_first_picture_to_the_last(
    tmp_path: Path, stamps: list[tuple[float, float | None]], duration_s: float
) -> None:
    with DatasetWriter(tmp_path, task=TASK, robot_type="drawn", picture_size=SIZE) as writer:
        for i, (before, after) in reversed(list(enumerate(stamps))):  # workers finish in any order
            attempt = make_attempt(i, np.random.default_rng(i), SIZE)
            assert attempt.after is not None
            seen_after = None if after is None else dataclasses.replace(attempt.after, time=after)
            seen_before = dataclasses.replace(attempt.before, time=before)
            writer.append(dataclasses.replace(attempt, before=seen_before, after=seen_after))
    assert inspect_dataset(tmp_path)["duration_s"] == pytest.approx(duration_s)


def test_inspect_of_an_empty_dataset(tmp_path: Path) -> None:
    DatasetWriter(tmp_path, task=TASK, robot_type="drawn").close()
    summary = inspect_dataset(tmp_path)
    assert (summary["attempts"], summary["succeeded"], summary["failed"]) == (0, 0, {})
    with pytest.raises(DataError, match="no attempts yet"):
        contact_sheet(tmp_path, tmp_path / "sheet.png")


def test_contact_sheet_frames_failures_red(recording: Path, tmp_path: Path) -> None:
    path = contact_sheet(recording, tmp_path / "pictures/sheet.png", columns=3)
    sheet = load(path)
    height, width = sheet.shape[0] // 3, sheet.shape[1] // 3
    for i in range(8):
        tile = sheet[i // 3 * height : (i // 3 + 1) * height, i % 3 * width : (i % 3 + 1) * width]
        frame = (220, 30, 30) if i in FAILED else (255, 255, 255)
        assert tile[0, 0].tolist() == tile[-1, -1].tolist() == list(frame)
        # The pick is drawn blue in the left half and the place green in the right half, on the bag.
        attempt = open_dataset(recording)[i]
        for half, box, channel in ((0, attempt.box_before, 2), (1, attempt.box_after, 1)):
            picture = tile[3:-3, 3:-3][:, half * 160 : (half + 1) * 160].astype(int)
            others = np.delete(picture, channel, axis=2).max(axis=2)
            drawn = np.argwhere(picture[..., channel] - others > 60)
            if np.isnan(box).any():
                assert len(drawn) == 0
            else:
                low, high = box.min(axis=0), box.max(axis=0)
                assert len(drawn) > 10
                assert (drawn[:, ::-1].min(axis=0) >= low - 2).all()
                assert (drawn[:, ::-1].max(axis=0) <= high + 2).all()


def test_contact_sheet_shows_at_most_so_many(recording: Path, tmp_path: Path) -> None:
    one = load(contact_sheet(recording, tmp_path / "1.png", columns=1, limit=1))
    three = load(contact_sheet(recording, tmp_path / "3.png", columns=1, limit=3))
    assert three.shape[0] == 3 * one.shape[0]


def test_episodes_are_counted_with_what_they_scored(tmp_path: Path) -> None:
    assert "episodes" not in inspect_dataset_of(tmp_path / "none", [])
    rewards = [0.5, 0.5, 0.25, 0.0, *[1 / 6] * 6]  # three episodes, of two, two and six attempts
    summary = inspect_dataset_of(tmp_path / "three", rewards)
    assert summary["episodes"] == {"count": 3, "attempts": 10, "finished": 2, "mean_score": 0.75}
    assert inspect_dataset_of(tmp_path / "uncounted", [None] * 10)["episodes"] == {"count": 3, "attempts": 10}


def inspect_dataset_of(root: Path, rewards: Sequence[float | None]) -> dict[str, Any]:
    steps = [(0, 0), (0, 1), (4, 0), (4, 1), *((2, step) for step in range(6))]
    with DatasetWriter(root, task=TASK, robot_type="drawn", picture_size=SIZE) as writer:
        writer.append(make_attempt(99, np.random.default_rng(0), SIZE))
        for i, reward in enumerate(rewards):
            attempt = make_attempt(i, np.random.default_rng(i), SIZE)
            episode, step = steps[i]
            writer.append(dataclasses.replace(attempt, episode=episode, step=step, reward=reward))
    return inspect_dataset(root)


def test_contact_sheet_of_pictures_from_above(tmp_path: Path) -> None:
    grid = Grid()
    rows, columns = grid.shape
    with DatasetWriter(tmp_path, task=TASK, robot_type="drawn", picture_size=(columns, rows)) as writer:
        for step in range(2):
            attempt = make_attempt(step, np.random.default_rng(step), SIZE)
            seen = Observation(np.full((rows, columns, 3), 60 + 60 * step, np.uint8), grid=grid)
            nowhere = np.full((4, 2), np.nan)
            attempt = dataclasses.replace(
                attempt, before=seen, after=None, box_before=nowhere, box_after=nowhere, episode=0, step=step
            )
            writer.append(attempt)
    sheet = load(contact_sheet(tmp_path, tmp_path / "sheet.png", columns=1)).astype(int)
    first = sheet[: len(sheet) // 2][3:-3, 3:-3]
    before, after = first[:, :columns], first[:, columns:]
    assert after[-1, -1].tolist() == [120, 120, 120]  # the next one's picture before
    executed = open_dataset(tmp_path)[0].outcome.executed
    for picture, channel, pose in ((before, 2, executed.pick), (after, 1, executed.place)):
        others = np.delete(picture, channel, axis=2).max(axis=2)
        drawn = np.argwhere(picture[..., channel] - others > 60)[:, ::-1]
        assert np.allclose(drawn.mean(axis=0), grid.to_pixels(pose.xy)[0], atol=1)


def test_a_goal_says_what_an_attempt_counted_and_points_at_what_was_seen() -> None:
    attempt = make_attempt(0, np.random.default_rng(0), SIZE, depth=False)
    plain = goal_of(attempt)
    assert (plain.object_at, plain.layer, plain.object_layer) == (None, 0, 0)
    counted = goal_of(dataclasses.replace(attempt, pick_layer=2, place_layer=1))
    assert counted.object_at == pytest.approx(tuple(attempt.box_before.mean(axis=0)))
    assert (counted.layer, counted.object_layer) == (1, 2)
    unseen = dataclasses.replace(attempt, pick_layer=2, place_layer=1, box_before=np.full((4, 2), np.nan))
    assert goal_of(unseen).object_at is None
    assert (goal_of(unseen).layer, goal_of(unseen).object_layer) == (1, 2)
