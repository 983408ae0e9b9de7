"""What LeRobot sees of attempts: frames of episodes, in its v3.0 layout, without importing lerobot.

An attempt is a frame, and an episode of one frame unless it belongs to an episode with others.

LeRobot makes every image-typed column and every `observation*` a policy's input and every `action*` its
output, so only what a policy may see and must produce goes by those names; all else here is `next.*` or
numeric `annotation.*`.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any, get_args

import numpy as np
import pyarrow as pa
from numpy.typing import ArrayLike, NDArray

from baggie.data.layout import CHUNK_FILES, DATA_TEMPLATE, chunk_and_file
from baggie.data.record import Record
from baggie.data.statistics import pixel_stats, value_stats
from baggie.types import Failure

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
