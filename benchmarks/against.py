"""How much processor time a `baggie` command takes, beside the same command of an earlier commit.

    python benchmarks/against.py 43082ca training-pyramid --rounds 5 -- \\
        train --policy transporter --data recordings/pyramid --train 1 --val 0 --steps 320 --device cpu

Both run in turns, on one thread, each time into a folder of its own that is given as `--out`. Time is that of the
processor, of all the command's processes; memory is the largest of them. Writes docs/results/against-NAME.{json,md}.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from commands import write_and_show

HERE = Path(__file__).resolve().parents[1]
THIS = "this commit"


@dataclass(frozen=True)
class Options:
    """Run a command at two commits in turns."""

    commit: tyro.conf.Positional[str]
    """The earlier one."""
    name: tyro.conf.Positional[str]
    """Of what is compared, for the table's file."""
    command: tyro.conf.Positional[tuple[str, ...]]
    """Words after `baggie`, without `--out`; put `--` before them."""
    rounds: int = 5


def main(options: Options) -> None:
    """Compare, and write the table."""
    words = list(options.command)
    with earlier_commit(options.commit) as earlier, tempfile.TemporaryDirectory() as folder:
        sources = {options.commit: earlier, THIS: HERE}
        times: dict[str, list[tuple[float, float, float]]] = {name: [] for name in sources}
        for number in range(options.rounds):
            for name, source in sources.items():
                out = Path(folder) / f"{name.replace(' ', '-')}-{number}"
                times[name].append(measured(source, ["-m", "baggie", *words, "--out", str(out)]))
                print(f"round {number}, {name}: {times[name][-1][0]:.1f} s", file=sys.stderr, flush=True)
    rows = [row(name, np.array(values), np.array(times[options.commit])) for name, values in times.items()]
    notes = (
        f"`baggie {' '.join(words)}`, in turns, {options.rounds} times each, on one thread. Processor time of all the "
        "command's processes, starting included; the share is of the earlier commit's median."
    )
    write_and_show(f"against-{options.name}", f"A command beside commit {options.commit}", rows, notes)


@contextmanager
def earlier_commit(commit: str) -> Iterator[Path]:
    """A folder with the files of another commit, for as long as it is needed."""
    with tempfile.TemporaryDirectory() as folder:
        earlier = Path(folder) / "earlier"
        git("worktree", "add", "--detach", str(earlier), commit)
        try:
            yield earlier
        finally:
            git("worktree", "remove", "--force", str(earlier))


def measured(source: Path, words: list[str]) -> tuple[float, float, float]:
    """Processor seconds, seconds of the clock and peak megabytes of `python` and these words, with a folder's code."""
    environment = os.environ | {"PYTHONPATH": str(source / "src"), "OMP_NUM_THREADS": "1"}
    began = time.monotonic()
    process = subprocess.Popen(
        [sys.executable, *words],
        env=environment, cwd=HERE, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert process.stderr is not None
    said = process.stderr.read()
    _, status, used = os.wait4(process.pid, 0)
    if status != 0:
        sys.exit(f"python {' '.join(words)} failed in {source}:\n{said}")
    return used.ru_utime + used.ru_stime, time.monotonic() - began, used.ru_maxrss / 1024


def row(name: str, values: np.ndarray, before: np.ndarray) -> dict[str, Any]:
    """Of one commit `(rounds, 3)`, next to the earlier one's."""
    seconds = values[:, 0]
    return {
        "commit": name,
        "median (s)": round(float(np.median(seconds)), 1),
        "least (s)": round(float(seconds.min()), 1),
        "most (s)": round(float(seconds.max()), 1),
        "share": round(float(np.median(seconds) / np.median(before[:, 0])), 2),
        "clock (s)": round(float(np.median(values[:, 1])), 1),
        "peak memory (MB)": round(float(np.median(values[:, 2]))),
    }


def git(*words: str) -> None:
    """Run git here."""
    subprocess.run(["git", *words], cwd=HERE, check=True, stdout=subprocess.DEVNULL)


if __name__ == "__main__":
    main(tyro.cli(Options))
