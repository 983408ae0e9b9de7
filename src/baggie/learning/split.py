"""Which attempts teach and which measure: by a rule, before anything is trained."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from baggie.data.annotation import is_demonstration
from baggie.errors import DataError
from baggie.types import Attempt, Observation

RULE = "successful attempts with a goal in the picture, by attempt id: the first train, the next measure"


@dataclass(frozen=True)
class Split:
    """Attempts with the picture before only; all else that is large is left behind."""

    train: list[Attempt]
    val: list[Attempt]

    @classmethod
    def of(cls, attempts: Sequence[Attempt], train: int, val: int) -> Split:
        """By `RULE`. Raises `DataError` when there are too few attempts, or they are from different cells or
        cameras.
        """
        if train < 1 or val < 0:
            raise DataError(f"train must be at least 1 and val at least 0, got {train} and {val}")
        chosen: list[Attempt] = []
        for attempt in attempts:
            if len(chosen) == train + val:
                break
            if is_demonstration(attempt):
                chosen.append(replace(attempt, before=Observation(attempt.before.color), after=None))
        if len(chosen) < train + val:
            raise DataError(
                f"training on {train} and measuring on {val} attempts needs {train + val} that succeeded, "
                "but the "
                f"recording has {len(chosen)}: collect more, or lower --train or --val"
            )
        check_alike(chosen)
        return cls(chosen[:train], chosen[train:])


def check_alike(attempts: Sequence[Attempt]) -> None:
    """Raise `DataError` when attempts are from different cells or cameras."""
    for what, values in (
        ("cells", {attempt.cell for attempt in attempts}),
        ("picture sizes", {attempt.before.size for attempt in attempts}),
    ):
        if len(values) > 1:
            raise DataError(
                f"a policy belongs to one cell and camera, but the recording mixes {what} "
                f"{sorted(values)}: "
                "collect each into its own folder"
            )
