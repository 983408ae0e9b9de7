"""A dataset's content in numbers and as a contact sheet, and the goals of its attempts.

A recorded attempt's goal is where the bag came to rest, as if it had been meant to go there.
"""

from __future__ import annotations

import contextlib
import math
import warnings
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from baggie.data.dataset import Dataset, open_dataset
from baggie.data.writer import DONE
from baggie.errors import BaggieError, BaggieWarning, DataError, WriteError
from baggie.geometry import FloatArray, Grid, PlanarPose
from baggie.options.collecting import InspectOptions
from baggie.pictures import write_picture
from baggie.types import Attempt, Goal, Image, Observation
from baggie.vision.draw import check_goal

_CELL_M = 0.05
"""Side of the squares that coverage counts."""
_THUMBNAIL_WIDTH = 160
_BORDER = 3
_MARK_M = 0.04
"""Side of the square that shows a pose where no object was found."""
_WHITE, _RED, _BLUE, _GREEN = (255, 255, 255), (220, 30, 30), (40, 90, 255), (0, 200, 0)


def inspect(options: InspectOptions) -> tuple[dict[str, Any], WriteError | None]:
    """What is in a dataset, as `inspect_dataset` says it, and where its contact sheet was drawn.

    With it the error where the sheet cannot be written though somebody said where. Else that is a warning: the
    recording is a colleague's perhaps, or the disk full. Raises `DataError` where there is no dataset.
    """
    summary = inspect_dataset(options.data)
    if summary["attempts"]:
        sheet = options.sheet or options.data / "contact-sheet.png"
        try:
            summary["contact_sheet"] = str(contact_sheet(options.data, sheet, options.columns))
        except WriteError as error:
            if options.sheet is not None:
                return summary, error
            warnings.warn(f"{error}; or give --sheet another place", BaggieWarning, stacklevel=2)
    return summary, None


def inspect_dataset(root: Path | str) -> dict[str, Any]:
    """What is in a dataset, as one JSON object.

    `coverage` tells where bags were picked and placed: the extent in the robot base frame, metres, and how many of its
    5 cm squares were visited. `duration_s` spans from the first picture to the last; where the clock began anew
    meanwhile, as a simulated one does with every scene, what went before is added. `episodes` is there where attempts
    belong to some: how many, how many of those were finished (earned everything), and what they earned on average.
    `layers` is there where bags lay on each other.
    Raises DataError where there is no dataset.
    """
    dataset = open_dataset(root)
    failures = Counter(failure for failure in dataset.failures if failure is not None)
    return {
        "attempts": len(dataset),
        "succeeded": len(dataset) - failures.total(),
        "failed": dict(failures.most_common()),
        **_episodes(dataset),
        **layers(dataset),
        "task": dataset.settings.task,
        "robot_type": dataset.settings.robot_type,
        "picture_size": list(dataset.settings.picture_size),
        "camera_size": list(dataset.camera_size),
        **({"squeezed": True} if dataset.squeezed else {}),
        "attempt_ids": [int(f(dataset.attempt_ids)) for f in (np.min, np.max)] if len(dataset) else [],
        **_durations(dataset),
        "coverage": _coverage(dataset),
        "megabytes": round(_size(dataset.root) / 1e6, 1),
        "collection": dict(dataset.collection),
    }


def layers(dataset: Dataset) -> dict[str, Any]:
    """How many bags were placed in each layer, and how many stayed there; empty where nobody counts layers."""
    numbers = dataset.numbers()
    layer, succeeded = numbers["place_layer"], numbers["success"]
    counted = {
        str(int(each)): {
            "placed": int((layer == each).sum()),
            "succeeded": int((succeeded & (layer == each)).sum()),
        }
        for each in np.unique(layer[np.isfinite(layer)])
    }
    return {"layers": counted} if counted else {}


def _size(root: Path) -> int:
    """Bytes of all files; what vanishes meanwhile, as a writer's unfinished ones do, counts as nothing."""
    total = 0
    for path in root.rglob("*"):
        with contextlib.suppress(OSError):
            total += path.stat().st_size if path.is_file() else 0
    return total


