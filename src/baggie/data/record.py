"""An attempt as one row of our own parquet: every number exact, every picture but the one before.

The picture before lies in the LeRobot part of the dataset, once. Pictures are PNGs: colour exact, depth to the
millimetre, heights to a hundredth of one.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from baggie.data.files import broken
from baggie.errors import DataError
from baggie.geometry import FloatArray, Grid, PlanarPose
from baggie.types import Attempt, Image, Intrinsics, Observation, Outcome, PickPlace, Truth

_HEIGHT_STEPS = 100_000
"""Per metre."""
_MOST = int(np.iinfo(np.uint16).max)
MAX_HEIGHT_M = _MOST / _HEIGHT_STEPS
"""The greatest height that can be stored."""
_START, _END = b"\x89PNG\r\n\x1a\n", b"IEND\xaeB`\x82"


def is_whole(png: bytes) -> bool:
    """Whether these are the bytes of one PNG, from the first to the last."""
    return png.startswith(_START) and png.endswith(_END)


def encode_color(color: Image) -> bytes:
    """RGB `(H, W, 3)` uint8 -> PNG."""
    # OpenCV's own defaults are both the fastest and the smallest it has on pictures of a table.
    return _encode(np.asarray(cv2.cvtColor(color, cv2.COLOR_RGB2BGR), np.uint8))


def decode_color(png: bytes | memoryview, source: Path, out: Image | None = None) -> Image:
    """PNG -> RGB `(H, W, 3)` uint8; into `out` where given, resized (area average) to its size.

    Raises DataError naming `source` when the picture is damaged.
    """
    picture = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    if picture is None:
        raise broken(source, "holds a damaged picture")
    if out is not None and out.shape != picture.shape:
        picture = cv2.resize(picture, (out.shape[1], out.shape[0]), interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB, dst=out), np.uint8)


def encode_depth(depth_m: NDArray[np.float32]) -> bytes:
    """Depth `(H, W)` float32 metres -> 16-bit PNG of millimetres; 0 where unknown or beyond 65.535 m."""
    millimetres = np.rint(np.nan_to_num(depth_m, nan=0.0, posinf=0.0, neginf=0.0) * 1000.0)
    millimetres[(millimetres < 0) | (millimetres > _MOST)] = 0
    return _encode(millimetres.astype(np.uint16))


def decode_depth(png: bytes | memoryview, source: Path) -> NDArray[np.float32]:
    """The inverse of `encode_depth`, to the millimetre."""
    return np.asarray(_decode16(png, source, "depth") / 1000.0, np.float32)


def encode_height(height_m: NDArray[np.float32]) -> bytes:
    """Heights `(H, W)` float32 metres, 0 to `MAX_HEIGHT_M` -> 16-bit PNG in steps of 10 micrometres, the nearest."""
    return _encode(np.rint(np.asarray(height_m, float) * _HEIGHT_STEPS).astype(np.uint16))


def decode_height(png: bytes | memoryview, source: Path) -> NDArray[np.float32]:
    """The inverse of `encode_height`, to 5 micrometres."""
    return np.asarray(_decode16(png, source, "height") / _HEIGHT_STEPS, np.float32)


def _decode16(png: bytes | memoryview, source: Path, kind: str) -> NDArray[np.uint16]:
    picture = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_UNCHANGED)
    if picture is None:
        raise broken(source, f"holds a damaged {kind} picture")
    return np.asarray(picture, np.uint16)


def _encode(picture: NDArray[np.uint8] | NDArray[np.uint16]) -> bytes:
    return bytes(cv2.imencode(".png", picture)[1])


Record = dict[str, Any]
"""The row of one attempt, by the columns of `SCHEMA`."""

_INTRINSICS = pa.struct(
    [
        ("width", pa.int64()),
        ("height", pa.int64()),
        ("matrix", pa.list_(pa.float64(), 9)),
        ("distortion", pa.list_(pa.float64())),
    ]
)
_GRID = pa.list_(pa.float64(), 7)
"""x, y and z, lower and upper bound each, and the size of a pixel; metres."""
_NUMBERS = pa.schema(
    [
        ("attempt_id", pa.int64()),
        ("episode_index", pa.int64()),
        ("task", pa.string()),
        ("time", pa.float64()),
        ("cell", pa.int64()),
        ("seed", pa.int64()),
        ("failure", pa.string()),
        ("commanded", pa.list_(pa.float64(), 6)),
        ("executed", pa.list_(pa.float64(), 6)),
        ("grasp_width_m", pa.float64()),
        ("release_width_m", pa.float64()),
        ("pick_z_m", pa.float64()),
        ("place_z_m", pa.float64()),
        ("tries", pa.int64()),
        ("timings_s", pa.map_(pa.string(), pa.float64())),
        ("box_before", pa.list_(pa.float64(), 8)),
        ("box_after", pa.list_(pa.float64(), 8)),
        ("before_time", pa.float64()),
        ("after_time", pa.float64()),
        ("before_intrinsics", _INTRINSICS),
        ("after_intrinsics", _INTRINSICS),
        ("truth_before", pa.list_(pa.float64(), 3)),
        ("truth_after", pa.list_(pa.float64(), 3)),
        ("before_offset", pa.int64()),
        ("before_length", pa.int64()),
        ("histogram", pa.list_(pa.int32(), 3 * 256)),
        ("episode", pa.int64()),
        ("step", pa.int64()),
        ("reward", pa.float64()),
        ("before_grid", _GRID),
        ("after_grid", _GRID),
        ("object_symmetry", pa.int64()),
        ("commanded_heights", pa.list_(pa.float64(), 3)),
        ("executed_heights", pa.list_(pa.float64(), 3)),
        ("pick_layer", pa.int64()),
        ("place_layer", pa.int64()),
        ("under", pa.list_(pa.list_(pa.float64(), 3))),
    ]
)
_PICTURES = pa.schema(
    [
        ("before_depth", pa.binary()),
        ("after_color", pa.binary()),
        ("after_depth", pa.binary()),
        ("before_height", pa.binary()),
        ("after_height", pa.binary()),
    ]
)
_LATER: Mapping[str, int | None] = {
    **dict.fromkeys([*_NUMBERS.names[_NUMBERS.names.index("episode") :], "before_height", "after_height"]),
    "step": 0,
}
"""The columns that older recordings lack, and what they read as there."""
SCHEMA = pa.unify_schemas([_NUMBERS, _PICTURES])
"""The columns of `attempts/`; docs/data-format.md says what each is."""
NUMBERS = tuple(_NUMBERS.names)
"""The columns that are no pictures."""


def complete(table: pa.Table, columns: Sequence[str], source: Path) -> pa.Table:
    """The `columns` of a table, in their order; those that an older recording lacks are filled in.

    Raises DataError naming `source` when another column is missing.
    """
    missing = [name for name in columns if name not in table.column_names]
    for name in missing:
        if name not in _LATER:
            raise broken(source, f"lacks the column {name}")
        filler = pa.array([_LATER[name]] * table.num_rows, SCHEMA.field(name).type)
        table = table.append_column(SCHEMA.field(name), filler)
    return table.select(columns)


def fit(attempt: Attempt, size: tuple[int, int]) -> Attempt:
    """Resize the pictures, intrinsics and box corners of an attempt to `size` (width, height) pixels.

    Raises `BaggieError` for an orthographic picture of another size.
    """
    after = attempt.after
    return dataclasses.replace(
        attempt,
        before=attempt.before.resized(*size),
        after=after.resized(*size) if after else None,
        box_before=_scaled(attempt.box_before, attempt.before.size, size),
        box_after=_scaled(attempt.box_after, (after or attempt.before).size, size),
    )


def without_depth(attempt: Attempt) -> Attempt:
    """Drop the depth of an attempt: its pictures in colour alone."""
    before, after = (
        None if seen is None else dataclasses.replace(seen, depth=None)
        for seen in (attempt.before, attempt.after)
    )
    assert before is not None
    return dataclasses.replace(attempt, before=before, after=after)


def _scaled(corners: FloatArray, old: tuple[int, int], new: tuple[int, int]) -> FloatArray:
    """Pixel corners `(4, 2)` in a resized picture; pixel centres are at integers."""
    corners = np.asarray(corners, float)
    return corners if old == new else (corners + 0.5) * np.divide(new, old) - 0.5


def to_record(attempt: Attempt, episode_index: int, histogram: NDArray[np.int32]) -> Record:
    """The row of an attempt whose pictures are at the recorded size already. Raises DataError.

    `histogram` is `(3, 256)`: how many pixels of the picture before have each value, by channel (RGB). Where
    that picture lies in its file is for the writer to fill in.
    """
    if attempt.box_before.shape != (4, 2) or attempt.box_after.shape != (4, 2):
        raise DataError(
            f"attempt {attempt.attempt_id}: box corners must be (4, 2) pixels, "
            f"got {attempt.box_before.shape} and {attempt.box_after.shape}"
        )
    before, after, outcome, truth = attempt.before, attempt.after, attempt.outcome, attempt.truth
    for observation in (before, after):
        if observation is not None:
            _check_orthographic(attempt.attempt_id, observation)
    return {
        "attempt_id": attempt.attempt_id,
        "episode_index": episode_index,
        "task": attempt.task,
        "time": attempt.time,
        "cell": attempt.cell,
        "seed": attempt.seed,
        "failure": outcome.failure,
        "commanded": attempt.commanded.to_array(),
        "executed": outcome.executed.to_array(),
        "grasp_width_m": outcome.grasp_width_m,
        "release_width_m": outcome.release_width_m,
        "pick_z_m": outcome.pick_z_m,
        "place_z_m": outcome.place_z_m,
        "tries": outcome.tries,
        "timings_s": list(outcome.timings_s.items()),
        "box_before": attempt.box_before.ravel(),
        "box_after": attempt.box_after.ravel(),
        "before_time": before.time,
        "after_time": after.time if after else None,
        "before_intrinsics": _intrinsics_record(before.intrinsics),
        "after_intrinsics": _intrinsics_record(after.intrinsics if after else None),
        "truth_before": _pose_record(truth.before) if truth else None,
        "truth_after": _pose_record(truth.after) if truth else None,
        "before_offset": None,
        "before_length": None,
        "histogram": histogram.ravel(),
        "episode": attempt.episode,
        "step": attempt.step,
        "reward": attempt.reward,
        "before_grid": _grid_record(before.grid),
        "after_grid": _grid_record(after.grid if after else None),
        "object_symmetry": attempt.object_symmetry,
        "commanded_heights": _heights_record(attempt.commanded),
        "executed_heights": _heights_record(outcome.executed),
        "pick_layer": attempt.pick_layer,
        "place_layer": attempt.place_layer,
        "under": [_pose_record(pose) for pose in attempt.under],
        "before_depth": encode_depth(before.depth) if before.depth is not None else None,
        "after_color": encode_color(after.color) if after else None,
        "after_depth": encode_depth(after.depth) if after and after.depth is not None else None,
        "before_height": encode_height(before.height) if before.height is not None else None,
        "after_height": encode_height(after.height) if after and after.height is not None else None,
    }


def _check_orthographic(attempt_id: int, observation: Observation) -> None:
    """Raise DataError where grid and heights do not fit the picture, or each other."""
    (width, height), grid, heights = observation.size, observation.grid, observation.height
    if grid is not None and grid.shape != (height, width):
        raise DataError(
            f"attempt {attempt_id}: expected a picture as large as its grid, {grid.shape[1]} x {grid.shape[0]} pixels, "
            f"got {width} x {height}; take both from one fuse()"
        )
    if heights is None:
        return
    if grid is None or heights.shape != grid.shape:
        raise DataError(
            f"attempt {attempt_id}: expected heights {height} x {width} with the grid they are of, got "
            f"{' x '.join(map(str, heights.shape))} {'without one' if grid is None else 'with one'}; "
            "take both from one fuse()"
        )
    low, high = (round(float(end), 5) for end in (heights.min(), heights.max()))  # in steps of 10 micrometres
    if not 0 <= low <= high <= MAX_HEIGHT_M:
        raise DataError(
            f"attempt {attempt_id}: expected heights from 0 to {MAX_HEIGHT_M} m, got {low:.5g} to {high:.5g}; "
            "set the grid's bounds of z accordingly"
        )


def to_table(record: Record) -> pa.Table:
    """A record as a table of one row. Raises DataError when a number does not fit its column."""
    try:
        return pa.Table.from_pydict({key: [value] for key, value in record.items()}, schema=SCHEMA)
    except (pa.ArrowException, OverflowError, TypeError) as error:
        raise DataError(f"attempt {record['attempt_id']} cannot be stored: {error}") from None


def to_attempt(record: Record, before_png: bytes | memoryview, source: Path) -> Attempt:
    """The inverse of `to_record`; `before_png` is the picture before. Raises DataError naming `source`."""
    before = _observation("before", before_png, record, source)
    after = _observation("after", record["after_color"], record, source) if record["after_color"] else None
    truth = None
    if record["truth_before"] is not None:
        truth = Truth(PlanarPose(*record["truth_before"]), PlanarPose(*record["truth_after"]))
    return Attempt(
        attempt_id=record["attempt_id"],
        task=record["task"],
        before=before,
        after=after,
        commanded=_action(record, "commanded"),
        outcome=Outcome(
            executed=_action(record, "executed"),
            failure=record["failure"],
            grasp_width_m=record["grasp_width_m"],
            release_width_m=record["release_width_m"],
            pick_z_m=record["pick_z_m"],
            place_z_m=record["place_z_m"],
            tries=record["tries"],
            timings_s=dict(record["timings_s"]),
        ),
        box_before=np.reshape(record["box_before"], (4, 2)),
        box_after=np.reshape(record["box_after"], (4, 2)),
        cell=record["cell"],
        seed=record["seed"],
        time=record["time"],
        truth=truth,
        episode=record["episode"],
        step=record["step"],
        reward=record["reward"],
        object_symmetry=record["object_symmetry"],
        pick_layer=record["pick_layer"],
        place_layer=record["place_layer"],
        under=tuple(PlanarPose(*pose) for pose in record["under"] or ()),
    )


def _heights_record(action: PickPlace) -> list[float] | None:
    """Heights below the pick and the place, NaN where nobody knows, and the tallest; None where all is the table."""
    heights = [action.pick_on_m, action.place_on_m, action.tallest_m]
    return None if heights == [0.0] * 3 else [math.nan if height is None else height for height in heights]


def _action(record: Record, name: str) -> PickPlace:
    """The inverse of an action's numbers and heights."""
    action, heights = PickPlace.from_array(record[name]), record[f"{name}_heights"]
    if heights is None:
        return action
    pick_on, place_on = (None if math.isnan(height) else height for height in heights[:2])
    return dataclasses.replace(action, pick_on_m=pick_on, place_on_m=place_on, tallest_m=heights[2])


