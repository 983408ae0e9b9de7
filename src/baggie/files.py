"""Small files written whole or not at all; text, YAML and JSON as people write them, read in one way everywhere."""

from __future__ import annotations

import codecs
import contextlib
import json
import re
import warnings
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import yaml

from baggie.errors import BaggieWarning, DataError, WriteError


def write_text(path: Path, text: str) -> None:
    """Write a text file, making its folder; a kill half-way leaves what was there before.

    Raises `WriteError` when it cannot be written.
    """
    write_bytes(path, text.encode())


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file, making its folder; a kill half-way leaves what was there before, and so does a full disk.

    Raises `WriteError` when it cannot be written.
    """
    with written_whole(path) as partial:
        partial.write_bytes(content)


@contextlib.contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """Give a name to write a file under, which is renamed to `path` at the end and removed when writing it failed.

    Raises `WriteError` when it cannot be written.
    """
    partial = path.with_name(path.name + ".partial")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield partial
        partial.replace(path)
    except OSError as error:
        raise WriteError(
            f"{path} cannot be written: {error.strerror}; free some space or mend the rights"
        ) from error
    finally:
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)


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


def read_text(path: Path) -> str:
    """A text in UTF-8, or in UTF-16 that says so. Raises `OSError`, or `DataError` for a file in anything else."""
    data = path.read_bytes()
    utf_16 = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    try:
        return data.decode("utf-16" if utf_16 else "utf-8-sig")
    except UnicodeDecodeError as error:
        line = data[: error.start].count(b"\n") + 1
        raise DataError(
            f"{path} is no text in UTF-8: byte 0x{data[error.start]:02x} in line {line} is none of its letters; "
            "save it as UTF-8"
        ) from None


def read_yaml(path: Path) -> Any:
    """The content of a YAML file. Raises as `read_text` and `parse_yaml` do."""
    return parse_yaml(read_text(path), path)


def parse_yaml(text: str, source: str | Path) -> Any:
    """The content of a YAML text from `source`: numbers where they are decimal, else what was written.

    So 0123, 12:30 and 2026-01-31 are text: neither octal, nor minutes, nor a date. Raises `DataError` for what is no
    YAML or has a key twice.
    """
    try:
        return yaml.load(text, _Loader)
    except yaml.MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else 1
        raise DataError(f"{source} is no YAML, line {line}: {error.problem}; mend it there") from None
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise DataError(f"{source} is no YAML: {' '.join(str(error).split())}; write it again") from None


def compose_yaml(text: str) -> yaml.Node | None:
    """The nodes of a YAML text that `parse_yaml` has taken: they know their lines, and what was written."""
    node: yaml.Node | None = yaml.compose(text, _Loader)
    return node


def read_json(path: Path) -> Any:
    """The content of a JSON file. Raises `OSError`, or `DataError` for what is no JSON or has a key twice."""
    try:
        return json.loads(read_text(path), object_pairs_hook=_each_once)
    except (ValueError, RecursionError) as error:
        raise DataError(f"{path} is no JSON: {error}; write it again") from None


def _each_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    content = dict(pairs)
    if len(content) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for key in keys if keys.count(key) > 1)
        raise ValueError(f"the key {twice!r} stands there twice")
    return content


class _Loader(yaml.SafeLoader):
    """PyYAML's, without the readings of YAML 1.1 that nobody means, and with every key once."""

    yaml_implicit_resolvers = {  # noqa: RUF012 -- PyYAML's own convention
        first: [
            (tag, pattern)
            for tag, pattern in resolvers
            if tag.rpartition(":")[2] not in {"int", "float", "timestamp"}
        ]
        for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }

    def compose_mapping_node(self, anchor: Any) -> yaml.MappingNode:
        """A mapping, whose keys are told apart before merging makes them one."""
        node = super().compose_mapping_node(anchor)
        seen: set[tuple[str, Any]] = set()
        for key, _ in node.value:
            name = (key.tag, key.value)
            if isinstance(key, yaml.ScalarNode) and name in seen:
                problem = f"the key {key.value!r} stands there twice"
                raise yaml.composer.ComposerError(None, None, problem, key.start_mark)
            seen |= {name} if isinstance(key, yaml.ScalarNode) else set()
        return node


_Loader.add_implicit_resolver("tag:yaml.org,2002:int", re.compile(r"-?(?:0|[1-9]\d*)$"), list("-0123456789"))
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"[-+]?(?:\d+\.\d*|\.\d+)(?:[eE][-+]?\d+)?$|[-+]?\.(?:inf|Inf|INF)$|\.(?:nan|NaN|NAN)$"),
    list("-+.0123456789"),
)