def _episodes(dataset: Dataset) -> dict[str, Any]:
    """Count the episodes; empty where all attempts stand alone."""
    inside = dataset.episodes >= 0
    if not inside.any():
        return {}
    numbers, places = np.unique(dataset.episodes[inside], return_inverse=True)
    counted: dict[str, Any] = {"count": len(numbers), "attempts": int(inside.sum())}
    rewards = dataset.numbers()["reward"].astype(float)[inside]
    if np.isfinite(rewards).any():
        scores = np.bincount(places, np.nan_to_num(rewards))
        counted |= {"finished": int((scores >= DONE).sum()), "mean_score": round(float(scores.mean()), 3)}
    return {"episodes": counted}


def _durations(dataset: Dataset) -> dict[str, Any]:
    numbers = dataset.numbers()
    if not len(dataset):
        return {"duration_s": 0.0, "phases_s": {}}
    in_order = np.argsort(dataset.attempt_ids)
    begin = numbers["before_time"].astype(float)[in_order]
    end = np.fmax(begin, numbers["after_time"].astype(float)[in_order])
    anew = np.flatnonzero(np.diff(begin, prepend=np.inf) < 0)
    spans = np.maximum.reduceat(end, anew) - begin[anew]
    phases = {name: numbers[name] for name in numbers if name.startswith("timings_s.")}
    return {
        "duration_s": round(float(spans.sum()), 3),
        "phases_s": {
            name.removeprefix("timings_s."): {
                "mean": round(float(np.nanmean(seconds)), 3),
                "max": round(float(np.nanmax(seconds)), 3),
            }
            for name, seconds in phases.items()
            if np.isfinite(seconds).any()
        },
    }


def _coverage(dataset: Dataset) -> dict[str, Any]:
    executed = dataset.numbers()["executed"].reshape(-1, 2, 3)[..., :2].reshape(-1, 2)
    points = executed[np.isfinite(executed).all(axis=1)]
    if not len(points):
        return {"x_m": [], "y_m": [], "squares": 0, "visited": 0}
    squares = np.floor(points / _CELL_M).astype(int)
    extent = squares.max(axis=0) - squares.min(axis=0) + 1
    return {
        "x_m": [round(float(points[:, 0].min()), 3), round(float(points[:, 0].max()), 3)],
        "y_m": [round(float(points[:, 1].min()), 3), round(float(points[:, 1].max()), 3)],
        "squares": int(extent.prod()),
        "visited": len(np.unique(squares, axis=0)),
    }


def contact_sheet(root: Path | str, out_png: Path | str, columns: int = 6, limit: int = 300) -> Path:
    """Write one PNG of the attempts, `columns` a row: before and after, with the bag's box in each.

    The box before (the pick) is blue, the box after (the place) green; in orthographic pictures without boxes, 4 cm
    squares stand for them where it was picked and placed. Failed attempts are framed red and say why. Of more than
    `limit` attempts, as many are shown, evenly spread. Returns the path. Raises DataError; WriteError
    where it cannot be written.
    """
    dataset = open_dataset(root)
    if not len(dataset):
        raise DataError(f"{root} holds no attempts yet: collect some first")
    if columns < 1 or limit < 1:
        raise DataError(f"a contact sheet needs 1 column and 1 attempt or more, got {columns} and {limit}")
    chosen = np.unique(np.linspace(0, len(dataset) - 1, min(limit, len(dataset))).round().astype(int))
    tiles = [_tile(dataset[int(index)], dataset.after(int(index))) for index in chosen]
    height, width = tiles[0].shape[:2]
    rows = math.ceil(len(tiles) / columns)
    sheet = np.full((rows * height, min(columns, len(tiles)) * width, 3), 255, np.uint8)
    for place, tile in enumerate(tiles):
        top, left = place // columns * height, place % columns * width
        sheet[top : top + height, left : left + width] = tile
    path = Path(out_png)
    write_picture(path, sheet)
    return path