def _observation(which: str, color: bytes | memoryview, record: Record, source: Path) -> Observation:
    """The picture `before` or `after`."""
    depth, height = record[f"{which}_depth"], record[f"{which}_height"]
    return Observation(
        decode_color(color, source),
        decode_depth(depth, source) if depth else None,
        _intrinsics(record[f"{which}_intrinsics"]),
        record[f"{which}_time"],
        to_grid(record[f"{which}_grid"]),
        decode_height(height, source) if height else None,
    )


def to_grid(values: Sequence[float] | None) -> Grid | None:
    """The grid in a record's column."""
    if values is None:
        return None
    x_low, x_high, y_low, y_high, z_low, z_high, pixel_m = values
    return Grid((x_low, x_high), (y_low, y_high), (z_low, z_high), pixel_m)


def _grid_record(grid: Grid | None) -> list[float] | None:
    return None if grid is None else [*grid.x, *grid.y, *grid.z, grid.pixel_m]


def _pose_record(pose: PlanarPose) -> list[float]:
    return [pose.x, pose.y, pose.yaw]


def _intrinsics_record(camera: Intrinsics | None) -> Mapping[str, Any] | None:
    if camera is None:
        return None
    return {
        "width": camera.width,
        "height": camera.height,
        "matrix": np.ravel(camera.matrix),
        "distortion": np.ravel(camera.distortion),
    }


def _intrinsics(record: Mapping[str, Any] | None) -> Intrinsics | None:
    if record is None:
        return None
    matrix = np.reshape(np.array(record["matrix"], float), (3, 3))
    return Intrinsics(record["width"], record["height"], matrix, np.array(record["distortion"], float))
