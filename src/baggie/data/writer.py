"""Recording attempts, one at a time, so that none is lost or doubled whatever happens."""

from __future__ import annotations

import errno
from collections.abc import Callable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import pyarrow as pa

from baggie.data import lerobot
from baggie.data.contents import Contents
from baggie.data.files import Lock, json_bytes, parquet_bytes, read_parquet, write_all
from baggie.data.index import write_index
from baggie.data.layout import Layout
from baggie.data.png import encode_color
from baggie.data.record import fit, to_record, to_table
from baggie.data.repair import repair
from baggie.data.settings import DatasetSettings
from baggie.data.statistics import histogram
from baggie.errors import DataError
from baggie.types import Attempt

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
