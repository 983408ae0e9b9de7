"""Results that can be traced: where a number came from stands beside it, in JSON and as a Markdown table."""

from __future__ import annotations

import json
import os
import platform
import shlex
import subprocess
import sys
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TypedDict

from baggie.errors import BaggieError
from baggie.files import write_text

PACKAGES = ("baggie", "mujoco", "torch", "numpy", "opencv-python-headless", "pyarrow", "franky-sim", "mink")
"""What a number may depend on."""


TRAINING, VALIDATION, EVALUATION = "config.yaml", "predictions.json", "evaluation.json"
"""The file by which a folder of results of each kind is told."""
_MARKS = {TRAINING: "a training", VALIDATION: "a validation", EVALUATION: "an evaluation"}


class Provenance(TypedDict):
    """What is needed to measure again."""

    command: str
    seeds: list[int]
    commit: str | None
    """None outside git; ends in `+` when files differed from the commit."""
    machine: dict[str, str | int | None]
    date: str
    """ISO 8601, UTC."""
    python: str
    packages: dict[str, str]


def provenance(seeds: Sequence[int] = ()) -> Provenance:
    """The running command, its seeds, the commit, the machine, the date, and the versions below it."""
    return {
        "command": _command(),
        "seeds": list(seeds),
        "commit": _commit(),
        "machine": {
            "cpu": _cpu_model(),
            "cores": os.cpu_count() or 1,
            "gpu": _gpu_model(),
            "system": platform.system(),
        },
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "python": platform.python_version(),
        "packages": {name: found for name in PACKAGES if (found := _version(name)) is not None},
    }


def write_results(
    stem: Path, title: str, rows: Sequence[Mapping[str, object]], origin: Provenance, notes: str = ""
) -> tuple[Path, Path]:
    """Write `stem.json` and `stem.md`: a table of `rows` (keys, with units, are the columns) and its origin.

    Numbers keep full precision in the JSON and get four significant digits in the table. Returns both paths.
    """
    json_path, markdown_path = (stem.with_name(stem.name + suffix) for suffix in (".json", ".md"))
    content = {"title": title, "rows": [dict(row) for row in rows], "notes": notes, "provenance": origin}
    write_text(json_path, json.dumps(content, indent=2) + "\n")
    lines = [f"- {key}: {f'`{value}`' if key == 'command' else value}" for key, value in origin_lines(origin)]
    parts = [f"# {title}", _table(rows), notes, "\n".join(lines)]
    write_text(markdown_path, "\n\n".join(part for part in parts if part) + "\n")
    return json_path, markdown_path


def check_unmixed(folder: Path, own: str) -> None:
    """Raise `BaggieError` where a folder holds results of another kind than those that the file `own` tells of.

    Each kind has a `metrics.json`, and the later one would replace the earlier one's.
    """
    for mark, what in _MARKS.items():
        if mark != own and (folder / mark).exists():
            raise BaggieError(
                f"{folder} holds {what}, whose metrics.json would be lost; give --out a folder of its own, such as "
                f"{folder / 'more'}"
            )


def write_json(path: Path, content: object) -> None:
    """Write strict JSON (no NaN) whole or not at all."""
    write_text(path, json.dumps(content, indent=2, allow_nan=False) + "\n")


def _table(rows: Sequence[Mapping[str, object]]) -> str:
    columns = list(dict.fromkeys(key for row in rows for key in row))
    lines = [columns, ["---"] * len(columns)]
    lines += [[_cell(row.get(column, "")) for column in columns] for row in rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def _cell(value: object) -> str:
    text = f"{value:.4g}" if isinstance(value, float) else str(value)
    return text.replace("|", "\\|")


def origin_lines(origin: Provenance) -> list[tuple[str, str]]:
    """What to print of it: names and values."""
    machine = origin["machine"]
    parts = [machine["cpu"], f"{machine['cores']} cores", machine.get("gpu"), machine["system"]]
    packages = ", ".join(f"{name} {number}" for name, number in origin["packages"].items())
    return [
        ("command", origin["command"]),
        ("seeds", ", ".join(map(str, origin["seeds"])) or "none"),
        ("commit", origin["commit"] or "not in git"),
        ("machine", ", ".join(str(part) for part in parts if part)),
        ("date", origin["date"]),
        ("versions", f"Python {origin['python']}, {packages}"),
    ]


def _command() -> str:
    """The command as a person would type it: no path of this machine's interpreter or entry points."""
    program = Path(sys.argv[0])
    if program.suffix != ".py":
        return shlex.join([program.name, *sys.argv[1:]])
    if program.is_absolute() and program.is_relative_to(Path.cwd()):
        program = program.relative_to(Path.cwd())
    return shlex.join(["python", str(program), *sys.argv[1:]])


def _commit() -> str | None:
    def git(*words: str) -> str:
        command = ["git", "-C", str(Path(__file__).parent), *words]
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=10).stdout.strip()

    try:
        commit = git("rev-parse", "HEAD")
        return commit + "+" if git("status", "--porcelain", "--untracked-files=no") else commit
    except (OSError, subprocess.SubprocessError):
        return None


def _cpu_model() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def _gpu_model() -> str | None:
    """The GPU that PyTorch finds here, in a program that has loaded it: results without it do not wait for that."""
    torch = sys.modules.get("torch")
    return torch.cuda.get_device_name() if torch is not None and torch.cuda.is_available() else None


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None
