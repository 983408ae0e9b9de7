"""What an unattended collection does about faults of arm and camera: wait, begin again, give up in the end."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TypeVar

from baggie.errors import ArmError, CameraError, ReachError, StuckError

PAUSES_S = (1.0, 5.0, 15.0, 30.0, 60.0, 120.0)
"""Before each try in a row that follows a fault; a fault after the last of them ends it all."""
T = TypeVar("T")


@dataclass(frozen=True)
class Patience:
    """Begins again, later each time, whatever arm or camera interrupted."""

    say: Callable[[str], None]
    """Gets one line before every pause."""
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
                self.say(f"{error}. Trying again in {self.pauses_s[tries]:.0f} s")
                self.sleep(self.pauses_s[tries])
                tries += 1


def _given_up(error: Exception, tries: int) -> str:
    if tries == 0:
        return str(error)
    return (
        f"{error}. Given up after {tries} more tries in a row that came to nothing; what was recorded is safe, and the "
        "same command goes on"
    )
