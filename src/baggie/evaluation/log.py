"""A log of finished work that survives being killed: one JSON line each, on disk before the next begins."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from baggie.errors import DataError


def append_line(path: Path, record: dict[str, Any]) -> None:
    """Append one record and wait until it is on the disk."""
    with path.open("ab") as file:
        file.write((json.dumps(record, allow_nan=False) + "\n").encode())
        file.flush()
        os.fsync(file.fileno())


def read_lines(path: Path) -> list[dict[str, Any]]:
    """The records of a log, oldest first; none when there is no file.

    A last line without its end was being written when the process was killed: it is cut off the file, so
    that the next one starts on a line of its own. Raises `DataError` when any other line is no JSON.
    """
    if not path.exists():
        return []
    content = path.read_bytes()
    whole = content[: content.rfind(b"\n") + 1]
    if len(whole) < len(content):
        os.truncate(path, len(whole))
    records = []
    for number, line in enumerate(whole.splitlines(), start=1):
        try:
            records.append(json.loads(line))
        except ValueError:
            message = f"{path} line {number} is no JSON; remove that line, or the file to start again"
            raise DataError(message) from None
    return records
