"""Attempts as LeRobot reads them: frames of episodes in its v3.0 layout, and their statistics; without lerobot.

An attempt is a frame, and an episode of one frame unless it belongs to an episode with others.

LeRobot makes every image-typed column and every `observation*` a policy's input and every `action*` its
output, so only what a policy may see and must produce goes by those names; all else here is `next.*` or
numeric `annotation.*`.

Statistics are exact at any time, at a cost per attempt that hardly grows. LeRobot's own writer averages the quantiles
of its episodes, which for one-frame episodes gives q01 = q99 = mean. Here every value seen is kept, sorted, column by
column (8 bytes a number), and pictures are kept as histograms: 256 counts a channel hold all there is to know about
8-bit pixels.
"""

from __future__ import annotations

import json
from array import array
from bisect import insort
from collections.abc import Callable, Mapping, Sequence
from typing import Any, get_args

import cv2
import numpy as np
import pyarrow as pa
from numpy.typing import ArrayLike, NDArray

from baggie.data.files import CHUNK_FILES, DATA_TEMPLATE, chunk_and_file
from baggie.data.record import Record
from baggie.geometry import FloatArray
from baggie.types import Failure, Image

QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}

_PLAIN: dict[str, Callable[[float], Any]] = {"f": float, "i": int, "b": bool}
"""How a minimum or maximum is written, by the kind of its feature's dtype."""

FeatureStats = dict[str, list[Any]]
"""`min`, `max`, `mean`, `std`, `count` and the quantiles of one feature, as LeRobot stores them."""


def histogram(color: Image) -> NDArray[np.int32]:
    """How many pixels have each value: RGB `(H, W, 3)` uint8 -> `(3, 256)`."""
    counts = [cv2.calcHist([color], [c], None, [256], [0, 256]) for c in range(3)]
    return np.stack([count.ravel() for count in counts]).astype(np.int32)


def pixel_stats(counts: ArrayLike, pictures: int) -> FeatureStats:
    """Statistics in [0, 1] of all pixels behind a histogram `(3, 256)`; every entry is `(3, 1, 1)`."""
    counts = np.asarray(counts, np.int64)
    values = np.arange(256)
    total = counts.sum(axis=1)
    mean = counts @ values / total
    std = np.sqrt(np.maximum(0, counts @ values**2 / total - mean**2))
    cumulative = counts.cumsum(axis=1)

    def ranked(q: float) -> FloatArray:
        """The q-quantile of each channel, interpolated between neighbours as numpy does by default."""
        rank = q * (total - 1)
        low = np.floor(rank)
        below, above = (
            np.array([int(np.searchsorted(c, r, "right")) for c, r in zip(cumulative, rs, strict=True)])
            for rs in (low, np.ceil(rank))
        )
        return np.asarray(below + (above - below) * (rank - low))

    stats = {"min": ranked(0), "max": ranked(1), "mean": mean, "std": std}
    stats |= {name: ranked(q) for name, q in QUANTILES.items()}
    shaped = {name: (value / 255).reshape(3, 1, 1).tolist() for name, value in stats.items()}
    return {**shaped, "count": [pictures]}


def value_stats(values: Sequence[ArrayLike]) -> FeatureStats:
    """Statistics of a feature in an episode: a number or a vector `(length,)` for each of its frames."""
    rows = np.stack([np.atleast_1d(value) for value in values])
    numbers = rows.astype(float)
    ranked = np.quantile(numbers, list(QUANTILES.values()), axis=0)
    return {
        "min": rows.min(axis=0).tolist(),
        "max": rows.max(axis=0).tolist(),
        "mean": numbers.mean(axis=0).tolist(),
        **dict(zip(QUANTILES, ranked.tolist(), strict=True)),
        "std": numbers.std(axis=0).tolist(),
        "count": [len(rows)],
    }


