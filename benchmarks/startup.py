"""How much processor time it takes until a command is there, beside an earlier commit.

    python benchmarks/startup.py d74ea4a --rounds 11

Help, completion, and what only reads a file or draws a page; both commits in turns, on one thread, after one round that
does not count. Writes docs/results/startup.{json,md}.
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from against import HERE, THIS, earlier_commit, measured
from commands import write_and_show

COMMANDS = {
    "import numpy": ["-c", "import numpy"],
    "import baggie": ["-c", "import baggie"],
    **{
        f"baggie {words}": ["-m", "baggie", *words.split()]
        for words in (
            "--help",
            "collect --help",
            "train --policy transporter --help",
            "--tyro-print-completion bash",
            "inspect RECORDING",
            "workcell show CELL",
            "print-target board --out PDF",
        )
    },
}
"""What follows `python`; words in capitals stand for files."""


@dataclass(frozen=True)
class Options:
    """Measure how long commands take to start, at two commits in turns."""

    commit: tyro.conf.Positional[str]
    """The earlier one."""
    rounds: int = 11


def main(options: Options) -> None:
    """Measure, and write the table."""
    with earlier_commit(options.commit) as earlier, tempfile.TemporaryDirectory() as folder:
        files = make_files(Path(folder))
        sources = {options.commit: earlier, THIS: HERE}
        times: dict[tuple[str, str], list[float]] = {(c, name): [] for c in COMMANDS for name in sources}
        for number in range(options.rounds + 1):
            for (command, name), spent in times.items():
                words = [files.get(word, word) for word in COMMANDS[command]]
                seconds, *_ = measured(sources[name], words)
                if number:  # the first writes what Python compiles, and warms the caches of files
                    spent.append(seconds)
            print(f"round {number} of {options.rounds}", file=sys.stderr, flush=True)
    notes = (
        f"Processor time of all of a command's processes, in turns, {options.rounds} times each, on one thread, files "
        "in memory. The recording has 2 attempts, the workcell file is of a Franka arm."
    )
    rows = [row(command, *(np.array(times[command, name]) for name in sources)) for command in COMMANDS]
    write_and_show("startup", f"Until a command is there, beside commit {options.commit}", rows, notes)


def make_files(folder: Path) -> dict[str, str]:
    """What the words in capitals stand for."""
    recording, cell = folder / "recording", folder / "cell.yaml"
    measured(HERE, ["-m", "baggie", "collect", "--attempts", "2", "--workers", "1", "--out", str(recording)])
    cell.write_text("arm: {kind: franka, host: 172.16.0.2}\ncamera: 0\n")
    return {"RECORDING": str(recording), "CELL": str(cell), "PDF": str(folder / "board.pdf")}


def row(command: str, before: np.ndarray, now: np.ndarray) -> dict[str, Any]:
    """Seconds `(rounds,)` of both commits: medians, each with the fastest and the slowest."""
    return {
        "command": f"`{command}`",
        "before (s)": spread(before),
        "now (s)": spread(now),
        "share": round(float(np.median(now) / np.median(before)), 2),
    }


def spread(seconds: np.ndarray) -> str:
    """The median, and from the fastest to the slowest."""
    return f"{np.median(seconds):.2f} ({seconds.min():.2f} to {seconds.max():.2f})"


if __name__ == "__main__":
    main(tyro.cli(Options))
