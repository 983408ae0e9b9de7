"""What a dataset holds, made true again after its writer was killed."""

from __future__ import annotations

import pyarrow as pa
import pyarrow.compute as pc

from baggie.data import lerobot
from baggie.data.contents import Contents
from baggie.data.files import (
    check_complete,
    json_bytes,
    parquet_bytes,
    read_json,
    read_parquet,
    remove,
    write_all,
)
from baggie.data.index import first_gap, read_numbers
from baggie.data.layout import Layout
from baggie.data.settings import DatasetSettings
from baggie.errors import DataError


def repair(layout: Layout, settings: DatasetSettings) -> Contents:
    """Complete or remove what a killed writer left unfinished, and say what is there.

    The files of an attempt are renamed to their places in the order record, episode, data, statistics,
    `info.json`. So at most one attempt is unfinished: with its frame in the data file it is complete but for
    statistics and `info.json`, and those are written again; without, what there is of it is removed, and the
    description of the episode it was to go into is written anew. Raises DataError when files that `info.json`
    counts are missing or cut off, or when another tool changed the dataset; then nothing is touched.
    """
    info = read_json(layout.info) if layout.info.exists() else {"total_episodes": 0, "total_frames": 0}
    counted = info["total_episodes"]
    files = layout.frames()
    episodes = max(counted, len(files))
    expected = [layout.data(episode) for episode in range(episodes)]
    if episodes > counted + 1 or files != expected[: len(files)]:
        raise DataError(
            f"{layout.root}/data was changed by another tool: it no longer holds one file per episode; "
            "record into another folder and merge the two with LeRobot"
        )
    check_complete(expected)
    check_complete(layout.episode(episode) for episode in range(episodes))
    frames = read_parquet(expected[-1], ["frame_index"]).num_rows if expected else 0
    numbers = read_numbers(layout)
    inside = pc.or_(pc.less(numbers["episode_index"], episodes - 1), pc.less(numbers["step"], frames))
    numbers = numbers.filter(pc.and_(pc.less(numbers["episode_index"], episodes), inside))
    _check_whole(layout, numbers, episodes, frames, info["total_frames"])
    contents = Contents(numbers)
    wanted = {layout.attempt(attempt_id) for attempt_id in contents.attempt_ids}
    wanted |= {layout.episode(episode) for episode in range(episodes)}
    orphans = [path for path in (*layout.attempts(), *layout.episodes()) if path not in wanted]
    # Orphans go last: as long as one is there, a repair that was itself killed is made again.
    if len(numbers) != info["total_frames"] or orphans or not layout.info.exists():
        _describe(layout, settings, contents)
    remove([*orphans, *layout.partial.glob("[0-9]*-*")])
    return contents


def _check_whole(layout: Layout, numbers: pa.Table, episodes: int, in_last: int, counted: int) -> None:
    """Raise DataError where the record of a frame is missing.

    `in_last`: frames of the last episode; `counted`: how many `info.json` counts in all.
    """
    gap = first_gap(numbers, episodes)
    if gap is None and numbers["episode_index"].to_pylist().count(episodes - 1) != in_last:
        gap = episodes - 1
    if gap is not None:
        raise DataError(
            f"{layout.root}/attempts lacks a record of episode {gap}: put it back from a copy, "
            "or record into another folder"
        )
    if not counted <= len(numbers) <= counted + 1:
        raise DataError(
            f"{layout.root} counts {counted} frames, but its `attempts/` holds {len(numbers)} records: "
            "another tool changed it; put the recording back from a copy"
        )


def _describe(layout: Layout, settings: DatasetSettings, contents: Contents) -> None:
    """Write the files that describe the whole, and the last episode, anew."""
    episodes, frames = contents.last + 1, len(contents.attempt_ids)
    info = lerobot.info(episodes, frames, settings.picture_size, settings.robot_type)
    files = [(layout.info, json_bytes(info, indent=4))]
    if episodes:
        last = lerobot.episode_table(contents.frames, contents.histogram, settings.task)
        files = [
            (layout.tasks, parquet_bytes(lerobot.tasks_table(settings.task))),
            (layout.episode(contents.last), parquet_bytes(last)),
            (layout.stats, json_bytes(contents.stats())),
            *files,
        ]
    write_all(files, layout.partial)
