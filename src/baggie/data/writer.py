"""Recording attempts one at a time, so that none is lost or doubled whatever happens, and repair after a kill."""

from __future__ import annotations

import errno
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from baggie.data import lerobot
from baggie.data.dataset import first_gap, read_numbers, write_index
from baggie.data.files import (
    DatasetSettings,
    Layout,
    Lock,
    check_complete,
    json_bytes,
    parquet_bytes,
    read_complete_json,
    read_parquet,
    remove,
    write_all,
)
from baggie.data.lerobot import FeatureStats, RunningStats, histogram, pixel_stats
from baggie.data.record import Record, encode_color, fit, to_record, to_table
from baggie.errors import DataError
from baggie.types import Attempt

DONE = 1 - 1e-6
"""What an episode earns when its task is done, but for rounding: six times a sixth is less than 1."""


class Contents:
    """Ids, episodes, and statistics of numbers and pixels; of the last episode, which may grow, all frames."""

    def __init__(self, numbers: pa.Table) -> None:
        """Start from the numbers of the records on disk, in LeRobot's order."""
        self.attempt_ids: set[int] = set()
        self.episodes: dict[int, int] = {}
        """How many attempts of each episode there are, in the order in which they were begun."""
        self.frames: Sequence[lerobot.Frame] = []
        """Of the last of LeRobot's episodes."""
        self.last: int = -1
        """LeRobot's number of that episode."""
        self.histogram = np.zeros((3, 256), np.int64)
        """Of that episode's pictures: how many pixels have each value."""
        self._growing: int | None = None
        self._earned = 0.0
        pictures = numbers["histogram"].combine_chunks().flatten().to_numpy(zero_copy_only=False)
        histograms = pictures.reshape(-1, 3, 256)
        frames = [
            self._count(record, histogram)
            for record, histogram in zip(
                numbers.drop_columns("histogram").to_pylist(), histograms, strict=True
            )
        ]
        self._numbers = RunningStats(frames, lerobot.DTYPES)
        self._pixels = histograms.sum(axis=0, dtype=np.int64)

    def add(self, record: Record, histogram: NDArray[np.int32]) -> lerobot.Frame:
        """Count one attempt more, of whose picture this is the histogram `(3, 256)`; its frame."""
        frame = self._count(record, histogram)
        self._numbers.add(frame)
        self._pixels += histogram
        return frame

    def _count(self, record: Record, histogram: NDArray[np.int32]) -> lerobot.Frame:
        """Add to everything but the statistics of the whole."""
        episode, step, reward = record["episode"], record["step"], record["reward"]
        if step == 0:
            self.last, self.frames, self._earned = record["episode_index"], [], 0.0
            self.histogram = np.zeros((3, 256), np.int64)
        self._earned += reward or 0.0
        # Of those that were given up, no frame is done: whether another attempt follows is not known in time.
        done = episode is None or self._earned >= DONE
        frame = lerobot.frame_of(record, len(self.attempt_ids), done)
        self.frames = [*self.frames, frame]
        self.histogram = self.histogram + histogram
        self.attempt_ids.add(record["attempt_id"])
        self._growing = episode
        if episode is not None:
            self.episodes[episode] = step + 1
        return frame

    def episode_for(self, attempt: Attempt) -> int:
        """LeRobot's number of the episode that an attempt goes into: the last one, or a new one.

        Raises DataError when it is out of order.
        """
        episode, step = attempt.episode, attempt.step
        if episode is None:
            if step != 0:
                raise DataError(
                    f"attempt {attempt.attempt_id}: expected step 0 of an attempt that stands alone, got {step}; "
                    "say which episode it belongs to"
                )
            return self.last + 1
        if episode < 0:
            raise DataError(
                f"attempt {attempt.attempt_id}: expected an episode of 0 or more, got {episode}; count from 0"
            )
        expected = self.episodes.get(episode, 0)
        if step != expected:
            raise DataError(
                f"attempt {attempt.attempt_id}: expected step {expected} of episode {episode}, got {step}; "
                "record the attempts of an episode one after the other, from step 0 on"
            )
        if step > 0 and episode != self._growing:
            raise DataError(
                f"attempt {attempt.attempt_id}: expected episode {episode} to be the last one recorded, got another "
                "one's attempts between its own; record the attempts of an episode one after the other"
            )
        return self.last if step else self.last + 1

    def stats(self) -> dict[str, FeatureStats]:
        """The content of `stats.json`."""
        return {lerobot.IMAGE: pixel_stats(self._pixels, len(self.attempt_ids)), **self._numbers.stats()}


