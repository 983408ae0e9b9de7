"""What the experiments share: running `baggie` commands, and putting what was measured into tables."""

from __future__ import annotations

import json
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike


ENDS_WITH_US = ["setpriv", "--pdeathsig", "TERM"] if shutil.which("setpriv") else []


def start(words: list[str], **options: Any) -> subprocess.Popen[str]:
    """A `baggie` command as a process that does not outlive this one."""
    return subprocess.Popen([*ENDS_WITH_US, sys.executable, "-m", "baggie", *words], text=True, **options)


def run(command: str) -> None:
    """A `baggie` command, shown before it runs; ends the experiment with its exit status where it fails."""
    from baggie.cli.main import DONE  # noqa: PLC0415 -- worker processes import this file
    from baggie.cli.main import main as baggie  # noqa: PLC0415

    print(f"$ baggie {command}", file=sys.stderr)
    status = baggie(shlex.split(command))
    if status != DONE:
        sys.exit(status)


def read(folder: Path) -> dict[str, Any]:
    """The metrics in a folder."""
    return dict(json.loads((folder / "metrics.json").read_text()))


def spread(summary: dict[str, float]) -> str:
    """Mean and worst."""
    return f"{summary['mean']:.2f} ({summary['max']:.2f})"


def rate(success: dict[str, float]) -> str:
    """A success rate with its interval."""
    return f"{100 * success['rate']:.0f}% of {success['n']} ({100 * success['low']:.0f} to {100 * success['high']:.0f})"


def failures(metrics: dict[str, Any]) -> str:
    """What failed, and how often."""
    return ", ".join(f"{n} {cause}" for cause, n in metrics["failures"].items())


def spread_ms(ms: ArrayLike) -> dict[str, float]:
    """Median, quartiles, fastest and slowest of some times."""
    names = ("fastest", "lower quartile", "median", "upper quartile", "slowest")
    return {
        f"{name} (ms)": float(value)
        for name, value in zip(names, np.percentile(ms, (0, 25, 50, 75, 100)), strict=True)
    }


def write_and_show(name: str, title: str, rows: list[dict[str, Any]], notes: str) -> None:
    """Write docs/results/NAME.{json,md}, and print the latter."""
    from baggie.results import provenance, write_results  # noqa: PLC0415 -- as above

    _, table = write_results(Path("docs/results") / name, title, rows, provenance(), notes)
    print(table.read_text())