class RunningStats:
    """Exact statistics of numbers seen so far; `add` costs microseconds a number.

    Features are named vectors of a fixed length; NumPy dtypes tell how their minimum and maximum are written.
    """

    def __init__(self, rows: Sequence[Mapping[str, ArrayLike]], dtypes: Mapping[str, np.dtype[Any]]) -> None:
        """Start from the rows seen already; `dtypes` names the features, in order."""
        self._dtypes = dtypes
        self._columns: list[array[float]] = []
        self._lengths: dict[str, int] = {}
        self._count = len(rows)
        self._mean = np.zeros(0)
        self._squares = np.zeros(0)
        if rows:
            self._start(np.array([self._flat(row) for row in rows]), rows[0])

    def _flat(self, row: Mapping[str, ArrayLike]) -> FloatArray:
        return np.concatenate([np.ravel(np.asarray(row[name], float)) for name in self._dtypes])

    def _start(self, values: FloatArray, row: Mapping[str, ArrayLike]) -> None:
        self._lengths = {name: np.size(np.asarray(row[name])) for name in self._dtypes}
        self._columns = [array("d", column.tobytes()) for column in np.sort(values, axis=0).T.copy()]
        self._mean = values.mean(axis=0)
        self._squares = ((values - self._mean) ** 2).sum(axis=0)

    def add(self, row: Mapping[str, ArrayLike]) -> None:
        """Add one row to the statistics."""
        values = self._flat(row)
        self._count += 1
        if self._count == 1:
            self._start(values[None], row)
            return
        # Welford, "Note on a method for calculating corrected sums of squares and products", 1962.
        delta = values - self._mean
        self._mean = self._mean + delta / self._count
        self._squares = self._squares + delta * (values - self._mean)
        for column, value in zip(self._columns, values.tolist(), strict=True):
            insort(column, value)

    def stats(self) -> dict[str, FeatureStats]:
        """Statistics of every feature."""
        std = np.sqrt(self._squares / max(self._count, 1))
        result, start = {}, 0
        for name, length in self._lengths.items():
            part = slice(start, start + length)
            columns, plain = self._columns[part], _PLAIN[self._dtypes[name].kind]
            stats: FeatureStats = {
                "min": [plain(column[0]) for column in columns],
                "max": [plain(column[-1]) for column in columns],
                "mean": self._mean[part].tolist(),
                "std": std[part].tolist(),
                "count": [self._count],
            }
            stats |= {key: [_quantile(column, q) for column in columns] for key, q in QUANTILES.items()}
            result[name] = stats
            start += length
        return result


def _quantile(ordered: Sequence[float], q: float) -> float:
    """The q-quantile of sorted numbers, interpolated between neighbours as numpy does by default."""
    rank = q * (len(ordered) - 1)
    low = int(rank)
    high = min(low + 1, len(ordered) - 1)
    return ordered[low] + (ordered[high] - ordered[low]) * (rank - low)


IMAGE = "observation.images.top"
FPS = 1
"""LeRobot wants a frame rate; with one frame an attempt it means nothing."""
FAILURES: tuple[str, ...] = get_args(Failure)
"""`annotation.failure` counts from 1 through these; 0 is success."""
UNKNOWN = -1.0
"""Stands for NaN (corners of a bag that was not found, ...), which would spoil LeRobot's statistics."""

Frame = dict[str, ArrayLike]
"""One frame's numeric features by name, in LeRobot's dtypes."""

_POSE = ("x", "y", "yaw")
_CORNERS = [f"{axis}{corner}" for corner in range(4) for axis in "uv"]
_ACTION = [f"{which}.{part}" for which in ("pick", "place") for part in _POSE]


def _feature(dtype: str, names: list[str] | None = None) -> dict[str, Any]:
    return {"dtype": dtype, "shape": [len(names) if names else 1], "names": names}


NUMERIC_FEATURES: dict[str, dict[str, Any]] = {
    "observation.state": _feature("float32", [f"goal.{name}" for name in _CORNERS]),
    "action": _feature("float32", _ACTION),
    "next.success": _feature("bool"),
    "next.done": _feature("bool"),
    "annotation.attempt_id": _feature("int64"),
    "annotation.cell": _feature("int64"),
    "annotation.seed": _feature("int64"),
    "annotation.failure": _feature("int64"),
    "annotation.tries": _feature("int64"),
    "annotation.time_us": _feature("int64"),
    "annotation.box_before": _feature("float32", _CORNERS),
    "annotation.box_after": _feature("float32", _CORNERS),
    "annotation.grasp_width_m": _feature("float32"),
    "annotation.release_width_m": _feature("float32"),
    "annotation.pick_z_m": _feature("float32"),
    "annotation.place_z_m": _feature("float32"),
    "timestamp": _feature("float32"),
    "frame_index": _feature("int64"),
    "episode_index": _feature("int64"),
    "index": _feature("int64"),
    "task_index": _feature("int64"),
}
"""Every feature that is no picture, as `info.json` describes it."""
DTYPES = {name: np.dtype(feature["dtype"]) for name, feature in NUMERIC_FEATURES.items()}

_IMAGE_TYPE = pa.struct([("bytes", pa.binary()), ("path", pa.string())])


def features(picture_size: tuple[int, int]) -> dict[str, dict[str, Any]]:
    """Every feature as `info.json` describes it; pictures are `picture_size` (width, height) pixels."""
    width, height = picture_size
    image = {"dtype": "image", "shape": [height, width, 3], "names": ["height", "width", "channels"]}
    return {IMAGE: image, **NUMERIC_FEATURES}


