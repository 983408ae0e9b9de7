"""A sitting: ten attempts one after another from a fresh scene.

Attempts `10 k .. 10 k + 9` depend on the seed, the cell and k alone, so any process may run any sitting, and
one that was interrupted is run again from its start and gives the same attempts.

Faults of arm and camera mend themselves, or end the collection: they are waited out, up to a limit. Of trouble that
neither the collector nor its cell can mend a person is asked; where none is, the collection waits for one.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np

from baggie import seeds
from baggie.calibration.image_to_robot.map import ImageToRobot
from baggie.collect.cell import CollectorCell
from baggie.collect.machine import Turn, helped, run_turn, stopped
from baggie.data.record import fit, without_depth
from baggie.errors import ArmError, CameraError, NobodyError, ReachError, StuckError
from baggie.geometry import FloatArray
from baggie.operator import Answer, Event, Line, Operator, Question
from baggie.options.values import CollectedStyle
from baggie.types import Attempt, Truth
from baggie.vision.color_mask import Detection

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


ATTEMPTS_PER_SITTING = 10
STALL_AFTER = 5
"""Attempts in a row without a success before a person is asked."""


@dataclass(frozen=True)
class Recording:
    """What all sittings of one collection have in common."""

    instruction: str
    """The task in words."""
    seed: int
    cell: int
    size: tuple[int, int]
    """`(width, height)` of the recorded pictures, pixels."""
    style: CollectedStyle = "plain"
    """Of whoever demonstrates."""
    depth: bool = False
    """Whether pictures are recorded with the depth that their camera may measure."""


def run_sitting(
    cell: CollectorCell,
    image_to_robot: ImageToRobot,
    recording: Recording,
    number: int,
    *,
    operator: Operator,
    first: int = 0,
) -> Iterator[Attempt]:
    """The ten attempts of one sitting, or those from `first` on, one by one as they are finished, failed ones too.

    `operator` is asked for help when the cell cannot help itself. Raises `Stopped` when nobody helps.
    """
    cell.reset((seeds.COLLECTION, recording.seed, number))
    begun_at = (first,) if first else ()  # or places would be the first ones over again
    rng = seeds.generator(seeds.PLACES, recording.seed, number, *begun_at)
    doubted = rescued = False
    failures = 0
    for index in range(first, ATTEMPTS_PER_SITTING):
        time = cell.clock()
        turn = run_turn(Turn(cell, image_to_robot, rng, operator, doubted_before=doubted))
        doubted = turn.doubted
        attempt = as_attempt(turn, recording, number * ATTEMPTS_PER_SITTING + index, time)
        yield attempt
        failures = 0 if attempt.outcome.success else failures + 1
        if attempt.outcome.failure == "stalled" or failures >= STALL_AFTER:
            trouble = _stall(attempt, failures, turn.trouble)
            helps_itself = not rescued and cell.rescue()
            if not (helps_itself or helped(operator, trouble)):
                raise stopped(trouble)
            rescued, failures = rescued or helps_itself, 0


def _stall(attempt: Attempt, failures: int, trouble: str) -> str:
    if attempt.outcome.failure == "stalled":
        return (
            f"after attempt {attempt.attempt_id} the object is still where it was, though the gripper held "
            "something; check that the camera is live and the gripper free"
        )
    failed = f"{failures} attempts in a row failed, the last one ({attempt.attempt_id}) with {attempt.outcome.failure}"
    if attempt.outcome.failure == "unreachable":
        return f"{failed}: {trouble}"
    return f"{failed}; check the gripper, the calibration and the object's colour"


def as_attempt(turn: Turn, recording: Recording, attempt_id: int, time: float) -> Attempt:
    """A finished turn as a record, its pictures and boxes at the recorded size."""
    assert turn.before is not None
    assert turn.action is not None
    assert turn.outcome is not None
    assert turn.after is not None
    truth_after = turn.cell.truth()
    attempt = Attempt(
        attempt_id=attempt_id,
        task=recording.instruction,
        before=turn.before,
        after=turn.after,
        commanded=turn.action,
        outcome=turn.outcome,
        box_before=_box(turn.found),
        box_after=_box(turn.found_after),
        cell=recording.cell,
        seed=recording.seed,
        time=time,
        object_symmetry=turn.cell.settings.object_symmetry,
        truth=Truth(turn.truth_before, truth_after) if turn.truth_before and truth_after else None,
    )
    return fit(attempt if recording.depth else without_depth(attempt), recording.size)


def _box(found: Detection | None) -> FloatArray:
    """`(4, 2)` corners, NaN where nothing was found."""
    return np.full((4, 2), np.nan) if found is None else found.corners
