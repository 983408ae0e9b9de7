"""A dataset's files and settings, writing that no kill or full disk spoils, reading that names a broken file.

    meta/info.json, meta/stats.json, meta/tasks.parquet
    meta/episodes/chunk-000/file-012.parquet      episode 12, as LeRobot describes it
    data/chunk-000/file-012.parquet               episode 12: its frames, as LeRobot reads them
    attempts/collection.json                      the settings this was collected with
    attempts/chunk-000/attempt-000123.parquet     attempt 123, exact and complete but for the picture before
    attempts/index.parquet                        the numbers of all attempts, gathered
    .baggie/                                      the writer's lock, and files not finished yet

Episodes, here LeRobot's, count in order of arrival; attempts carry the number they were given. A file of another name,
or in another place than its number's, is not ours: it is passed over and stays. What a dataset was collected with is
fixed when it is begun, and checked when it is continued.
"""

from __future__ import annotations

import fcntl
import json
import os
import re
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from baggie.errors import BaggieWarning, DataError
from baggie.files import only_ours

_MAGIC = b"PAR1"
"""The first and the last four bytes of every complete parquet file."""


def parquet_bytes(table: pa.Table) -> bytes:
    """A table as a parquet file in memory, uncompressed: nearly all of it is PNGs.

    Each row is a group of its own, so that with more rows the first ones stay where they are in the file.
    """
    sink = pa.BufferOutputStream()
    pq.write_table(
        table, sink, compression="none", use_dictionary=False, write_statistics=False, row_group_size=1
    )
    return bytes(sink.getvalue())


def json_bytes(value: Any, indent: int | None = None) -> bytes:
    """A value as JSON in memory."""
    return json.dumps(value, indent=indent, ensure_ascii=False).encode()


def write_all(files: Sequence[tuple[Path, bytes | pa.Buffer]], partial: Path) -> None:
    """Write files so that each is there complete or not at all, the last of them only if all others are.

    All are first written to the folder `partial` (on the same file system) and flushed to the disk; only then
    are they renamed to their places, in the order given. A full disk therefore leaves everything as it was.
    Raises OSError.
    """
    partial.mkdir(parents=True, exist_ok=True)
    staged = [(partial / f"{number}-{path.name}", path) for number, (path, _) in enumerate(files)]
    try:
        for (temporary, _), (_, content) in zip(staged, files, strict=True):
            with open(temporary, "wb") as stream:
                stream.write(content)
                stream.flush()
                os.fsync(stream.fileno())
        for _, path in staged:
            path.parent.mkdir(parents=True, exist_ok=True)
        for temporary, path in staged:
            os.replace(temporary, path)
    except OSError:
        for temporary, _ in staged:
            temporary.unlink(missing_ok=True)
        raise
    for folder in {path.parent for _, path in staged}:
        _sync_folder(folder)


def remove(paths: Iterable[Path]) -> None:
    """Delete files, and see to it that they stay deleted after a power cut."""
    folders = set()
    for path in paths:
        path.unlink(missing_ok=True)
        folders.add(path.parent)
    for folder in folders:
        _sync_folder(folder)


