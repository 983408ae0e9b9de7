"""Results on stdout: lines for people, or one JSON object for programs."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console

from baggie.errors import WriteError

if TYPE_CHECKING:
    from baggie.commissioning.doctor import Finding


def show(result: Mapping[str, Any], as_json: bool) -> None:
    """Print the result of a command; its warnings where nobody overlooks them, too."""
    for warning in result.get("warnings", ()):
        print(f"warning: {warning}", file=sys.stderr)
    print(json.dumps(result, default=str) if as_json else "\n".join(_lines(result)))


def show_recording(found: tuple[Mapping[str, Any], WriteError | None], as_json: bool) -> None:
    """Print what is in a recording. Raises what there was in the way of its contact sheet."""
    summary, trouble = found
    show(summary, as_json)
    if trouble is not None:
        raise trouble


def show_page(page: Path, as_json: bool) -> None:
    """Print where a report is."""
    show({"report": str(page)}, as_json)


def show_findings(findings: Sequence[Finding], as_json: bool) -> None:
    """Print what the doctor found. Raises `BaggieError` where a check has failed."""
    from baggie.commissioning.doctor import as_table, require_healthy  # noqa: PLC0415 -- the doctor's verb alone

    if as_json:
        show({"findings": [asdict(finding) for finding in findings]}, as_json)
    else:
        Console().print(as_table(findings))
    require_healthy(findings)


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
