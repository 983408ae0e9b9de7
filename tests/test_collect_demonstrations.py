"""Demonstrations of tasks with several steps: recorded once each, whatever interrupts them."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from baggie.collect import CollectOptions, collect
from baggie.collect.scripted import missing_demonstrations
from baggie.data import DatasetWriter, open_dataset
from baggie.errors import BaggieError
from baggie.evaluation.choices_of_scene import choices_of_scene
from baggie.geometry import Grid
from baggie.registry import TASKS
from baggie.types import PickPlace
from helpers.streaming import Here

GRID = Grid()
COUNT = 2
TASK = "place-red-in-green"


def options(out: Path, **given: object) -> CollectOptions:
    return CollectOptions(out, task=TASK, attempts=COUNT, seed=4, **given)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("demonstrations") / "data"
    summary = collect(options(out, workers=1))
    episodes = summary["episodes"]
    assert (episodes["count"], episodes["finished"], episodes["mean_score"]) == (COUNT, COUNT, 1.0)
    return out


def test_an_episode_is_shown_step_by_step_and_its_rewards_add_up(recorded: Path) -> None:
    dataset = open_dataset(recorded)
    assert dataset.grid == GRID
    assert dataset.collection["object_symmetry"] == 4
    assert set(dataset.numbers()["object_symmetry"]) == {4}
    numbers = dataset.numbers()
    assert set(dataset.episodes) == set(range(COUNT))
    for episode in range(COUNT):
        steps = [dataset[int(i)] for i in np.flatnonzero(dataset.episodes == episode)]
        assert [attempt.step for attempt in steps] == list(range(len(steps)))
        assert sum(attempt.reward or 0.0 for attempt in steps) == pytest.approx(1.0)
        assert [attempt.after is None for attempt in steps] == [True] * (len(steps) - 1) + [False]
        for attempt in steps:
            assert attempt.before.height is not None
            u, v = np.round(GRID.to_pixels([attempt.commanded.pick.xy])[0]).astype(int)
            assert attempt.before.height[v, u] == pytest.approx(0.04, abs=0.004)  # a block's top
    assert numbers["success"].all()


def test_a_recording_cut_short_goes_on_to_the_same_arrays(recorded: Path, tmp_path: Path) -> None:
    whole = open_dataset(recorded)
    out = tmp_path / "again"
    # Some of the second demonstration is there, as a kill leaves it.
    begun = whole[int(np.flatnonzero((whole.episodes == 1) & (whole.numbers()["step"] == 0))[0])]
    settings = whole.settings
    with DatasetWriter(
        out,
        task=settings.task,
        robot_type=settings.robot_type,
        picture_size=settings.picture_size,
        collection=settings.collection,
    ) as writer:
        writer.append(begun)
    collect(options(out, workers=1), executor=Here())
    again = open_dataset(out)
    assert again.attempt_ids.tolist() == whole.attempt_ids.tolist()
    np.testing.assert_array_equal(again.colors(), whole.colors())
    np.testing.assert_array_equal(again.heights(), whole.heights())
    mine, theirs = again.numbers(), whole.numbers()
    for name in ("commanded", "executed", "reward", "episode", "step", "time"):
        np.testing.assert_array_equal(mine[name], theirs[name])
    before = {path: path.read_bytes() for path in out.rglob("*.parquet")}
    collect(options(out, workers=1), executor=Here())  # all is there
    assert {path: path.read_bytes() for path in out.rglob("*.parquet")} == before
    shutil.rmtree(out)


def test_the_style_of_others_is_recorded_and_shown_again_alike(tmp_path: Path) -> None:
    chosen = CollectOptions(
        tmp_path / "a", task="align-box-corner", attempts=2, seed=1, style="varied", workers=1
    )
    assert "--style varied" in chosen.command()
    collect(chosen, executor=Here())
    collect(replace(chosen, out=tmp_path / "b"), executor=Here())
    first, again = open_dataset(tmp_path / "a"), open_dataset(tmp_path / "b")
    assert first.collection["style"] == "varied"
    np.testing.assert_array_equal(first.numbers()["commanded"], again.numbers()["commanded"])
    right = choices_of_scene(first, TASKS[TASK])
    off = [
        right[int(attempt_id)].blocks[0][1].distance(PickPlace.from_array(commanded).pick)
        for attempt_id, commanded in zip(first.attempt_ids, first.numbers()["commanded"], strict=True)
    ]
    assert min(off) > 0.002  # not by its middle
    with pytest.raises(BaggieError, match="style = 'varied'"):
        collect(replace(chosen, style="plain"))


def test_our_own_style_is_what_recordings_without_one_are_in(recorded: Path) -> None:
    assert "style" not in open_dataset(recorded).collection
    assert "--style" not in options(recorded).command()
    with pytest.raises(BaggieError, match="style = None"):
        collect(options(recorded, style="varied"))


def test_only_what_is_demonstrated_has_a_style(tmp_path: Path) -> None:
    with pytest.raises(BaggieError, match="no --style with --task bag-place"):
        collect(CollectOptions(tmp_path / "x", style="varied"))
    with pytest.raises(BaggieError, match="a style among plain, varied"):
        collect(options(tmp_path / "x", style="odd"))


def test_what_may_have_been_cut_short_is_shown_again() -> None:
    assert missing_demonstrations(4, {}) == [0, 1, 2, 3]
    assert missing_demonstrations(4, {2: 6, 0: 6, 3: 1}) == [3, 1]
    assert missing_demonstrations(2, {0: 1, 5: 2}) == [1]


def test_blocks_have_a_cell_of_their_own(tmp_path: Path) -> None:
    with pytest.raises(BaggieError, match="neither --scenery nor --workcell"):
        collect(options(tmp_path / "x", scenery="varied"))
    with pytest.raises(BaggieError, match=r"a task among bag-place, .*block-pyramid"):
        collect(CollectOptions(tmp_path / "x", task="juggle"))
    assert not (tmp_path / "x").exists()
