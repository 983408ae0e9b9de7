"""Folders in the layout of the Ravens benchmark (Zeng et al., "Transporter Networks", CoRL 2020), read and written.

    action/000000-9000.pkl    a list of {"pose0": (xyz, xyzw), "pose1": (xyz, xyzw)}, and a last None
    color/000000-9000.pkl     `(S + 1, 3, 480, 640, 3)` uint8 RGB
    depth/000000-9000.pkl     `(S + 1, 3, 480, 640)` float32 metres
    info/000000-9000.pkl      a list of dicts by object: (position, rotation, dimensions)
    reward/000000-9000.pkl    a list of numbers

for the episode 0 with the seed 9000. They are pickles, which are read without running them.

A pickle is a program, and `pickle.load` calls whatever it names. The way out is the one of Python's documentation
("Restricting Globals"): names are looked up by us. The few by which numpy stores arrays are known here, and even they
stand for objects of our own that check every part, so a file can neither reach numpy's `dtype` and `ndarray` nor
change them. A file made for it can still use up memory or the C stack and so end the process; it cannot do anything.
"""

from __future__ import annotations

import contextlib
import math
import pickle
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baggie.data.files import write_all
from baggie.errors import DataError, WriteError
from baggie.files import only_ours
from baggie.ravens.episode import (
    FIELDS,
    RAVENS_CAMERAS,
    RavensAction,
    RavensEpisode,
    RavensObject,
    RavensPose,
    checked_episode,
    planar_to_pose,
    pose_to_planar,
)

_OLD_NUMPY, _NEW_NUMPY = "numpy.core.multiarray", "numpy._core.multiarray"
_DTYPES = frozenset({"b1", "u1", "u2", "u4", "u8", "i1", "i2", "i4", "i8", "f2", "f4", "f8"})
_MAX_DEPTH = 16
"""Of containers in containers; also what ends a list that contains itself."""


def load_plain(path: Path) -> object:
    """What a pickle holds: None, bools, numbers, strings, bytes, arrays, and tuples, lists and dicts of them.

    Arrays are of bools or numbers and read-only: they are the bytes that were read, not a copy. Keys are strings or
    whole numbers. Raises `DataError` when the file is missing, cut off or damaged, or holds anything else, in which
    case nothing of it has been run.
    """
    try:
        with open(path, "rb") as stream:
            return _plain(_PlainUnpickler(stream).load(), _MAX_DEPTH, {})
    except OSError as error:
        raise DataError(
            f"{path} cannot be read: {error.strerror}; mend its path or rights, or put it back from a copy"
        ) from None
    except _RefusedError as refused:
        raise DataError(
            f"{path} holds {refused}, but only arrays, numbers, strings, tuples, lists and dicts are expected: "
            "nothing of it was run; get it again from where you trust it"
        ) from None
    except Exception:  # garbage can make the pickle machine raise anything at all
        raise DataError(
            f"{path} is cut off or damaged, or no pickle: put it back from a copy, or get it again"
        ) from None


def plain_bytes(value: object) -> bytes:
    """Plain data as a pickle that `load_plain` reads, and `pickle.load` under numpy 1 as well as 2.

    `value` may hold what `load_plain` returns. numpy 2 would name its module `numpy._core`, which numpy before 1.26
    does not have; the old name `numpy.core` is known to both.
    """
    # Protocol 3 has neither frames nor lengths around a name, which comes once and before the first array's bytes.
    content = pickle.dumps(value, protocol=3)
    return content.replace(f"c{_NEW_NUMPY}\n".encode(), f"c{_OLD_NUMPY}\n".encode(), 1)


class _RefusedError(Exception):
    """A pickle asked for something that is not plain data; the message says what."""


class _Global:
    """Stands for one of numpy's names: a file can call it, as far as `make` allows, and do nothing else to it."""

    __slots__ = ("_make",)

    def __init__(self, make: Callable[..., object]) -> None:
        self._make = make

    def __call__(self, *arguments: object) -> object:
        return self._make(*arguments)

    def __setstate__(self, state: object) -> None:
        raise _RefusedError("a change to numpy itself")


