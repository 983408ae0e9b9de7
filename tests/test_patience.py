"""What goes on after a fault, and what does not."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from baggie.collect.patience import PAUSES_S, Patience
from baggie.errors import ArmError, BaggieError, BumpedError, CameraError, DataError, ReachError, StuckError
from baggie.operator import Line
from helpers.scripted import Scripted

PAUSES = (1.0, 5.0, 15.0)


class Night:
    """Makes `wanted` attempts one by one; `faults[k]` errors come, one after another, before attempt k is finished."""

    def __init__(self, wanted: int, faults: dict[int, list[Exception]]) -> None:
        self.wanted, self.faults = wanted, {k: list(errors) for k, errors in faults.items()}
        self.done: list[int] = []
        self.person = Scripted()
        self.slept: list[float] = []

    def run(self) -> Iterator[int]:
        for attempt in range(len(self.done), self.wanted):
            if self.faults.get(attempt):
                raise self.faults[attempt].pop(0)
            yield attempt

    def collect(self, pauses_s: Sequence[float] = PAUSES) -> None:
        for attempt in Patience(self.person, pauses_s, self.slept.append).bear(self.run):
            self.done.append(attempt)


@given(st.lists(st.integers(0, len(PAUSES)), min_size=1, max_size=8))
def test_every_attempt_is_made_once_whatever_faults_come_between_if_not_too_many_in_a_row(
    counts: list[int],
) -> None:
    night = Night(len(counts), {k: [ArmError("link lost")] * count for k, count in enumerate(counts)})
    night.collect()
    assert night.done == list(range(len(counts)))
    assert night.slept == [pause for count in counts for pause in PAUSES[:count]], "an attempt is progress"
    assert len(night.person.told) == len(night.slept)


@given(st.integers(0, 5), st.sampled_from([ArmError, CameraError, ReachError]))
def test_too_many_in_a_row_end_it_with_one_line_that_begins_with_the_fault(
    at: int, kind: type[BaggieError]
) -> None:
    night = Night(9, {at: [kind("no picture")] * (len(PAUSES) + 1)})
    with pytest.raises(kind, match=r"^no picture\. Given up after 3 more tries .* the same command goes on$"):
        night.collect()
    assert night.done == list(range(at))


@pytest.mark.parametrize(
    "error",
    [
        StuckError("release the button"),
        BumpedError("bumped"),
        DataError("no space left"),
        KeyboardInterrupt(),
    ],
)
def test_what_takes_a_person_ends_it_at_once_as_it_is(error: BaseException) -> None:
    night = Night(3, {1: [error]})  # type: ignore[list-item]
    with pytest.raises(type(error)) as caught:
        night.collect()
    assert caught.value is error
    assert night.slept == []
    assert night.done == [0]


def test_where_there_is_no_patience_a_fault_stays_what_it_is() -> None:
    with pytest.raises(ReachError, match=r"^out of reach$"):
        Night(1, {0: [ReachError("out of reach")]}).collect(pauses_s=())


def test_the_pauses_grow_and_say_how_long_they_are() -> None:
    assert list(PAUSES_S) == sorted(set(PAUSES_S))
    night = Night(1, {0: [CameraError("frozen"), CameraError("frozen")]})
    night.collect()
    assert night.person.told == [Line(f"frozen. Trying again in {seconds} s") for seconds in (1, 5)]