def _tile(attempt: Attempt, seen_after: Observation | None) -> Image:
    """One attempt: the picture before beside the picture after, framed."""
    executed, observation = attempt.outcome.executed, attempt.before
    box = _box(attempt.box_before, observation.grid, executed.pick)
    before = _thumbnail(observation.color, {_BLUE: box})
    after = np.full_like(before, 128)
    if seen_after is not None:
        box = _box(attempt.box_after, seen_after.grid, executed.place)
        after = _thumbnail(seen_after.color, {_GREEN: box})
    pair = np.hstack([before, after])
    label = f"{attempt.attempt_id}" + (f" {attempt.outcome.failure}" if attempt.outcome.failure else "")
    for color, thickness in (((0, 0, 0), 3), (_WHITE, 1)):
        cv2.putText(pair, label, (5, 14), cv2.FONT_HERSHEY_SIMPLEX, 0.42, color, thickness, cv2.LINE_AA)
    frame = _WHITE if attempt.outcome.success else _RED
    height, width = pair.shape[:2]
    tile = np.full((height + 2 * _BORDER, width + 2 * _BORDER, 3), frame, np.uint8)
    tile[_BORDER:-_BORDER, _BORDER:-_BORDER] = pair
    return tile


def _box(found: FloatArray, grid: Grid | None, pose: PlanarPose) -> FloatArray:
    """The corners found, `(4, 2)` pixels; where there are none, in an orthographic picture, a square at the pose."""
    if grid is None or np.isfinite(found).all():
        return found
    corners = _MARK_M / 2 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    return grid.to_pixels(corners @ pose.matrix()[:2, :2].T + pose.xy)


def _thumbnail(picture: Image, boxes: dict[tuple[int, int, int], FloatArray]) -> Image:
    """A small copy with boxes `(4, 2)` pixels (u, v) of the large one drawn in, by colour; NaN: not drawn."""
    factor = _THUMBNAIL_WIDTH / picture.shape[1]
    size = (_THUMBNAIL_WIDTH, max(1, round(picture.shape[0] * factor)))
    small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    for color, corners in boxes.items():
        if np.isfinite(corners).all():
            fixed = np.round(((corners + 0.5) * factor - 0.5) * 16).astype(np.int32)
            cv2.polylines(small, [fixed], True, color, 1, cv2.LINE_AA, 4)
    return np.asarray(small, np.uint8)


_DONE = 1 - 1e-6


def goal_of(attempt: Attempt) -> Goal:
    """The bag's box in the picture after, as the goal in the picture before.

    Hindsight relabelling: whatever the attempt was meant to do, it shows how to reach where the bag lies now.
    Where several bags lay about, it says which was picked, and in which layers both places are.
    Nothing is painted here; `baggie.vision.draw.paint_goal` does that when a picture is read, so that one
    recording serves every style and colour, the printed card's in today's light too (`vision.goal_card.measure_color`).
    Raises `DataError` when the bag was not found in the picture after.
    """
    if not np.isfinite(attempt.box_after).all():
        raise DataError(
            f"attempt {attempt.attempt_id} has no goal: the bag was not found in its picture after"
        )
    corners = np.asarray(attempt.box_after, float)
    u, v = (float(at) for at in attempt.box_before.mean(axis=0))
    pointed = attempt.pick_layer is not None and math.isfinite(u + v)
    return Goal(
        corners,
        object_at=(u, v) if pointed else None,
        layer=attempt.place_layer or 0,
        object_layer=attempt.pick_layer or 0,
    )


def shown_goal(attempt: Attempt) -> Goal | None:
    """Where the object came to rest, as the goal in the picture before; None for a task without a marked goal."""
    return goal_of(attempt) if np.isfinite(attempt.box_after).all() else None


def is_demonstration(attempt: Attempt) -> bool:
    """Whether an attempt can teach: it succeeded, and its goal lies wholly in the picture before."""
    if not attempt.outcome.success:
        return False
    try:
        check_goal(goal_of(attempt), attempt.before.size)
    except BaggieError:
        return False
    return True


def did_its_task(rewards: Iterable[float | None]) -> bool:
    """Whether an episode with these rewards did its task: they add up to 1, or nobody counted (None or NaN)."""
    counted = [reward for reward in rewards if reward is not None and not math.isnan(reward)]
    return not counted or sum(counted) >= _DONE
