"""Stops the arm when the camera no longer sees what it does."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from baggie.errors import BaggieError, CameraError

PERIOD_S = 0.05


class BarkError(CameraError):
    """It was silent for too long: whatever moved has been stopped, and nothing moves."""


class Watchdog:
    """Looks after motions from a thread of its own."""

    def __init__(self, silent_s: Callable[[], float], limit_s: float, name: str = "the camera") -> None:
        """`silent_s` says for how long nothing was heard, of `name`; more than `limit_s` stops the arm."""
        self._silent_s, self._limit_s, self._name = silent_s, limit_s, name

    @contextmanager
    def watching(self, stop: Callable[[], None]) -> Iterator[None]:
        """While the block runs, call `stop` as soon as it has been silent for too long.

        Raises `BarkError` before the block where it is silent already, and after it where it was stopped, whatever the
        block itself raised because of that.
        """
        self._check()
        over, barked, stopped = threading.Event(), threading.Event(), threading.Event()

        def watch() -> None:
            while not over.wait(PERIOD_S):
                if self._silent_s() > self._limit_s:
                    barked.set()
                    with suppress(BaggieError):
                        stop()
                        stopped.set()
                    return

        thread = threading.Thread(target=watch, name="watchdog", daemon=True)
        thread.start()
        try:
            yield
        except BaggieError:
            if not barked.is_set():
                raise
        finally:
            over.set()
            thread.join()
        if barked.is_set():
            if not stopped.is_set():
                stop()  # it could not, from the thread: once more, where its error is heard
            raise self._error()

    def _check(self) -> None:
        if self._silent_s() > self._limit_s:
            raise BarkError(
                f"{self._name} has been silent for more than {self._limit_s:g} s; nothing was moved: check its cable"
            )

    def _error(self) -> BarkError:
        return BarkError(
            f"{self._name} was silent for more than {self._limit_s:g} s, so the arm was stopped; check its cable, and "
            "see what the arm holds"
        )
