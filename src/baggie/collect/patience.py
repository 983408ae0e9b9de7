"""Patience with what interrupts a collection.

Faults of arm and camera are waited out, up to a limit. Of trouble that neither the collector nor its cell can mend a
person is asked; where none is, the collection waits for one.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Self, TypeVar

from baggie.errors import ArmError, CameraError, NobodyError, ReachError, StuckError
from baggie.operator import Answer, Event, Line, Operator, Question

LOOK_AGAIN_S = 30.0


@dataclass
class Awaited:
    """An operator for whom is waited where nobody is there to be asked."""

    operator: Operator
    wait_s: float
    """How long to wait for somebody to come where nobody is there."""
    can_help: bool = True
    """Whether a person can; in a simulated workcell nobody can."""
    sleep: Callable[[float], None] = time.sleep
    clock: Callable[[], float] = time.monotonic
    _until: float = field(default=math.inf, init=False)
    """When the wait that has begun is over."""

    @property
    def attended(self) -> bool:
        """Whether somebody is there who can help."""
        return self.can_help and self.operator.attended

    def tell(self, event: Event) -> None:
        """Pass it on."""
        self.operator.tell(event)

    def ask(self, question: Question[Answer]) -> Answer:
        """What somebody answers; where nobody is there, what nothing stands for, after some of the wait.

        For another look tells whether somebody came. Raises `NobodyError` when the wait is over.
        """
        if self.attended:
            return self.operator.ask(question)
        if self._until == math.inf:
            self._until = self.clock() + self.wait_s
            if self.wait_s > 0:
                waiting = f"Waiting {self.wait_s / 60:g} minutes for somebody to help"
                self.tell(Line(f"{question.text}. {waiting}"))
        left = self._until - self.clock()
        if left <= 0:
            raise NobodyError(f"nobody came: {question.text}")
        self.sleep(min(left, LOOK_AGAIN_S))
        return question.meaning("")

    def worked(self) -> None:
        """Take note that all is well again: the next trouble has a wait of its own."""
        self._until = math.inf


PAUSES_S = (1.0, 5.0, 15.0, 30.0, 60.0, 120.0)
"""Before each try in a row that follows a fault; a fault after the last of them ends it all."""
T = TypeVar("T")


@dataclass(frozen=True)
class Patience:
    """Begins again, later each time, whatever arm or camera interrupted."""

    operator: Operator
    """Is told before every pause."""
    pauses_s: Sequence[float] = PAUSES_S
    sleep: Callable[[float], None] = time.sleep

    @classmethod
    def for_cell(cls, operator: Operator, *, simulated: bool) -> Self:
        """As much as a workcell takes: none with a simulated one, where the same fault comes again."""
        return cls(operator, () if simulated else PAUSES_S)

    def bear(self, run: Callable[[], Iterable[T]]) -> Iterator[T]:
        """What `run()` gives; it is called again for what is still missing whenever arm or camera fail.

        Whatever comes is progress, and pauses are short again. A fault that no pause is left for is raised, in one
        line; at once is `StuckError`, which only a person can do something about, and every other error.
        """
        tries = 0
        while True:
            try:
                for result in run():
                    tries = 0
                    yield result
                return
            except StuckError:
                raise
            except (ArmError, CameraError, ReachError) as error:
                if tries == len(self.pauses_s):
                    raise type(error)(_given_up(error, tries)) from None
                self.operator.tell(Line(f"{error}. Trying again in {self.pauses_s[tries]:.0f} s"))
                self.sleep(self.pauses_s[tries])
                tries += 1


def _given_up(error: Exception, tries: int) -> str:
    if tries == 0:
        return str(error)
    return (
        f"{error}. Given up after {tries} more tries in a row that came to nothing; what was recorded is safe, and the "
        "same command goes on"
    )
