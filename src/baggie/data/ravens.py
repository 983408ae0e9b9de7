"""Folders in the layout of the Ravens benchmark (Zeng et al., "Transporter Networks", CoRL 2020), read and written.

    action/000000-9000.pkl    a list of {"pose0": (xyz, xyzw), "pose1": (xyz, xyzw)}, and a last None
    color/000000-9000.pkl     `(S + 1, 3, 480, 640, 3)` uint8 RGB
    depth/000000-9000.pkl     `(S + 1, 3, 480, 640)` float32 metres
    info/000000-9000.pkl      a list of dicts by object: (position, rotation, dimensions)
    reward/000000-9000.pkl    a list of numbers

for the episode 0 with the seed 9000. They are pickles, which `safe_pickle.py` reads without running them.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from baggie.data.files import write_all
from baggie.data.ravens_cameras import RAVENS_CAMERAS
from baggie.data.ravens_checks import FIELDS, checked_episode
from baggie.data.ravens_episode import (
    RavensAction,
    RavensEpisode,
    RavensObject,
    RavensPose,
    planar_to_pose,
    pose_to_planar,
)
from baggie.data.safe_pickle import load_plain, plain_bytes
from baggie.errors import DataError, WriteError
from baggie.files import only_ours

__all__ = [
    "RAVENS_CAMERAS",
    "RavensAction",
    "RavensEpisode",
    "RavensFolder",
    "RavensObject",
    "RavensPose",
    "planar_to_pose",
    "pose_to_planar",
    "write_episode",
]


class RavensFolder:
    """The episodes in a folder, by number; `folder[i]` reads one, and nothing is kept.

    An episode of six actions takes 45 MB; going through a folder holds one at a time.
    """

    def __init__(self, path: Path | str) -> None:
        """List the episodes. Raises `DataError` when this is no such folder or an episode lacks a file."""
        self.path = Path(path)
        self.episode_ids: tuple[tuple[int, int], ...] = tuple(sorted(_listed(self.path)))
        """(number, seed) of each episode, ascending."""

    def __len__(self) -> int:
        return len(self.episode_ids)

    def __getitem__(self, index: int) -> RavensEpisode:
        """Read and check an episode. Raises `DataError` naming the file that is missing, damaged or wrong."""
        number, seed = self.episode_ids[index]
        return checked_episode(number, seed, _paths(self.path, number, seed), load_plain)

    def __iter__(self) -> Iterator[RavensEpisode]:
        return (self[i] for i in range(len(self)))


def write_episode(folder: Path | str, episode: RavensEpisode) -> None:
    """Add an episode to a folder, making it where there is none; a kill half-way leaves no part of a file.

    What is written is what `RavensFolder` reads, and `pickle.load` under numpy 1 as well as 2. Raises `DataError` when
    the episode is not as it should be or is there already, `WriteError` when the disk is full.
    """
    folder = Path(folder)
    paths = _paths(folder, episode.number, episode.seed)
    raw = {paths[field]: value for field, value in _raw(episode).items()}
    checked_episode(episode.number, episode.seed, paths, raw.__getitem__)
    for path in raw:
        if path.exists():
            raise DataError(f"{path} is there already: take another folder, number or seed, or remove it")
    partial = folder / ".partial"
    try:
        write_all([(path, plain_bytes(value)) for path, value in raw.items()], partial)
    except OSError as error:
        raise WriteError(
            f"{folder} cannot be written: {error.strerror}; free some space or mend the rights"
        ) from error
    finally:
        with contextlib.suppress(OSError):  # another writer may be using it
            partial.rmdir()


def _raw(episode: RavensEpisode) -> dict[str, object]:
    """By field, as Ravens' own code stores it."""
    actions = [
        {"pose0": tuple(map(np.array, action.pose0)), "pose1": tuple(map(np.array, action.pose1))}
        for action in episode.actions
    ]
    info = [
        None if objects is None else {key: tuple(value) for key, value in objects.items()}
        for objects in episode.info
    ]
    return {
        "action": [*actions, None],
        "reward": np.asarray(episode.rewards, float).tolist(),
        "info": info,
        "color": episode.color,
        "depth": episode.depth,
    }


def _name(number: int, seed: int) -> str:
    return f"{number:06d}-{seed}.pkl"


def _paths(folder: Path, number: int, seed: int) -> dict[str, Path]:
    return {field: folder / field / _name(number, seed) for field in FIELDS}


def _listed(folder: Path) -> set[tuple[int, int]]:
    for field in FIELDS:
        if not (folder / field).is_dir():
            raise DataError(
                f"{folder / field} is missing: expected the folder of a Ravens task, with {', '.join(FIELDS)} in it"
            )
    files = (path for field in FIELDS for path in (folder / field).iterdir())
    ours = only_ours(folder, files, lambda path: _episode(path.name) is not None)
    found = {field: {_episode(path.name) for path in ours if path.parent.name == field} for field in FIELDS}
    every = {episode for episodes in found.values() for episode in episodes if episode is not None}
    for field, episodes in found.items():
        for number, seed in sorted(every - episodes):
            raise DataError(
                f"{folder / field / _name(number, seed)} is missing: copy it there, "
                f"or remove this episode from {', '.join(FIELDS)}"
            )
    return every


def _episode(name: str) -> tuple[int, int] | None:
    """Number and seed of the episode whose file is called so; None for another name."""
    numbers = re.fullmatch(r"([0-9]+)-([0-9]+)\.pkl", name)
    episode = (int(numbers[1]), int(numbers[2])) if numbers else None
    return episode if episode is not None and _name(*episode) == name else None
