"""Demonstrations of the block tasks per second, on one thread: without pictures, and with a height map at each step.

    OMP_NUM_THREADS=1 python benchmarks/block_demonstrations.py

A demonstration is a fresh scene and as many picks and places of the scripted demonstrator as it takes, with the arm
parked before each picture and a last one at the end. "Ravens" and "strict" count those that succeed by either score;
the two seconds that the strict one waits are not timed. Processor time, so that a busy machine counts less.
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from unittest.mock import patch

import numpy as np

import baggie.sim  # noqa: F401  # before MuJoCo, which looks for an OpenGL library as soon as it is imported

# isort: split
import mujoco

from baggie.sim.depth_cameras import DepthRenderer
from baggie.sim.kinematics import Kinematics
from baggie.sim.tasks import TASKS
from baggie.workcell import height_map_camera
from baggie.workcell.block_workcell import BlockWorkcell, open_block_workcell
from stopwatch import timed

SEED = 0xB10C
PARTS = ("physics", "inverse kinematics", "rendering", "fusing")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--demonstrations", type=int, default=10, help="of each task, with and without pictures"
    )
    number = parser.parse_args().demonstrations
    spent: defaultdict[str, float] = defaultdict(float)
    print("| task | height maps | per second | median s | quartiles s | steps | Ravens | strict |", end=" ")
    print(" | ".join(f"{part} s" for part in (*PARTS, "other")), "|")
    print("|" + "---|" * (8 + len(PARTS) + 1))
    with stopwatches(spent):
        for task in TASKS:
            for pictures in (False, True):
                cell = open_block_workcell(task, pictures=pictures)
                demonstrate(cell, number, pictures)  # the first warms up
                spent.clear()
                rows = [demonstrate(cell, seed, pictures) for seed in range(number)]
                cell.close()
                print_row(task, pictures, rows, spent)


def demonstrate(cell: BlockWorkcell, seed: int, pictures: bool) -> tuple[float, int, bool, bool]:
    """One demonstration: seconds, steps, success by Ravens' score and strictly."""
    start = time.process_time()
    cell.reset([SEED, seed])
    steps = 0
    while steps < cell.task.max_steps and (action := cell.demonstrate()) is not None:
        if pictures:
            cell.look()
        cell.execute(action)
        cell.count()
        steps += 1
    if pictures:
        cell.look()
    seconds = time.process_time() - start
    with patch.object(mujoco, "mj_step", mujoco.mj_step.__wrapped__):
        return seconds, steps, cell.score.done, cell.strict_success()


def print_row(
    task: str, pictures: bool, rows: list[tuple[float, int, bool, bool]], spent: dict[str, float]
) -> None:
    seconds, steps, ravens, strict = (np.array(column) for column in zip(*rows, strict=True))
    parts = [spent.get(part, 0.0) / len(rows) for part in PARTS]
    parts.append(float(seconds.mean()) - sum(parts))
    low, median, high = np.percentile(seconds, [25, 50, 75])
    print(
        f"| {task} | {'yes' if pictures else 'no'} | {1 / seconds.mean():.2f} | {median:.2f} | "
        f"{low:.2f} to {high:.2f} | "
        f"{steps.mean():.1f} | {ravens.sum()} of {len(rows)} | {strict.sum()} of {len(rows)} | "
        + " | ".join(f"{part:.2f}" for part in parts)
        + " |",
        flush=True,
    )


@contextmanager
def stopwatches(spent: dict[str, float]) -> Iterator[None]:
    """Within: the processor time of each part is added up under its name."""
    with (
        patch.object(mujoco, "mj_step", timed(mujoco.mj_step, "physics", spent)),
        patch.object(Kinematics, "line", timed(Kinematics.line, "inverse kinematics", spent)),
        patch.object(DepthRenderer, "look", timed(DepthRenderer.look, "rendering", spent)),
        patch.object(height_map_camera, "fuse", timed(height_map_camera.fuse, "fusing", spent)),
    ):
        yield


if __name__ == "__main__":
    main()
