"""Ravens' demonstrations in our own layout: the right pictures with the right actions, and stopping loses nothing."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from baggie.cli.main import main
from baggie.data import DatasetWriter, open_dataset
from baggie.errors import BaggieError, DataError
from baggie.geometry import Grid, wrap_angle
from baggie.options.collecting import ImportOptions
from baggie.ravens.adapters import import_ravens, planar
from baggie.ravens.episode import fused
from baggie.ravens.format import RavensFolder, RavensPose, write_episode
from baggie.types import Attempt
from helpers import ravens_scene
from helpers.same import expect_same

SMALL = {"x": (0.35, 0.65), "y": (-0.25, 0.4), "pixel_m": 0.005}
STEPS = len(ravens_scene.STARTS)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two episodes; not to be changed."""
    root = tmp_path_factory.mktemp("ravens") / "stack-two-blocks-train"
    for number, seed in ((1, 9002), (4, 9008)):
        write_episode(root, ravens_scene.episode(number, seed))
    return root


@pytest.fixture(scope="module")
def recording(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("recording") / "out"
    import_ravens(ImportOptions(folder, out))
    return out


def test_every_action_is_an_attempt(folder: Path, recording: Path) -> None:
    dataset = open_dataset(recording)
    assert dataset.settings.task == "stack two blocks"
    assert dataset.grid == Grid()
    assert dataset.attempt_ids.tolist() == list(range(2 * STEPS))
    for attempt, episode in zip(dataset, np.repeat(list(RavensFolder(folder)), STEPS), strict=True):
        assert (attempt.episode, attempt.seed) == (episode.number, episode.seed)
        action = episode.actions[attempt.step]
        assert attempt.commanded == attempt.outcome.executed == planar(action)
        assert attempt.outcome.pick_z_m == action.pose0.xyz[2]
        assert attempt.outcome.place_z_m == action.pose1.xyz[2]
        assert attempt.reward == 0.5
        moment = fused(episode.color[attempt.step], episode.depth[attempt.step], Grid())
        np.testing.assert_array_equal(attempt.before.color, moment.color)
        assert moment.height is not None
        np.testing.assert_allclose(attempt.before.height, moment.height, rtol=0, atol=1e-8)  # nothing rounded
        assert (attempt.after is not None) == (attempt.step == STEPS - 1)
    assert dataset.numbers()["step"].tolist() == [0, 1, 0, 1]


def test_blocks_are_where_the_actions_say(recording: Path) -> None:
    dataset = open_dataset(recording)
    grid, heights = Grid(), dataset.heights()
    for row, attempt in enumerate(dataset):
        after = dataset.after(row)
        assert after is not None
        assert after.height is not None
        color = list(ravens_scene.COLORS.values())[attempt.step]
        action = attempt.outcome.executed
        u, v = np.round(grid.to_pixels(action.pick.xy)[0]).astype(int)
        assert heights[row][v, u] == pytest.approx(attempt.outcome.pick_z_m, abs=5e-4)
        assert attempt.before.color[v, u].tolist() == list(color)
        assert after.height[v, u] == pytest.approx(0, abs=5e-4)
        u, v = np.round(grid.to_pixels(action.place.xy)[0]).astype(int)
        assert heights[row][v, u] == pytest.approx(attempt.outcome.place_z_m, abs=5e-4)
        assert after.height[v, u] - heights[row][v, u] == pytest.approx(ravens_scene.SIDE_M, abs=5e-4)
        assert after.color[v, u].tolist() == list(color)


def test_an_object_turns_by_the_difference_of_the_yaws() -> None:
    for step, (name, start) in enumerate(ravens_scene.STARTS.items()):
        action = planar(ravens_scene.action(step))
        carried = action.place @ action.pick.inverse()
        x, y = (carried.matrix() @ [*start, 1])[:2]
        np.testing.assert_allclose((x, y), ravens_scene.STAND, atol=1e-12)
        assert wrap_angle(carried.yaw - ravens_scene.TURNS[name]) == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize("stopped_before", [1, 2, 3])
def test_stopped_it_goes_on(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, stopped_before: int
) -> None:
    append, count = DatasetWriter.append, 0

    def stopping(self: DatasetWriter, attempt: Attempt) -> None:
        nonlocal count
        if count == stopped_before:
            raise KeyboardInterrupt
        count += 1
        append(self, attempt)

    options = ImportOptions(folder, tmp_path / "out", **SMALL)  # type: ignore[arg-type]
    monkeypatch.setattr(DatasetWriter, "append", stopping)
    with pytest.raises(KeyboardInterrupt) as caught:
        import_ravens(options)
    monkeypatch.undo()
    command = str(caught.value).split("go on with: ")[1].split()
    assert command[:2] == ["baggie", "import-ravens"]
    assert main(command[1:]) == 0
    import_ravens(options)  # again changes nothing
    import_ravens(dataclasses.replace(options, out=tmp_path / "at-once"))
    one, other = open_dataset(tmp_path / "out"), open_dataset(tmp_path / "at-once")
    assert len(one) == 2 * STEPS
    for a, b in zip(one, other, strict=True):
        expect_same(a, b)
    frames = [pq.read_table(path).to_pylist() for path in sorted((tmp_path / "out").glob("data/*/*.parquet"))]
    assert [len(episode) for episode in frames] == [STEPS, STEPS]


def test_the_verb(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    words = ["import-ravens", str(folder), "--out", "out", "--task", "stack them", "--json"]
    words += ["--x", "0.35", "0.65", "--y", "-0.25", "0.4", "--pixel-m", "0.005"]
    assert main(words) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["task"] == "stack them"
    assert summary["picture_size"] == [60, 130]
    assert summary["episodes"] == {"count": 2, "attempts": 4, "finished": 2, "mean_score": 1.0}
    assert main([*words[:-1], "0.01"]) == 1
    assert "was recorded with grid" in capsys.readouterr().err
    assert main(["import-ravens", "nowhere", "--out", "other"]) == 1
    assert "expected the folder of a Ravens task" in capsys.readouterr().err
    assert not (tmp_path / "other").exists()


def test_pictures_are_over_ravens_own_table_unless_told_otherwise(recording: Path) -> None:
    assert open_dataset(recording).grid == Grid()


def test_what_cannot_be_imported_is_one_line(folder: Path, tmp_path: Path) -> None:
    with pytest.raises(BaggieError, match=r"a whole number of 0\.3 m pixels"):
        import_ravens(ImportOptions(folder, tmp_path / "out", pixel_m=0.3))
    assert not (tmp_path / "out").exists()
    episode = ravens_scene.episode()
    tilt = RavensPose((0.5, 0.0, 0.04), (math.sin(0.3), 0.0, 0.0, math.cos(0.3)))
    second = episode.actions[1]._replace(pose1=tilt)
    tilted = dataclasses.replace(episode, actions=(episode.actions[0], second))
    write_episode(tmp_path / "tilted", tilted)
    with pytest.raises(DataError, match=r"is tilted by 34\.4 degrees"):
        import_ravens(ImportOptions(tmp_path / "tilted", tmp_path / "out"))
    write_episode(tmp_path / "tilted", dataclasses.replace(episode, seed=9001))
    with pytest.raises(DataError, match="number of its own, got 2 of 0"):
        import_ravens(ImportOptions(tmp_path / "tilted", tmp_path / "another"))
