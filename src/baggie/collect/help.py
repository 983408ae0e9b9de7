"""Trouble that neither the collector nor its cell can mend: ask a person; where none is, wait for one.

This is not `patience.py`, which waits out faults of arm and camera: those mend themselves, or end the collection.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from baggie.collect.cell import Ask

LOOK_AGAIN_S = 30.0


@dataclass
class Help:
    """Waits for a person."""

    ask: Ask | None
    """Asks somebody at the terminal; None where nobody is there."""
    wait_s: float
    """How long to wait for somebody to come where nobody is there."""
    say: Callable[[str], None]
    """Gets one line when such a wait begins."""
    sleep: Callable[[float], None] = time.sleep
    clock: Callable[[], float] = time.monotonic
    _until: float = field(default=math.inf, init=False)
    """When the wait that has begun is over."""

    def helped(self, trouble: str) -> bool:
        """Whether it is worth another look: a person has helped; or some time of the wait has passed."""
        if self.ask is not None:
            return self.ask(trouble)
        if self._until == math.inf:
            self._until = self.clock() + self.wait_s
            if self.wait_s > 0:
                self.say(f"{trouble}. Waiting {self.wait_s / 60:g} minutes for somebody to help")
        left = self._until - self.clock()
        if left <= 0:
            return False
        self.sleep(min(left, LOOK_AGAIN_S))
        return True

    def worked(self) -> None:
        """Take note that all is well again: the next trouble has a wait of its own."""
        self._until = math.inf
