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
        elif isinstance(value, Mapping):
            lines.append(f"{indent}{name}: " + ", ".join(f"{k} {_number(v)}" for k, v in value.items()))
        elif isinstance(value, (list, tuple)) and len(value) > 12:
            lines.append(f"{indent}{name}: {len(value)} entries")
        else:
            lines.append(f"{indent}{name}: {_number(value)}")
    return lines


def _number(value: Any) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)
