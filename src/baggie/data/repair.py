"""What a dataset holds, made true again after its writer was killed."""

from __future__ import annotations

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from baggie.data import lerobot
from baggie.data.files import check_complete, json_bytes, parquet_bytes, read_json, remove, write_all
from baggie.data.index import read_numbers
from baggie.data.layout import Layout
from baggie.data.settings import DatasetSettings
from baggie.data.statistics import FeatureStats, RunningStats, pixel_stats
from baggie.errors import DataError


class Contents:
    """What a writer remembers of the attempts on disk: ids, and statistics of numbers and pixels."""

    def __init__(self, numbers: pa.Table) -> None:
        """Start from the numbers of the records on disk, in order of episodes."""
        self.attempt_ids: set[int] = set(numbers["attempt_id"].to_pylist())
        frames = [lerobot.frame_of(record) for record in numbers.drop_columns("histogram").to_pylist()]
        self._numbers = RunningStats(frames, lerobot.DTYPES)
        histograms = numbers["histogram"].combine_chunks().flatten().to_numpy(zero_copy_only=False)
        self._pixels = histograms.reshape(-1, 3, 256).sum(axis=0, dtype=np.int64)

    def add(self, attempt_id: int, frame: lerobot.Frame, histogram: NDArray[np.int32]) -> None:
        """Count one attempt more."""
        self.attempt_ids.add(attempt_id)
        self._numbers.add(frame)
        self._pixels += histogram

    def stats(self) -> dict[str, FeatureStats]:
        """The content of `stats.json`."""
        return {lerobot.IMAGE: pixel_stats(self._pixels, len(self.attempt_ids)), **self._numbers.stats()}


def repair(layout: Layout, settings: DatasetSettings) -> Contents:
    """Complete or remove what a killed writer left unfinished, and say what is there.

    The files of an attempt are renamed to their places in the order record, episode, data, statistics,
    `info.json`. So at most one attempt is unfinished: with its data file it is complete but for statistics
    and `info.json`, and those are written again; without, what there is of it is removed. Raises DataError
    when files that `info.json` counts are missing or cut off, or when another tool changed the dataset; then
    nothing is touched.
    """
    counted = read_json(layout.info)["total_episodes"] if layout.info.exists() else 0
    frames = layout.frames()
    episodes = max(counted, len(frames))
    expected = [layout.data(episode) for episode in range(episodes)]
    if episodes > counted + 1 or frames != expected[: len(frames)]:
        raise DataError(
            f"{layout.root}/data was changed by another tool: it no longer holds one file per attempt; "
            "record into another folder and merge the two with LeRobot"
        )
    check_complete(expected)
    check_complete(layout.episode(episode) for episode in range(episodes))
    numbers = read_numbers(layout)[:episodes]
    present = numbers["episode_index"].to_pylist()
    if present != list(range(episodes)):
        missing = min(set(range(episodes)) - set(present))
        raise DataError(
            f"{layout.root}/attempts lacks the record of episode {missing}: put it back from a copy, "
            "or record into another folder"
        )
    contents = Contents(numbers)
    wanted = {layout.attempt(attempt_id) for attempt_id in contents.attempt_ids}
    wanted |= {layout.episode(episode) for episode in range(episodes)}
    orphans = [path for path in (*layout.attempts(), *layout.episodes()) if path not in wanted]
    remove([*orphans, *layout.partial.glob("*")])
    if episodes != counted or orphans or not layout.info.exists():
        _describe(layout, settings, contents)
    return contents


def _describe(layout: Layout, settings: DatasetSettings, contents: Contents) -> None:
    """Write the files that describe the whole anew."""
    episodes = len(contents.attempt_ids)
    info = lerobot.info(episodes, settings.picture_size, settings.robot_type)
    files = [(layout.info, json_bytes(info, indent=4))]
    if episodes:
        files.insert(0, (layout.stats, json_bytes(contents.stats())))
        files.insert(0, (layout.tasks, parquet_bytes(lerobot.tasks_table(settings.task))))
    write_all(files, layout.partial)
