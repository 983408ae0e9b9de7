"""What must not get in a training's way: preparing data, Ctrl-C, numbers that are nearly nothing."""

from __future__ import annotations

import signal
import threading
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from types import FrameType
from typing import TypeVar

import torch

T = TypeVar("T")


def prefetched(make: Callable[[int], T], steps: range, workers: int = 1, ahead: int = 4) -> Iterator[T]:
    """`make(step)` for each step in order, made in threads of their own up to `ahead` steps early for each."""
    ahead *= workers
    with ThreadPoolExecutor(workers, "prefetch") as pool:
        coming = deque(pool.submit(make, step) for step in steps[:ahead])
        try:
            for step in steps:
                if step + ahead in steps:
                    coming.append(pool.submit(make, step + ahead))
                yield coming.popleft().result()
        finally:
            for future in coming:
                future.cancel()


@contextmanager
def deferred_interrupt() -> Iterator[threading.Event]:
    """Ctrl-C sets the event instead of breaking a step in half; a second one breaks. Main thread only."""
    asked = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield asked
        return

    def ask(number: int, frame: FrameType | None) -> None:
        asked.set()
        signal.signal(signal.SIGINT, before)

    before = signal.signal(signal.SIGINT, ask)
    try:
        yield asked
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def flushed_denormals() -> Iterator[None]:
    """Numbers below 1e-38 count as zero: a saturated softmax is full of them, and a CPU a hundred times
    slower.
    """
    torch.set_flush_denormal(True)
    try:
        yield
    finally:
        torch.set_flush_denormal(False)
