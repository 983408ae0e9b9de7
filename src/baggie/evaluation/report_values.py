"""Plain values for the report's template: figures, pictures, times."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from pathlib import Path
from typing import Any

Content = dict[str, Any]

_MIME = {".jpg": "image/jpeg", ".png": "image/png", ".mp4": "video/mp4"}


def figure(title: str, svg: str, note: str) -> Content:
    """A chart with its title and what to say below it."""
    return {"title": title, "svg": svg, "note": note}


def ms(milliseconds: float) -> str:
    """A decision's time in words."""
    return "below 1 ms" if milliseconds < 1 else f"{milliseconds:.0f} ms"


def duration(seconds: float) -> str:
    """A training's time in words."""
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.1f} minutes"


def data_uris(paths: Sequence[Path]) -> list[str]:
    """Of the files there are."""
    return [data_uri(path) for path in paths if path.exists()]


def data_uri(path: Path) -> str:
    """A picture or video as part of the page."""
    return embedded(path.read_bytes(), path.suffix)


def embedded(content: bytes, suffix: str) -> str:
    """The same from what a file with this suffix would hold."""
    return f"data:{_MIME[suffix]};base64,{base64.b64encode(content).decode()}"


def percent(rate: dict[str, Any]) -> str:
    """A `Rate` in words."""
    return f"{100 * rate['rate']:.0f}%"


def in_numbers(rate: dict[str, Any]) -> str:
    """A `Rate` as a count: `97 of 100`."""
    return f"{round(rate['rate'] * rate['n'])} of {rate['n']}"


def with_interval(rate: dict[str, Any]) -> str:
    """The same with its 95% interval: `97 of 100 (92 to 99%)`."""
    return f"{in_numbers(rate)} ({100 * rate['low']:.0f} to {100 * rate['high']:.0f}%)"
