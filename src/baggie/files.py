"""Small files, written whole or not at all."""

from __future__ import annotations

from pathlib import Path

from baggie.errors import DataError


def write_text(path: Path, text: str) -> None:
    """Write a text file, making its folder; a kill half-way leaves what was there before.

    Raises `DataError` when it cannot be written.
    """
    partial = path.with_name(path.name + ".partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial.write_text(text)
        partial.replace(path)
    except OSError as error:
        raise DataError(
            f"{path} cannot be written: {error.strerror}; free some space or mend the rights"
        ) from error
