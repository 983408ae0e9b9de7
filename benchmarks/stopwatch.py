"""How much processor time a function takes, summed up by name."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any


def timed(function: Callable[..., Any], name: str, spent: dict[str, float]) -> Callable[..., Any]:
    """The same function, whose processor time is added up under this name; itself, untimed, is its `__wrapped__`."""

    def run(*args: Any, **kwargs: Any) -> Any:
        start = time.process_time()
        result = function(*args, **kwargs)
        spent[name] += time.process_time() - start
        return result

    run.__wrapped__ = function  # type: ignore[attr-defined]
    return run