def _sync_folder(folder: Path) -> None:
    """Flush renames and deletions in a folder to the disk."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


class Lock:
    """An exclusive lock on a dataset, held until `release` or the end of the process, however it ends."""

    def __init__(self, path: Path) -> None:
        """Take the lock. Raises DataError when another writer holds it."""
        path.parent.mkdir(parents=True, exist_ok=True)
        self._stream = open(path, "wb")  # noqa: SIM115 - it stays open as long as the lock is held
        try:
            fcntl.flock(self._stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self._stream.close()
            root = path.parent.parent
            raise DataError(
                f"{root} is being recorded into already: wait for that to end or take another folder"
            ) from None

    @property
    def released(self) -> bool:
        """Whether `release` was called."""
        return self._stream.closed

    def release(self) -> None:
        """Let others write; harmless when done already."""
        self._stream.close()


def broken(path: Path, what: str) -> DataError:
    """The error for a file that cannot be used, with what to do about it."""
    return DataError(f"{path} {what}: put it back from a copy, or collect again into another folder")


def read_complete_json(path: Path) -> Any:
    """The content of a JSON file. Raises DataError when it is missing or cut off."""
    try:
        return json.loads(path.read_bytes())
    except FileNotFoundError:
        raise broken(path, "is missing") from None
    except ValueError:
        raise broken(path, "is cut off or damaged") from None
    except OSError as error:
        raise DataError(f"{path} cannot be read: {error.strerror}") from None


def check_complete(paths: Iterable[Path]) -> None:
    """Raise DataError for the first parquet file that is missing or cut off; costs microseconds a file."""
    for path in paths:
        try:
            with open(path, "rb") as stream:
                stream.seek(-min(len(_MAGIC), path.stat().st_size), os.SEEK_END)
                complete = stream.read() == _MAGIC
        except FileNotFoundError:
            raise broken(path, "is missing") from None
        except OSError as error:
            raise DataError(f"{path} cannot be read: {error.strerror}") from None
        if not complete:
            raise broken(path, "is cut off")


def read_parquet(path: Path, columns: Sequence[str] | None = None) -> pa.Table:
    """Columns (leaves may be named, `a.b`) of a parquet file. Raises DataError when missing or damaged."""
    try:
        # One small file at a time: pyarrow's own threads cost more here than they save.
        with pq.ParquetFile(path, memory_map=True) as file:
            return file.read(columns=columns, use_threads=False)
    except FileNotFoundError:
        raise broken(path, "is missing") from None
    except (pa.ArrowException, OSError) as error:
        raise broken(path, f"is cut off or damaged ({_first_line(error)})") from None


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]


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


_LATER = frozenset({"workcell"})
"""What older recordings do not say of how they were collected: it is taken to be the same."""
PHYSICS = "physics"
"""Which physics of soft things a simulated recording was made with: a number that rises with every change."""
_FIRST_PHYSICS = 1
_ANY_ROBOT = frozenset({"python", "lerobot"})
"""What older recordings say of an arm of one's own or LeRobot's: its name is taken to be the same."""
FORMAT = "baggie-attempts-1"
"""The layout of `attempts/`; changes when a reader of the old one would misread the new."""


@dataclass(frozen=True)
class DatasetSettings:
    """What is the same for all attempts of a dataset."""

    task: str
    """The instruction in words."""
    robot_type: str
    picture_size: tuple[int, int]
    """`(width, height)` of the recorded pictures, pixels."""
    collection: Mapping[str, Any]
    """The collector's own settings: seed, cell, colour of the object, ... as JSON has them."""

    @classmethod
    def make(
        cls, task: str, robot_type: str, picture_size: tuple[int, int], collection: Mapping[str, Any]
    ) -> DatasetSettings:
        """Settings as they read back from disk. Raises DataError where JSON cannot hold them."""
        try:
            plain = json.loads(json.dumps(dict(collection)))
        except TypeError as error:
            raise DataError(f"a dataset's collection settings must be JSON: {error}") from None
        width, height = picture_size
        return cls(task, robot_type, (int(width), int(height)), plain)

    def to_json(self) -> dict[str, Any]:
        """The content of `collection.json`."""
        return {"format": FORMAT, **asdict(self)}

    @classmethod
    def read(cls, layout: Layout) -> DatasetSettings:
        """The settings of a dataset on disk. Raises DataError where there is none."""
        _check_is_dataset(layout)
        content = read_complete_json(layout.collection)
        if not isinstance(content, dict) or content.get("format") != FORMAT:
            raise DataError(
                f"{layout.root} is written in another format than {FORMAT}: "
                "read it with the version of baggie that wrote it"
            )
        try:
            size = tuple(content["picture_size"])
            return cls.make(content["task"], content["robot_type"], (size[0], size[1]), content["collection"])
        except (KeyError, IndexError, TypeError):
            raise broken(layout.collection, "is damaged") from None

    def check_same(self, other: DatasetSettings, root: Path) -> None:
        """Raise DataError saying what differs from `other`, the settings asked for now; other physics only warn."""
        mine, theirs = _flat(self), _flat(other)
        before, now = mine.pop(PHYSICS, _FIRST_PHYSICS), theirs.pop(PHYSICS, _FIRST_PHYSICS)
        if before != now:
            warnings.warn(
                f"{root} was begun with other simulated physics ({before}, now {now}): what comes is as good, but not "
                "what the same seed gave then; record into another folder where that matters",
                BaggieWarning,
                stacklevel=2,
            )
        for key in sorted(mine.keys() | theirs.keys()):
            recorded, asked = mine.get(key), theirs.get(key)
            older = (key in _LATER and key not in mine) or (key == "robot_type" and recorded in _ANY_ROBOT)
            if recorded != asked and not older:
                raise DataError(
                    f"{root} was recorded with {key} = {recorded!r}, not {asked!r}: "
                    "go on with the same settings, or record into another folder"
                )


def _flat(settings: DatasetSettings) -> dict[str, Any]:
    fixed = {"task": settings.task, "robot_type": settings.robot_type, "picture_size": settings.picture_size}
    return {**settings.collection, **fixed}


def _check_is_dataset(layout: Layout) -> None:
    if layout.collection.exists():
        return
    root = layout.root
    if not root.exists():
        raise DataError(
            f"there is no dataset at {root}: the folder does not exist; `baggie collect` makes one"
        )
    if layout.info.exists():
        raise DataError(
            f"{root} is a LeRobot dataset without `attempts/`: baggie reads only what it recorded itself; "
            "give the folder the recording was made in"
        )
    raise DataError(f"{root} holds no dataset; `baggie collect --out {root}` makes one")
