"""Small files, written whole or not at all; and what lies among ours without being ours."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Callable, Iterable
from pathlib import Path

from baggie.errors import BaggieWarning, WriteError


def write_text(path: Path, text: str) -> None:
    """Write a text file, making its folder; a kill half-way leaves what was there before.

    Raises `WriteError` when it cannot be written.
    """
    write_bytes(path, text.encode())


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file, making its folder; a kill half-way leaves what was there before, and so does a full disk.

    Raises `WriteError` when it cannot be written.
    """
    partial = path.with_name(path.name + ".partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial.write_bytes(content)
        partial.replace(path)
    except OSError as error:
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)
        raise WriteError(
            f"{path} cannot be written: {error.strerror}; free some space or mend the rights"
        ) from error


def write_if_possible(path: Path, write: Callable[[Path], object]) -> bool:
    """Call `write(path)` for a file that nothing depends on; whether it is there now.

    Where it cannot be written, that is a warning.
    """
    try:
        write(path)
    except WriteError as error:
        warnings.warn(str(error), BaggieWarning, stacklevel=2)
        return False
    return True


def only_ours(root: Path, found: Iterable[Path], is_ours: Callable[[Path], bool]) -> list[Path]:
    """The paths that are ours, of those `found` below `root`; the others are named in a warning, on one line.

    A file manager leaves copies, a Mac `._*` beside every file, a program that keeps folders alike its conflicts. None
    of it is read, and none of it is touched: it may be the only copy of something.
    """
    ours: list[Path] = []
    others: list[Path] = []
    for path in found:
        (ours if is_ours(path) else others).append(path)
    if others:
        first = min(others).relative_to(root)
        more = f" and {len(others) - 1} more" if len(others) > 1 else ""
        warnings.warn(
            f"passed over in {root}: {first}{more}; move away what does not belong there",
            BaggieWarning,
            stacklevel=2,
        )
    return ours
