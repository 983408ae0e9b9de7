"""What is logged of an evaluation's episodes, one JSON line each, on disk before the next begins: a kill loses none."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, BinaryIO, Self

from baggie.errors import DataError

LOG = "episodes.jsonl"
"""The file of finished episodes in an evaluation's folder."""
_OLD_LOG = "block-episodes.jsonl"
"""What earlier versions called it where a task had several steps."""

Numbers = tuple[float, ...]


@dataclass(frozen=True)
class Record:
    """Plain values that a line of the log says."""

    @classmethod
    def from_json(cls, record: Mapping[str, Any]) -> Self:
        """The inverse of `asdict`, from JSON. Raises `DataError` for a record of another version of baggie."""
        _check_keys({entry.name for entry in fields(cls)}, record)
        return cls(**{name: _tuples(value) for name, value in record.items()})


def _tuples(value: Any) -> Any:
    """A value of JSON with tuples for its lists, and for the lists in those."""
    return tuple(map(_tuples, value)) if isinstance(value, list) else value


def _check_keys(known: set[str], record: Mapping[str, Any]) -> None:
    if record.keys() != known:
        raise DataError(
            f"expected an episode as this version of baggie logs it, got one without {sorted(known - record.keys())} "
            f"and with {sorted(record.keys() - known)} besides; evaluate again into another folder"
        )


@dataclass(frozen=True)
class Step(Record):
    """One look, plan and motion. Actions are as in `PickPlace.to_array`, metres and radians."""

    planned: Numbers | None
    """None where the policy could not tell."""
    executed: Numbers | None
    """None where nothing was moved."""
    failure: str
    """What went wrong by the cell's or the policy's own account; empty when nothing did."""
    message: str
    decision_ms: float
    """Wall clock of the plan."""
    confidence: float
    reward: float | None = None
    """What Ravens counts of the task, all of it being 1; negative where something done was undone. None where the task
    has a goal in the picture.
    """
    pick_error_cm: float | None = None
    """From the planned pick to the object's middle in the picture that was planned from; None, as the next ones,
    without a plan or without a goal in the picture.
    """
    place_error_cm: float | None = None
    """From the planned place to the goal."""
    pick_yaw_error_deg: float | None = None
    """Modulo the turns that leave the object as it is."""
    pick_within_m: float | None = None
    """What the plan said of itself; None where it said nothing."""
    place_within_m: float | None = None


@dataclass(frozen=True)
class Landing(Record):
    """How far from its goal an object ended. Poses are (x, y, yaw), metres and radians."""

    start: Numbers
    goal: Numbers
    final: Numbers
    distance_cm: float
    """From the object's middle to the goal's."""
    yaw_error_deg: float
    """Modulo the turns that leave the object as it is."""


@dataclass(frozen=True)
class Credit(Record):
    """How much of a task's conditions was met."""

    partial_credit: float
    """The rewards' sum."""
    ravens_success: bool
    """Whether Ravens counts the whole task as done."""
    success: bool
    """Whether all conditions hold strictly, and still do two seconds later."""
    layers: tuple[bool, ...] = ()
    """Of a pattern of bags, whether each layer is right at the end, from below."""
    offsets_cm: tuple[tuple[float | None, ...], ...] = ()
    """Layer by layer, how far from its slot the bag in it ends; None where none fills it."""


@dataclass(frozen=True)
class Episode:
    """One scene and how it ended. All but the times depend on seed, cell and number alone."""

    episode: int
    """Its number."""
    steps: tuple[Step, ...]
    failure: str
    """Why it is no success, by the cell's or the policy's own account or, of a task without a goal in the picture,
    `ravens-only`, where Ravens counts it as one, or `unfinished`; empty when nothing went wrong.
    """
    message: str
    wall_s: float
    landing: Landing | None = None
    """Of a task with a goal in the picture."""
    credit: Credit | None = None
    """Of a task that itself says where things go."""

    def succeeded(self, radius_cm: float) -> bool:
        """Whether the task was done: strictly, or with the object within so many centimetres of its goal."""
        if self.credit is not None:
            return self.credit.success
        return self.landing is not None and self.landing.distance_cm <= radius_cm

    def to_json(self) -> dict[str, Any]:
        """The record as a line of the log says it."""
        return asdict(self)

    @classmethod
    def from_json(cls, record: Mapping[str, Any]) -> Self:
        """The inverse of `to_json`; also reads what earlier versions logged. Raises `DataError` for anything else."""
        record = _from_old(record)
        _check_keys({entry.name for entry in fields(cls)}, record)
        landing, credit = record["landing"], record["credit"]
        return cls(
            **{
                **record,
                "steps": tuple(Step.from_json(step) for step in record["steps"]),
                "landing": None if landing is None else Landing.from_json(landing),
                "credit": None if credit is None else Credit.from_json(_NO_LAYERS | credit),
            }
        )


_LANDING = {entry.name for entry in fields(Landing)}
_CREDIT = {"partial_credit", "ravens_success", "success"}
_NO_LAYERS: Mapping[str, Any] = {"layers": [], "offsets_cm": []}
"""What earlier versions did not log of a credit."""
_ENDED = {"episode", "failure", "message", "wall_s"}
_PLAN = {
    *("planned", "executed", "confidence", "pick_error_cm", "place_error_cm", "pick_yaw_error_deg"),
    *("pick_within_m", "place_within_m"),
}


def _from_old(record: Mapping[str, Any]) -> Mapping[str, Any]:
    """A record as this version has it: earlier ones had flat ones, for goals in the picture of the last look alone."""
    if not {"distance_cm", "partial_credit"} & record.keys():
        return record
    kept = {name: record.get(name) for name in _ENDED}
    if "partial_credit" in record:
        _check_keys(_ENDED | _CREDIT | {"steps"}, record)
        none = dict.fromkeys(_PLAN - {"planned", "executed", "confidence"})
        steps = [{**none, **step} for step in record["steps"]]
        return {**kept, "steps": steps, "landing": None, "credit": {name: record[name] for name in _CREDIT}}
    _check_keys(_ENDED | _LANDING | _PLAN | {"looks", "decision_ms"}, record)
    plan = {name: record[name] for name in _PLAN}
    missed = {
        **dict.fromkeys(_PLAN),
        "confidence": 0.0,
        "failure": "missed-grasp",
        "message": "",
        "reward": None,
    }
    steps = [{**missed, "decision_ms": ms} for ms in record["decision_ms"]]
    if steps:
        steps[-1] |= {**plan, "failure": record["failure"], "message": record["message"]}
    return {**kept, "steps": steps, "landing": {name: record[name] for name in _LANDING}, "credit": None}


def read_episodes(folder: Path) -> dict[int, Episode]:
    """The episodes logged in an evaluation's folder, by number. Raises `DataError`, naming the file."""
    found: dict[int, Episode] = {}
    for path in (folder / _OLD_LOG, folder / LOG):
        try:
            found |= {each.episode: each for each in map(Episode.from_json, read_lines(path))}
        except DataError as error:
            raise DataError(f"cannot use {path}: {error}") from None
    return found


def append_episode(folder: Path, episode: Episode) -> None:
    """Log an episode of an evaluation's folder; on return it is on the disk."""
    append_line(folder / LOG, episode.to_json())


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


def read_lines(path: Path) -> Sequence[dict[str, Any]]:
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