def repair(layout: Layout, settings: DatasetSettings) -> Contents:
    """Complete or remove what a killed writer left unfinished, and say what is there.

    The files of an attempt are renamed to their places in the order record, episode, data, statistics,
    `info.json`. So at most one attempt is unfinished: with its frame in the data file it is complete but for
    statistics and `info.json`, and those are written again; without, what there is of it is removed, and the
    description of the episode it was to go into is written anew. Raises DataError when files that `info.json`
    counts are missing or cut off, or when another tool changed the dataset; then nothing is touched.
    """
    info = (
        read_complete_json(layout.info) if layout.info.exists() else {"total_episodes": 0, "total_frames": 0}
    )
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


_INDEX_EVERY = 1000
"""Attempts between two gatherings of their numbers; the last is made on closing."""


class DatasetWriter:
    """Appends attempts to the dataset in a folder; the only writer there as long as it is open.

    Begins the dataset where there is none, continues it where it was recorded with the same settings. Opening
    repairs what a killed writer left. When `append` returns, the attempt is on the disk; while it runs, a
    kill, a power cut or a full disk leaves either all of the attempt or nothing, once the dataset is next
    opened for writing.

    Attempts may come in any order, those of an episode one after the other, in order of their steps. A context
    manager: leaving it unlocks.
    """

    def __init__(
        self,
        root: Path | str,
        *,
        task: str,
        robot_type: str,
        picture_size: tuple[int, int] | Callable[[], tuple[int, int]] = (640, 360),
        collection: Mapping[str, Any] | None = None,
    ) -> None:
        """Open for writing.

        `task` is the instruction in words. `picture_size` is the `(width, height)` pictures are recorded at, or what
        tells it where a dataset is begun; one that is continued keeps its own. `collection` is anything JSON can hold
        that says how the attempts come about (seed, cell, object colour, ...). Raises DataError when another process
        is writing there, when the dataset there was recorded with
        other settings, or when it is damaged beyond repair.
        """
        self._layout = Layout(Path(root))
        try:
            self._lock = Lock(self._layout.lock)
        except OSError as error:
            raise DataError(f"{root} cannot be written to: {error.strerror}") from None
        self._contents: Contents | None = None
        try:
            self.settings = self._begin(task, robot_type, picture_size, collection or {})
            self._known()
        except BaseException:
            self._lock.release()
            raise

    def _begin(
        self,
        task: str,
        robot_type: str,
        picture_size: tuple[int, int] | Callable[[], tuple[int, int]],
        collection: Mapping[str, Any],
    ) -> DatasetSettings:
        """Check that this dataset is ours to continue, or make an empty one; its settings."""
        layout = self._layout
        if layout.collection.exists() or layout.info.exists():
            found = DatasetSettings.read(layout)
            size = found.picture_size if callable(picture_size) else picture_size
            asked = DatasetSettings.make(task, robot_type, size, collection)
            found.check_same(asked, layout.root)
            return asked
        size = picture_size() if callable(picture_size) else picture_size
        settings = DatasetSettings.make(task, robot_type, size, collection)
        try:
            write_all([(layout.collection, json_bytes(settings.to_json(), indent=2))], layout.partial)
        except OSError as error:
            raise self._not_writable(error) from None
        return settings

    def _known(self) -> Contents:
        """What is on the disk; found out, and repaired, at first and after an append that failed half-way."""
        if self._contents is None:
            try:
                self._contents = repair(self._layout, self.settings)
            except OSError as error:
                raise self._not_writable(error) from None
        return self._contents

    @property
    def attempt_ids(self) -> set[int]:
        """The ids of the attempts recorded so far."""
        return set(self._known().attempt_ids)

    @property
    def episodes(self) -> dict[int, int]:
        """How many attempts of each episode are recorded so far, in the order the episodes were begun.

        The last of them may go on where no attempt of another was recorded since.
        """
        return dict(self._known().episodes)

    def append(self, attempt: Attempt) -> None:
        """Record an attempt; on return it is safe on the disk.

        Pictures, intrinsics and box corners (given in the pixels of the pictures they come with) are stored
        at the recorded size. Raises DataError when an attempt of this id is there already, when it is of
        another task or out of order in its episode, when a number does not fit, or when the disk is full, and
        BaggieError for an orthographic picture of another size; nothing recorded before is harmed by any of these.
        """
        if self._lock.released:
            raise DataError(f"{self._layout.root} is closed: open it again to record into it")
        contents = self._known()
        self._check(attempt, contents.attempt_ids)
        size = self.settings.picture_size
        attempt = fit(attempt, size)
        layout, episode = self._layout, contents.episode_for(attempt)
        counts = histogram(attempt.before.color)
        record = to_record(attempt, episode, counts)
        to_table(record)  # refuses what does not fit before anything is changed
        self._contents = None  # until all is written: a failure half-way leaves memory and disk apart
        frame = contents.add(record, counts)
        png = encode_color(attempt.before.color)
        data = parquet_bytes(self._with_earlier(lerobot.frame_table(frame, png), episode, attempt.step))
        record |= {"before_offset": data.rindex(png), "before_length": len(png)}
        described = lerobot.episode_table(contents.frames, contents.histogram, attempt.task)
        frames = len(contents.attempt_ids)
        info = lerobot.info(episode + 1, frames, size, self.settings.robot_type)
        files = [
            (layout.attempt(attempt.attempt_id), parquet_bytes(to_table(record))),
            (layout.episode(episode), parquet_bytes(described)),
            (layout.data(episode), data),
            (layout.stats, json_bytes(contents.stats())),
            (layout.info, json_bytes(info, indent=4)),
        ]
        if frames == 1:
            files.insert(0, (layout.tasks, parquet_bytes(lerobot.tasks_table(attempt.task))))
        try:
            write_all(files, layout.partial)
        except OSError as error:
            raise self._not_writable(error) from None
        self._contents = contents
        if frames % _INDEX_EVERY == 0:
            write_index(layout)

    def _with_earlier(self, frame: pa.Table, episode: int, step: int) -> pa.Table:
        """The frames of an episode up to this one, the `step`-th."""
        if step == 0:
            return frame
        return pa.concat_tables([read_parquet(self._layout.data(episode)), frame])

    def _check(self, attempt: Attempt, recorded: set[int]) -> None:
        if attempt.attempt_id in recorded:
            raise DataError(
                f"attempt {attempt.attempt_id} is in {self._layout.root} already: "
                "give every attempt an id of its own"
            )
        if attempt.attempt_id < 0:
            raise DataError(f"an attempt's id must be 0 or more, got {attempt.attempt_id}")
        if attempt.task != self.settings.task:
            raise DataError(
                f"attempt {attempt.attempt_id} is of task {attempt.task!r}, but {self._layout.root} records "
                f"{self.settings.task!r}: record it into another folder"
            )

    def _not_writable(self, error: OSError) -> DataError:
        root = self._layout.root
        if error.errno in {errno.ENOSPC, errno.EDQUOT}:
            return DataError(
                f"no space left on the disk for {root}: free some and go on with the same command; "
                "the attempts recorded so far are safe"
            )
        return DataError(
            f"{root} cannot be written to: {error.strerror}; the attempts recorded so far are safe"
        )

    def close(self) -> None:
        """Let others write; harmless when done already."""
        if not self._lock.released:
            try:
                write_index(self._layout)
            finally:
                self._lock.release()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
