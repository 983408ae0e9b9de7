"""Where the files of a dataset lie.

    meta/info.json, meta/stats.json, meta/tasks.parquet
    meta/episodes/chunk-000/file-012.parquet      episode 12, as LeRobot describes it
    data/chunk-000/file-012.parquet               episode 12: its frames, as LeRobot reads them
    attempts/collection.json                      the settings this was collected with
    attempts/chunk-000/attempt-000123.parquet     attempt 123, exact and complete but for the picture before
    attempts/index.parquet                        the numbers of all attempts, gathered
    .baggie/                                      the writer's lock, and files not finished yet

Episodes, here LeRobot's, count in order of arrival; attempts carry the number they were given.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

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
        return self.root / f"attempts/chunk-{attempt_id // CHUNK_FILES:03d}/attempt-{attempt_id:06d}.parquet"

    def attempts(self) -> list[Path]:
        """Every attempt's record, by attempt id."""
        return sorted(self.root.glob("attempts/chunk-*/attempt-*.parquet"), key=attempt_id_of)

    def episodes(self) -> list[Path]:
        """Every description of an episode, in LeRobot's order."""
        return sorted(self.root.glob("meta/episodes/*/*.parquet"))

    def frames(self) -> list[Path]:
        """Every file LeRobot takes frames from, in its order."""
        return sorted(self.root.glob("data/*/*.parquet"))


def chunk_and_file(episode: int) -> dict[str, int]:
    """The folder and file number of an episode, as LeRobot's path templates name them."""
    return {"chunk_index": episode // CHUNK_FILES, "file_index": episode % CHUNK_FILES}


def attempt_id_of(path: Path) -> int:
    """The attempt id in the name of an attempt's record."""
    return int(path.stem.removeprefix("attempt-"))
