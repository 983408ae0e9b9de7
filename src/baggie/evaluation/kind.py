"""What differs between kinds of tasks in the closed loop; all else is in `closed_loop.py`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from rich.console import Console

from baggie.evaluation.log import Record
from baggie.evaluation.options import EvaluateOptions


@dataclass(frozen=True)
class EpisodeRecord(Record):
    """What every kind of episode is logged with."""

    episode: int
    """Its number: all but the times in a record depend on this, the seed and the cell alone."""


Bench = TypeVar("Bench")
Episode = TypeVar("Episode", bound=EpisodeRecord)


@dataclass(frozen=True)
class Kind(Generic[Bench, Episode]):
    """How one kind of task is tried, episode by episode. All are functions of a module: worker processes need them."""

    log: str
    """The file of finished episodes; a report tells by it what a folder holds."""
    episode: type[Episode]
    open_bench: Callable[[EvaluateOptions], Bench]
    """A cell and the policy in it; called once in each process."""
    run: Callable[[Bench, int, EvaluateOptions], Episode]
    """One episode, by its number."""
    measure: Callable[[Sequence[Episode], EvaluateOptions], dict[str, Any]]
    """What many episodes say together; `success` first."""
    note: Callable[[Episode], str]
    """How one ended, beside the progress bar."""
    conditions: Callable[[EvaluateOptions, Console], dict[str, Any]] | None = None
    """What else an evaluation differs by than task, policy, cell and seed; warns of what may surprise."""
    prepare: Callable[[EvaluateOptions, Console], None] | None = None
    """What has to be done once, before any process opens a bench."""
