"""Reading attempts back: numbers at once, pictures when they are asked for. Reading never writes.

The numbers lie in as many small files as there are attempts, each slow to open. `attempts/index.parquet` gathers
them. It is a cache: records never change, so a row of it is right as long as its record exists, and what it
lacks is read from the records themselves. Only writers write it.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from pathlib import Path
from typing import Any, overload

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import NDArray

from baggie.calibration.files import MAP_FILE, CameraIdentity
from baggie.data import lerobot
from baggie.data.files import (
    CALIBRATION_FOLDER,
    DatasetSettings,
    Layout,
    attempt_id_of,
    broken,
    check_complete,
    read_complete_json,
    read_parquet,
    write_all,
)
from baggie.data.record import (
    NUMBERS,
    SCHEMA,
    complete,
    decode_color,
    decode_height,
    is_whole,
    to_attempt,
    to_grid,
)
from baggie.errors import DataError
from baggie.geometry import Grid
from baggie.pictures import same_shape
from baggie.types import Attempt, Image, Observation


def read_numbers(layout: Layout, columns: Sequence[str] = NUMBERS) -> pa.Table:
    """Columns of all records, a row each, in LeRobot's order: by episode, then by step.

    Raises DataError naming a damaged record.
    """
    records = {attempt_id_of(path): path for path in layout.attempts()}
    check_complete(records.values())
    indexed = _read_index(layout, columns)
    indexed = indexed.filter(pc.is_in(indexed["attempt_id"], pa.array(records, pa.int64())))
    known = set(indexed["attempt_id"].to_pylist())
    fresh = [
        complete(read_parquet(path, columns), columns, path)
        for attempt_id, path in records.items()
        if attempt_id not in known
    ]
    return pa.concat_tables([indexed, *fresh]).sort_by(
        [("episode_index", "ascending"), ("step", "ascending")]
    )


def first_gap(numbers: pa.Table, episodes: int) -> int | None:
    """The first episode of which these rows, in LeRobot's order, lack one; None where `episodes` are whole.

    An episode's last rows are not missed: what counts them is `info.json`.
    """
    episode, step = -1, -1
    for row in zip(numbers["episode_index"].to_pylist(), numbers["step"].to_pylist(), strict=True):
        if row not in ((episode, step + 1), (episode + 1, 0)):
            return min(int(row[0]), episode + 1)
        episode, step = row
    return None if episode == episodes - 1 else episode + 1


def write_index(layout: Layout) -> None:
    """Gather the numbers of all records; nothing is lost where that fails, so it does so silently."""
    sink = pa.BufferOutputStream()
    pq.write_table(read_numbers(layout), sink, compression="zstd")
    with contextlib.suppress(OSError):
        write_all([(layout.index, sink.getvalue())], layout.partial)


def _read_index(layout: Layout, columns: Sequence[str]) -> pa.Table:
    schema = pa.schema([SCHEMA.field(name) for name in columns])
    if layout.index.exists():
        with contextlib.suppress(DataError, pa.ArrowException, ValueError):
            return complete(read_parquet(layout.index, columns), columns, layout.index).cast(schema)
    return schema.empty_table()


_LISTED = tuple(
    name for name in NUMBERS if name not in {"histogram", "before_intrinsics", "after_intrinsics"}
)
_NOT_NUMBERS = {
    "task",
    "failure",
    "timings_s",
    "before_offset",
    "before_length",
    "before_grid",
    "after_grid",
    "episode",
    "object_symmetry",
    "commanded_heights",
    "executed_heights",
    "pick_layer",
    "place_layer",
    "under",
}


def open_dataset(root: Path | str) -> Dataset:
    """The attempts recorded in a folder, sorted by attempt id.

    A snapshot: attempts recorded later are not in it. Raises DataError when there is no dataset in the
    folder, or when one of its files is missing or cut off.
    """
    layout = Layout(Path(root))
    settings = DatasetSettings.read(layout)
    # `info.json` is written last: what it counts is complete, even while someone is recording.
    info = (
        read_complete_json(layout.info) if layout.info.exists() else {"total_episodes": 0, "total_frames": 0}
    )
    episodes, frames = info["total_episodes"], info["total_frames"]
    check_complete(layout.data(episode) for episode in range(episodes))
    numbers = read_numbers(layout, _LISTED)[:frames]
    if len(numbers) < frames or first_gap(numbers, episodes) is not None:
        raise DataError(
            f"{layout.root} counts {frames} attempts, but its `attempts/` does not hold a record of each: "
            "another tool changed it; put the recording back from a copy"
        )
    return Dataset(layout, settings, numbers.sort_by("attempt_id"))


class Dataset(Sequence[Attempt]):
    """Attempts on disk, sorted by attempt id; `dataset[i]` reads and decodes one, `dataset[a:b]` is a view.

    Made by `open_dataset`.
    """

    def __init__(self, layout: Layout, settings: DatasetSettings, numbers: pa.Table) -> None:
        self._layout = layout
        self._numbers = numbers
        self.settings = settings
        """Task, robot, picture size and the collector's settings."""

    @property
    def root(self) -> Path:
        """The folder."""
        return self._layout.root

    @property
    def collection(self) -> Mapping[str, Any]:
        """The collector's settings, as given to `DatasetWriter`."""
        return self.settings.collection

    @cached_property
    def camera(self) -> CameraIdentity | None:
        """The camera that took the pictures, before they were resized for recording.

        As the map says that the collector made; None where there is none. Raises DataError for a damaged map.
        """
        path = self.root / CALIBRATION_FOLDER / MAP_FILE
        if not path.exists():
            return None
        from baggie.calibration.image_to_robot.map import ImageToRobot  # noqa: PLC0415 -- most are read without

        return ImageToRobot.load(path).camera

    @property
    def camera_size(self) -> tuple[int, int]:
        """`(width, height)` of that camera's pictures; the recorded size where it is not known.

        Raises DataError as `camera` does.
        """
        return self.camera.size if self.camera else self.settings.picture_size

    @property
    def squeezed(self) -> bool:
        """Whether pictures were resized to another shape than the camera's, as older versions did.

        Raises DataError as `camera` does.
        """
        return not same_shape(self.camera_size, self.settings.picture_size)

    @cached_property
    def attempt_ids(self) -> NDArray[np.int64]:
        """`(N,)`, ascending."""
        return _numeric(self._numbers["attempt_id"])

    @cached_property
    def episodes(self) -> NDArray[np.int64]:
        """`(N,)`: the episode each attempt belongs to, -1 where it stands alone."""
        return _numeric(self._numbers["episode"].combine_chunks().fill_null(-1))

    @cached_property
    def grid(self) -> Grid | None:
        """The grid of the pictures before, where they are orthographic; None where a camera took them.

        Raises DataError when they are not all of one grid.
        """
        grids = {to_grid(values) for values in self._numbers["before_grid"].to_pylist()}
        if len(grids) > 1:
            raise DataError(
                f"expected the pictures in {self.root} to have one grid, got {len(grids)} different ones; "
                "take attempts apart that were recorded over different ones"
            )
        return grids.pop() if grids else None

    @cached_property
    def failures(self) -> list[str | None]:
        """Why each attempt failed; None where it succeeded."""
        return list(self._numbers["failure"].to_pylist())

    def __len__(self) -> int:
        return len(self.attempt_ids)

    @overload
    def __getitem__(self, index: int) -> Attempt: ...
    @overload
    def __getitem__(self, index: slice) -> Dataset: ...
    def __getitem__(self, index: int | slice) -> Attempt | Dataset:
        if isinstance(index, slice):
            return self._view(range(len(self))[index])
        row = range(len(self))[index]
        path = self._layout.attempt(int(self.attempt_ids[row]))
        record = complete(read_parquet(path), SCHEMA.names, path).to_pylist()[0]
        if (
            record["object_symmetry"] is None
        ):  # an older recording says it, if at all, of all attempts together
            record["object_symmetry"] = self.collection.get("object_symmetry")
        return to_attempt(record, self._before_png(row), path)

    def after(self, index: int) -> Observation | None:
        """What was seen after an attempt: its own picture, or the one before the next attempt of its episode.

        None where neither is in this dataset.
        """
        row = range(len(self))[index]
        own = self[row].after
        if own is not None or self.episodes[row] < 0:
            return own
        step = int(self._steps[row]) + 1
        following = np.flatnonzero((self.episodes == self.episodes[row]) & (self._steps == step))
        return self[int(following[0])].before if len(following) else None

    def successful(self) -> Dataset:
        """The attempts that succeeded, as a view."""
        return self._view(row for row, failure in enumerate(self.failures) if failure is None)

    def _view(self, rows: Iterable[int]) -> Dataset:
        return Dataset(self._layout, self.settings, self._numbers.take(pa.array(rows, pa.int64())))

    def colors(
        self, indices: Iterable[int] | None = None, size: tuple[int, int] | None = None, threads: int = 2
    ) -> Image:
        """The pictures before the attempts at `indices` (default: all): `(N, H, W, 3)` uint8 RGB.

        `size` is `(width, height)`; as recorded by default. Raises DataError when a picture is damaged.
        """
        rows = list(range(len(self)) if indices is None else indices)
        width, height = size or self.settings.picture_size
        pictures = np.empty((len(rows), height, width, 3), np.uint8)

        def decode(place: int) -> None:
            row = range(len(self))[rows[place]]
            source = self._layout.data(self._episodes[row])
            decode_color(self._before_png(row), source, out=pictures[place])

        _in_threads(decode, len(rows), threads)
        return pictures

    def heights(self, indices: Iterable[int] | None = None, threads: int = 2) -> NDArray[np.float32]:
        """The heights that go with `colors(indices)`: `(N, H, W)` metres above the grid's lower bound of z.

        Raises DataError when an attempt has none, or its picture is damaged.
        """
        rows = list(range(len(self)) if indices is None else indices)
        width, height = self.settings.picture_size
        maps = np.empty((len(rows), height, width), np.float32)

        def decode(place: int) -> None:
            attempt_id = int(self.attempt_ids[rows[place]])
            path = self._layout.attempt(attempt_id)
            name = "before_height"
            png = complete(read_parquet(path, [name]), [name], path)[name][0].as_buffer()
            if png is None:
                raise DataError(
                    f"expected heights in every attempt, got none in attempt {attempt_id} of {self.root}; "
                    "take a recording of orthographic pictures"
                )
            maps[place] = decode_height(memoryview(png), path)

        _in_threads(decode, len(rows), threads)
        return maps

    def numbers(self) -> dict[str, NDArray[Any]]:
        """Read all numbers of all attempts by name, `(N, ...)`, without touching a picture.

        Poses (`commanded`, `executed`: `(N, 6)`; `truth_before`, `truth_after`: `(N, 3)`) are metres and
        radians in the robot base frame; `box_before`, `box_after` `(N, 4, 2)` pixels (u, v). NaN stands for
        what is not known. `success` is bool; `timings_s.<phase>` holds seconds by phase. `episode` is -1 where an
        attempt stands alone; `reward` NaN where nobody counts; `object_symmetry` is each attempt's own, NaN where
        it says none, as `pick_layer` and `place_layer` are.
        """
        table = self._numbers
        result = {name: _numeric(table[name]) for name in _LISTED if name not in _NOT_NUMBERS}
        for box in ("box_before", "box_after"):
            result[box] = result[box].reshape(-1, 4, 2)
        result["episode"] = self.episodes
        for name in ("object_symmetry", "pick_layer", "place_layer"):
            result[name] = _numeric(table[name].cast(pa.float64()))
        result["success"] = np.array([failure is None for failure in self.failures], bool)
        timings = [dict(pairs) for pairs in table["timings_s"].to_pylist()]
        for phase in sorted({phase for times in timings for phase in times}):
            result[f"timings_s.{phase}"] = np.array([times.get(phase, np.nan) for times in timings])
        return result

    @cached_property
    def _episodes(self) -> list[int]:
        """LeRobot's number of each attempt's episode."""
        return list(self._numbers["episode_index"].to_pylist())

    @cached_property
    def _steps(self) -> NDArray[np.int64]:
        return _numeric(self._numbers["step"])

    @cached_property
    def _places(self) -> list[tuple[int, int]]:
        """Offset and length of each picture before in its file, bytes."""
        columns = (self._numbers[name].to_pylist() for name in ("before_offset", "before_length"))
        return list(zip(*columns, strict=True))

    def _before_png(self, row: int) -> bytes | memoryview:
        """The encoded picture before an attempt.

        The record says where it lies in the file, which is ten times as fast as asking the file itself.
        """
        path = self._layout.data(self._episodes[row])
        offset, length = self._places[row]
        with contextlib.suppress(OSError), open(path, "rb", buffering=0) as file:
            png = os.pread(file.fileno(), length, offset)
            if is_whole(png):
                return png
        column = read_parquet(path, [f"{lerobot.IMAGE}.bytes"]).column(0)
        step = int(self._steps[row])
        if step >= len(column):
            raise broken(path, f"lacks frame {step}")
        return memoryview(column[step]["bytes"].as_buffer())


def _in_threads(work: Callable[[int], None], count: int, threads: int) -> None:
    """Do `work(0)` to `work(count - 1)`."""
    if threads == 1:
        for place in range(count):
            work(place)
    else:
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(work, range(count)))


def _numeric(column: pa.ChunkedArray | pa.Array) -> NDArray[Any]:
    """A column of numbers or of fixed-length lists of them, as `(N,)` or `(N, length)`; NaN for nulls."""
    array = column.combine_chunks() if isinstance(column, pa.ChunkedArray) else column
    if not pa.types.is_fixed_size_list(array.type):
        return np.asarray(array.to_numpy(zero_copy_only=False))
    values = np.full((len(array), array.type.list_size), np.nan)
    present = np.asarray(array.is_valid())
    values[present] = array.drop_null().flatten().to_numpy().reshape(-1, array.type.list_size)
    return values