def frame_of(record: Record, index: int, done: bool) -> Frame:
    """The frame of an attempt, without its picture.

    `index` counts the frames of all episodes; `done` says whether nothing of the task is left to do.
    """
    failure = record["failure"]
    values = {
        "observation.state": record["box_after"],
        "action": record["executed"],
        "next.success": failure is None,
        "next.done": done,
        "annotation.attempt_id": record["attempt_id"],
        "annotation.cell": record["cell"],
        "annotation.seed": record["seed"],
        "annotation.failure": FAILURES.index(failure) + 1 if failure else 0,
        "annotation.tries": record["tries"],
        "annotation.time_us": round(record["time"] * 1e6),
        "annotation.box_before": record["box_before"],
        "annotation.box_after": record["box_after"],
        "annotation.grasp_width_m": record["grasp_width_m"],
        "annotation.release_width_m": record["release_width_m"],
        "annotation.pick_z_m": record["pick_z_m"],
        "annotation.place_z_m": record["place_z_m"],
        "timestamp": record["step"] / FPS,
        "frame_index": record["step"],
        "episode_index": record["episode_index"],
        "index": index,
        "task_index": 0,
    }
    return {name: _fitting(value, DTYPES[name]) for name, value in values.items()}


def _fitting(value: ArrayLike, dtype: np.dtype[Any]) -> NDArray[Any]:
    """A value in a feature's dtype; what float32 cannot hold becomes the nearest it can."""
    if dtype.kind != "f":
        return np.asarray(value, dtype)
    largest = np.finfo(dtype).max
    values = np.asarray(value, float)
    known = np.where(np.isnan(values), UNKNOWN, values)
    return np.asarray(np.clip(known, -largest, largest), dtype)


def frame_table(frame: Frame, png: bytes) -> pa.Table:
    """A row of an episode's data file: a frame's picture (RGB PNG) and its numbers."""
    path = f"frame-{int(np.asarray(frame['frame_index'])):06d}.png"
    columns = {IMAGE: pa.array([{"bytes": png, "path": path}], _IMAGE_TYPE)}
    for name, value in frame.items():
        scalar = pa.from_numpy_dtype(DTYPES[name])
        # A feature of shape [1] must be a column of plain scalars.
        kind = pa.list_(scalar, np.size(value)) if np.ndim(value) else scalar
        columns[name] = pa.array([np.asarray(value).tolist()], kind)
    return pa.table(columns)


def episode_table(frames: Sequence[Frame], histogram: ArrayLike, task: str) -> pa.Table:
    """The description of an episode: one row with all that LeRobot's delete, merge and resume look for.

    `histogram` `(3, 256)` counts the pixels of all its pictures.
    """
    episode, start = (int(np.asarray(frames[0][name])) for name in ("episode_index", "index"))
    stats = {IMAGE: pixel_stats(histogram, len(frames))}
    stats |= {name: value_stats([frame[name] for frame in frames]) for name in frames[0]}
    place = chunk_and_file(episode)
    row: dict[str, Any] = {
        "episode_index": episode,
        "tasks": [task],
        "length": len(frames),
        "data/chunk_index": place["chunk_index"],
        "data/file_index": place["file_index"],
        "dataset_from_index": start,
        "dataset_to_index": start + len(frames),
    }
    row |= {f"stats/{name}/{key}": value for name, entry in stats.items() for key, value in entry.items()}
    row |= {f"meta/episodes/{key}": value for key, value in place.items()}
    return pa.table({name: [value] for name, value in row.items()})


def tasks_table(task: str) -> pa.Table:
    """The tasks: LeRobot reads it with pandas and wants the words as the frame's *index*."""
    column = {
        "field_name": "task",
        "name": "task",
        "pandas_type": "unicode",
        "numpy_type": "object",
        "metadata": None,
    }
    index = {
        "field_name": "task_index",
        "name": "task_index",
        "pandas_type": "int64",
        "numpy_type": "int64",
        "metadata": None,
    }
    pandas = {
        "index_columns": ["task"],
        "column_indexes": [],
        "columns": [index, column],
        "pandas_version": "2.0.0",
    }
    table = pa.table({"task_index": pa.array([0], pa.int64()), "task": [task]})
    return table.replace_schema_metadata({"pandas": json.dumps(pandas)})


def info(episodes: int, frames: int, picture_size: tuple[int, int], robot_type: str) -> dict[str, Any]:
    """The content of `info.json` for a dataset of so many episodes, and frames in all of them."""
    return {
        "codebase_version": "v3.0",
        "robot_type": robot_type,
        "total_episodes": episodes,
        "total_frames": frames,
        "total_tasks": 1 if episodes else 0,
        "chunks_size": CHUNK_FILES,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": FPS,
        "splits": {"train": f"0:{episodes}"},
        "data_path": DATA_TEMPLATE,
        "video_path": None,
        "features": features(picture_size),
    }
