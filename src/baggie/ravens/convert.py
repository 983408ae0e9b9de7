"""Recordings of the Ravens benchmark in our own layout: each action an attempt, each episode an episode."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from baggie.data.summary import inspect_dataset
from baggie.data.writer import DatasetWriter
from baggie.errors import BaggieError, DataError, UsageError
from baggie.geometry import Grid
from baggie.operator import Operator, TerminalOperator, progress
from baggie.options.collecting import ImportOptions
from baggie.ravens.episode import fused
from baggie.ravens.format import RavensAction, RavensEpisode, RavensFolder, pose_to_planar
from baggie.types import Attempt, Outcome, PickPlace

_NOWHERE = np.full((4, 2), np.nan)


def import_ravens(options: ImportOptions, *, operator: Operator | None = None) -> dict[str, Any]:
    """Convert all episodes of a Ravens folder; the recording's summary, ready for JSON.

    The person at the terminal is told how far it is, unless `operator` is given.
    Raises `DataError` when the folder is none of Ravens', an action tilts the object, two episodes have the same
    number, or `options.out` holds another recording; what was converted before stays. Raises `KeyboardInterrupt`, with
    how to go on as its message, when stopped.
    """
    folder, grid = options.folder, _grid(options)
    source = RavensFolder(folder)
    rows, columns = grid.shape
    _check_numbers(source)
    with DatasetWriter(
        options.out,
        task=options.task or _words(folder),
        robot_type="Ravens' UR5",
        picture_size=(columns, rows),
        collection={"ravens": Path(folder).resolve().name, "grid": asdict(grid)},
    ) as writer:
        try:
            _convert(source, writer, grid, operator or TerminalOperator())
        except KeyboardInterrupt:
            begun = f"{len(writer.episodes)} of {len(source)} episodes begun"
            raise KeyboardInterrupt(f"interrupted with {begun}; go on with: {options.command()}") from None
    return inspect_dataset(options.out)


def _grid(options: ImportOptions) -> Grid:
    """Of the pictures. Raises `UsageError` for bounds that make none."""
    try:
        return Grid(options.x, options.y, options.z, options.pixel_m)
    except BaggieError as error:
        raise UsageError(str(error)) from None


def _convert(source: RavensFolder, writer: DatasetWriter, grid: Grid, operator: Operator) -> None:
    recorded = writer.episodes
    # They are recorded one after the other, so all but the last of them are whole.
    last = next(reversed(recorded), None)
    numbers = [number for number, _ in source.episode_ids]
    missing = [i for i, number in enumerate(numbers) if number not in recorded]
    if last in numbers:
        missing.insert(0, numbers.index(last))
    attempt_id = max(writer.attempt_ids, default=-1) + 1
    with progress(operator, "converting episodes", len(source), len(source) - len(missing)) as advance:
        for i in missing:
            episode = source[i]
            for attempt in attempts_of(
                episode, writer.settings.task, grid, attempt_id, recorded.get(episode.number, 0)
            ):
                writer.append(attempt)
                attempt_id += 1
            advance()


def attempts_of(
    episode: RavensEpisode, task: str, grid: Grid, first_id: int = 0, first_step: int = 0
) -> Iterator[Attempt]:
    """An episode's actions from `first_step` on as attempts; ids count from `first_id`.

    Only the last has a picture after: that of the others is the next one's picture before. Ravens does not say which
    object was meant, nor whether the cup held it, so there is no truth and no failure. Raises `DataError` for an action
    that tilts the object.
    """
    for step in range(first_step, len(episode.actions)):
        action = planar(episode.actions[step])
        picked, placed = episode.actions[step]
        last = step == len(episode.actions) - 1
        yield Attempt(
            attempt_id=first_id + step - first_step,
            task=task,
            before=fused(episode.color[step], episode.depth[step], grid),
            after=fused(episode.color[-1], episode.depth[-1], grid) if last else None,
            commanded=action,
            outcome=Outcome(action, pick_z_m=picked.xyz[2], place_z_m=placed.xyz[2]),
            box_before=_NOWHERE,
            box_after=_NOWHERE,
            seed=episode.seed,
            episode=episode.number,
            step=step,
            reward=float(episode.rewards[step + 1]),
        )


def planar(action: RavensAction) -> PickPlace:
    """The action on the table. Raises `DataError` when it tilts the object.

    The yaws are those of Ravens' tool. As everywhere, the object turns by the difference of the two; that of the
    pick is 0 in the demonstrations.
    """
    return PickPlace(pose_to_planar(action.pose0), pose_to_planar(action.pose1))


def _words(folder: Path) -> str:
    """The task in words, as the folder names it: `stack-block-pyramid-train` -> `stack block pyramid`."""
    return re.sub("-(train|val|test)$", "", Path(folder).resolve().name).replace("-", " ")


def _check_numbers(source: RavensFolder) -> None:
    for number, times in Counter(number for number, _ in source.episode_ids).items():
        if times > 1:
            raise DataError(
                f"expected each episode in {source.path} to have a number of its own, got {times} of {number}; "
                "rename them in all folders"
            )
