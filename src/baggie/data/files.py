"""Writing so that a kill, a power cut or a full disk loses nothing; reading that names a broken file."""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from baggie.errors import DataError

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


def read_json(path: Path) -> Any:
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
