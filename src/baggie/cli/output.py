"""Results on stdout: lines for people, or one JSON object for programs."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any


def show(result: Mapping[str, Any], as_json: bool) -> None:
    """Print the result of a command."""
    print(json.dumps(result, default=str) if as_json else "\n".join(_lines(result)))


def _lines(result: Mapping[str, Any], indent: str = "") -> list[str]:
    """A nested result as indented lines."""
    lines = []
    for key, value in result.items():
        name = str(key).replace("_", " ")
        if isinstance(value, Mapping) and any(isinstance(inner, Mapping) for inner in value.values()):
            lines += [f"{indent}{name}:", *_lines(value, indent + "  ")]
        elif isinstance(value, (list, tuple)) and len(value) > 12:
            lines.append(f"{indent}{name}: {len(value)} entries")
        else:
            lines.append(f"{indent}{name}: {_words(value)}")
    return lines


def _words(value: Any, digits: int = 3) -> str:
    """A value in short; the numbers of matrices with two more digits, the files have them all."""
    if isinstance(value, float):
        return f"{value:.{digits}g}"
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {_words(inner, digits)}" for key, inner in value.items()) or "none"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(_words(inner, 5) for inner in value) + "]" if value else "none"
    return str(value)
