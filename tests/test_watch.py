"""A bumped camera or table stops everything before anything wrong is recorded."""

from __future__ import annotations

import functools
from pathlib import Path

import cv2
import numpy as np
import pytest

from baggie.calibration.files import REFERENCE_FILE
from baggie.collect import CollectOptions, collect
from baggie.data import open_dataset
from baggie.errors import BumpedError
from baggie.geometry import PlanarPose
from baggie.types import Image
from baggie.workcell.simulated import SimulatedWorkcell
from baggie.workcell.workcell import LANDINGS, Watch
from helpers.fake_workcell import FakeCamera, FakeCell
from helpers.streaming import Here


@pytest.fixture(scope="module")
def cell():
    opened = SimulatedWorkcell(5)
    yield opened
    opened.close()


def test_ordinary_pictures_raise_no_alarm_and_small_bumps_do(cell: SimulatedWorkcell) -> None:
    cell.watch = None
    watch = Watch(cell.look().color)
    for scene in range(6):  # another light, and the bag elsewhere
        cell.reset((9, scene))
        watch.check(cell.look().color)
    cell.watch = watch
    cell.look()
    cell.bump_camera([0.0, 0.0, 0.0], [0.0, np.radians(0.15), 0.0])
    with pytest.raises(BumpedError, match="pixels from where it was"):
        cell.look()
    cell.bump_camera([0.0, 0.0, 0.0], [0.0, -np.radians(0.15), 0.0])
    cell.look()
    cell.bump_table(0.003, 0.003, 0.0)
    with pytest.raises(BumpedError):
        cell.look()
    cell.bump_table(-0.003, -0.003, 0.0)
    cell.bump_camera([0.0, 0.0, 0.0], [0.3, 0.0, 0.0])  # another background altogether
    with pytest.raises(BumpedError):
        cell.look()


def test_landings_that_drift_all_the_same_way_raise_the_alarm() -> None:
    blank = np.full((360, 640, 3), 150, np.uint8)
    rng = np.random.default_rng(0)

    def land(watch: Watch, off: float) -> None:
        for _ in range(3 * LANDINGS):
            released = PlanarPose(*rng.uniform(0.3, 0.6, 2))
            scatter = rng.normal(0.0, 0.005, 2) + np.array([off, 0.0])
            watch.landed(released, PlanarPose(released.x + scatter[0], released.y + scatter[1]))

    land(Watch(blank), 0.003)
    with pytest.raises(BumpedError, match="all the same way"):
        land(Watch(blank), 0.03)
    patterned = cv2.resize(rng.integers(60, 200, (45, 80, 3), dtype=np.uint8), (640, 360))
    land(Watch(patterned), 0.02)  # the background says that nothing was bumped: the bag is dented
    with pytest.raises(BumpedError, match=r"seen 4\d mm from where they were let go"):
        land(Watch(patterned), 0.042)


def test_a_blank_table_gives_no_false_alarm() -> None:
    rng = np.random.default_rng(0)

    def picture() -> Image:
        drawn = np.full((360, 640, 3), 150.0) + rng.normal(0, 3, (360, 640, 3))
        u, v = rng.integers(50, 300, 2)
        drawn[v : v + 50, u : u + 50] = [190, 40, 40]
        return np.clip(drawn, 0, 255).astype(np.uint8)

    watch = Watch(picture())
    for _ in range(5):
        watch.check(picture())


class BumpedCamera(FakeCamera):
    """A table with a pattern, seen by a camera that moves a little after a number of pictures."""

    after = 30

    def look(self):
        seen = super().look()
        self.taken = getattr(self, "taken", 0) + 1
        pattern = cv2.resize(
            np.random.default_rng(1).normal(0, 12, (90, 160, 3)), self.size, interpolation=cv2.INTER_CUBIC
        )
        shift = 3 if self.taken > self.after else 0
        table = (np.abs(seen.color.astype(float) - seen.color[0, 0]) < 25).all(axis=2, keepdims=True)
        color = np.clip(seen.color + table * np.roll(pattern, shift, axis=1), 0, 255).astype(np.uint8)
        return type(seen)(color, None, seen.intrinsics, seen.time)


def open_bumped_cell(number: int, size: tuple[int, int]) -> FakeCell:
    cell = FakeCell(size=size)
    cell.camera = BumpedCamera(cell, size=size)
    return cell


def test_nothing_is_recorded_once_the_camera_was_bumped(tmp_path: Path) -> None:
    options = CollectOptions(out=tmp_path / "bags", attempts=60, workers=1)
    open_cell = functools.partial(open_bumped_cell, size=(640, 360))
    with pytest.raises(BumpedError, match="calibrate again"):
        collect(options, open_cell, executor=Here())
    assert (tmp_path / "bags" / "calibration" / REFERENCE_FILE).exists()
    recorded = len(open_dataset(tmp_path / "bags"))
    # One picture, and one more an attempt: whatever was begun before the bump and not finished is not there.
    assert 0 < recorded < BumpedCamera.after
    with pytest.raises(BumpedError):  # the reference is the one from before
        collect(options, functools.partial(open_bumped_cell, size=(640, 360)), executor=Here())
