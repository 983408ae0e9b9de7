"""A log of finished work that survives being killed: one JSON line each, on disk before the next begins."""

from __future__ import annotations

import json
import os
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, BinaryIO, Self, TypeVar

from baggie.errors import DataError


@dataclass(frozen=True)
class Record:
    """What a line of a log says."""

    def to_json(self) -> dict[str, Any]:
        """For the log."""
        return asdict(self)

    @classmethod
    def from_json(cls, record: dict[str, Any]) -> Self:
        """The inverse of `to_json`. Raises `DataError` for a record of another version of baggie."""
        own = {entry.name for entry in fields(cls)}
        if record.keys() != own:
            raise DataError(
                f"expected an episode as this version of baggie logs it, got one without {sorted(own - record.keys())} "
                f"and with {sorted(record.keys() - own)} besides; evaluate again into another folder"
            )
        return cls(**{k: tuple(v) if isinstance(v, list) else v for k, v in record.items()})


Kept = TypeVar("Kept", bound=Record)


def read_log(path: Path, kind: type[Kept]) -> list[Kept]:
    """The records of a log, oldest first; none where there is no log. Raises `DataError`, naming it, as above."""
    try:
        return [kind.from_json(record) for record in read_lines(path)]
    except DataError as error:
        raise DataError(f"cannot use {path}: {error}") from None


def append_line(path: Path, record: dict[str, Any]) -> None:
    """Append one record and wait until it is on the disk.

    A last line without its end was being written when a process was killed: it is cut off first, so that this one
    starts on a line of its own.
    """
    with path.open("a+b") as file:
        if file.tell() and _last_byte(file) != b"\n":
            file.seek(0)
            file.truncate(file.read().rfind(b"\n") + 1)
        file.write((json.dumps(record, allow_nan=False) + "\n").encode())
        file.flush()
        os.fsync(file.fileno())


def _last_byte(file: BinaryIO) -> bytes:
    file.seek(-1, os.SEEK_END)
    return file.read()


def read_lines(path: Path) -> list[dict[str, Any]]:
    """The records of a log, oldest first; none when there is no file.

    A last line without its end is left out: it is being written, or was when the process was killed. Nothing is
    changed. Raises `DataError` when any other line is no JSON.
    """
    if not path.exists():
        return []
    content = path.read_bytes()
    whole = content[: content.rfind(b"\n") + 1]
    records = []
    for number, line in enumerate(whole.splitlines(), start=1):
        try:
            records.append(json.loads(line))
        except ValueError:
            message = f"{path} line {number} is no JSON; remove that line, or the file to start again"
            raise DataError(message) from None
    return records
