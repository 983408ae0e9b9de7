"""Where the files of a dataset lie.

    meta/info.json, meta/stats.json, meta/tasks.parquet
    meta/episodes/chunk-000/file-012.parquet      episode 12, as LeRobot describes it
    data/chunk-000/file-012.parquet               episode 12: its frames, as LeRobot reads them
    attempts/collection.json                      the settings this was collected with
    attempts/chunk-000/attempt-000123.parquet     attempt 123, exact and complete but for the picture before
    attempts/index.parquet                        the numbers of all attempts, gathered
    .baggie/                                      the writer's lock, and files not finished yet

Episodes, here LeRobot's, count in order of arrival; attempts carry the number they were given. A file of another name,
or in another place than its number's, is not ours: it is passed over and stays.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from baggie.files import only_ours

CHUNK_FILES = 1000
"""Files in one folder, at most; LeRobot's own default."""

DATA_TEMPLATE = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
EPISODES_TEMPLATE = "meta/episodes/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"

CALIBRATION_FOLDER = "calibration"
"""Where a recording keeps the colour-mask policy of its cell, with the map that the collector used and the picture that
a watch compares with."""


@dataclass(frozen=True)
class Layout:
    """The paths of the dataset in the folder `root`."""

    root: Path

    @property
    def info(self) -> Path:
        """LeRobot's description of the whole; written last, so what it counts is complete."""
        return self.root / "meta/info.json"

    @property
    def stats(self) -> Path:
        """LeRobot's statistics of every feature."""
        return self.root / "meta/stats.json"

    @property
    def tasks(self) -> Path:
        """The task in words."""
        return self.root / "meta/tasks.parquet"

    @property
    def collection(self) -> Path:
        """The settings the dataset was collected with."""
        return self.root / "attempts/collection.json"

    @property
    def index(self) -> Path:
        """The numbers of all attempts gathered in one file; a cache that may lag behind or be missing."""
        return self.root / "attempts/index.parquet"

    @property
    def lock(self) -> Path:
        """Locked while a writer is open."""
        return self.root / ".baggie/lock"

    @property
    def partial(self) -> Path:
        """Files being written; out of the sight of LeRobot, which reads every `data/*/*.parquet`."""
        return self.root / ".baggie/partial"

    def data(self, episode: int) -> Path:
        """The frames of an episode, counted from 0."""
        return self.root / DATA_TEMPLATE.format(**chunk_and_file(episode))

    def episode(self, episode: int) -> Path:
        """The description of an episode, counted from 0."""
        return self.root / EPISODES_TEMPLATE.format(**chunk_and_file(episode))

    def attempt(self, attempt_id: int) -> Path:
        """Our own record of an attempt."""
        return self.root / _attempt_name(attempt_id)

    def attempts(self) -> list[Path]:
        """Every attempt's record, by attempt id."""
        ours = self._ours("attempts/*/*", lambda _chunk, attempt_id: _attempt_name(attempt_id))
        return sorted(ours, key=attempt_id_of)

    def episodes(self) -> list[Path]:
        """Every description of an episode, in LeRobot's order."""
        return sorted(self._ours("meta/episodes/*/*", partial(_lerobot_name, EPISODES_TEMPLATE)))

    def frames(self) -> list[Path]:
        """Every file LeRobot takes frames from, in its order."""
        return sorted(self._ours("data/*/*", partial(_lerobot_name, DATA_TEMPLATE)))

    def _ours(self, pattern: str, name: Callable[[int, int], str]) -> list[Path]:
        """What `pattern` finds and bears the `name` that belongs to the numbers in it; the rest is passed over."""

        def is_ours(path: Path) -> bool:
            borne = f"{path.parent.name}/{path.name}"
            numbers = [int(digits) for digits in re.findall(r"\d+", borne)]
            return len(numbers) == 2 and name(*numbers).endswith(f"/{borne}")

        return only_ours(self.root, self.root.glob(pattern), is_ours)


def _attempt_name(attempt_id: int) -> str:
    return f"attempts/chunk-{attempt_id // CHUNK_FILES:03d}/attempt-{attempt_id:06d}.parquet"


def _lerobot_name(template: str, chunk_index: int, file_index: int) -> str:
    return template.format(chunk_index=chunk_index, file_index=file_index)


def chunk_and_file(episode: int) -> dict[str, int]:
    """The folder and file number of an episode, as LeRobot's path templates name them."""
    return {"chunk_index": episode // CHUNK_FILES, "file_index": episode % CHUNK_FILES}


def attempt_id_of(path: Path) -> int:
    """The attempt id in the name of an attempt's record."""
    return int(path.stem.removeprefix("attempt-"))