class _Dtype:
    """What `numpy.dtype(code, False, True)` leaves in a pickle, and then its state, of which the byte order counts."""

    __slots__ = ("value",)

    def __init__(self, code: object, *_: object) -> None:
        if not isinstance(code, str) or code not in _DTYPES:
            kind = _shown(code) if isinstance(code, str) else "unknown kind"
            raise _RefusedError(f"values of {kind}, which are no plain numbers")
        self.value: np.dtype[Any] = np.dtype(code)

    def __setstate__(self, state: object) -> None:
        match state:
            case (3, "<" | ">" | "=" | "|" as order, None, None, None, -1, -1, 0):
                self.value = self.value.newbyteorder(order)
            case _:
                raise _RefusedError("an array of fields or objects")


class _Array:
    """What `_reconstruct(ndarray, (0,), b"b")` leaves in a pickle, and then its state, which is the array."""

    __slots__ = ("value",)

    def __init__(self, kind: object, *_: object) -> None:
        if kind is not _NDARRAY:
            raise _RefusedError("an array of another class than numpy.ndarray")
        self.value: NDArray[Any] | None = None

    def __setstate__(self, state: object) -> None:
        match state:
            case (1, tuple() as shape, _Dtype() as dtype, bool() as by_columns, bytes() as raw):
                self.value = _array(raw, shape, dtype, by_columns)
            case _:
                raise _RefusedError("an array of objects, or one stored in an unknown way")


def _array(raw: bytes, shape: tuple[Any, ...], dtype: _Dtype, by_columns: bool = False) -> NDArray[Any]:
    sizes = [size for size in shape if type(size) is int and size >= 0]
    if len(sizes) != len(shape) or math.prod(sizes) * dtype.value.itemsize != len(raw):
        raise _RefusedError("an array whose shape does not fit its bytes")
    return np.ndarray(shape, dtype.value, raw, order="F" if by_columns else "C")


def _scalar(dtype: object, raw: object) -> object:
    if not isinstance(dtype, _Dtype) or not isinstance(raw, bytes):
        raise _RefusedError("a scalar object")
    return _array(raw, (), dtype).item()


def _no_call(*_: object) -> object:
    raise _RefusedError("an array that is made in an unknown way")


_NDARRAY = _Global(_no_call)
_GLOBALS = {("numpy", "ndarray"): _NDARRAY, ("numpy", "dtype"): _Global(_Dtype)} | {
    (module, name): _Global(make)
    for module in (_OLD_NUMPY, _NEW_NUMPY)
    for name, make in (("_reconstruct", _Array), ("scalar", _scalar))
}


class _PlainUnpickler(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> object:
        try:
            return _GLOBALS[module, name]
        except KeyError:
            raise _RefusedError(f"the name {_shown(f'{module}.{name}')}") from None


def _plain(value: object, depth: int, done: dict[int, object]) -> object:
    """Give a value with arrays in place of what stands for them; `done` keeps shared parts from being done again."""
    if value is None or isinstance(value, bool | int | float | str | bytes):
        return value
    if id(value) not in done:
        done[id(value)] = _plain_container(value, depth, done)
    return done[id(value)]


def _plain_container(value: object, depth: int, done: dict[int, object]) -> object:
    if depth == 0:
        raise _RefusedError(f"containers nested more than {_MAX_DEPTH} deep")
    match value:
        case _Array(value=np.ndarray() as array):
            return array
        case list():
            return [_plain(item, depth - 1, done) for item in value]
        case tuple():
            return tuple(_plain(item, depth - 1, done) for item in value)
        case dict():
            for key in value:
                if not isinstance(key, str | int):
                    raise _RefusedError("a dict with keys other than strings and whole numbers")
            return {key: _plain(item, depth - 1, done) for key, item in value.items()}
        case _Array() | _Dtype() | _Global():
            raise _RefusedError("a part of an array by itself")
        case _:
            raise _RefusedError(f"a {type(value).__name__}")


def _shown(text: str) -> str:
    """Show a value on one line, and short, whatever a hostile file wrote."""
    return ascii(text[:80])


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
    """Give an episode by field, as Ravens' own code stores it."""
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
