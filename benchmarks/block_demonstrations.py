"""Demonstrations of the block tasks per second, on one thread: without pictures, and with a height map at each step.

    OMP_NUM_THREADS=1 python benchmarks/block_demonstrations.py

A demonstration is a fresh scene and as many picks and places of the scripted demonstrator as it takes, with the arm
parked before each picture and a last one at the end. "Ravens" and "strict" count those that succeed by either score;
the two seconds that the strict one waits are not timed. Processor time, so that a busy machine counts less. Writes
docs/results/block-demonstrations.{json,md}.
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from unittest.mock import patch

import numpy as np

import baggie.sim  # noqa: F401  # before MuJoCo, which looks for an OpenGL library as soon as it is imported

# isort: split
import mujoco

from baggie.cameras import camera as height_map_camera
from baggie.registry import TASKS
from baggie.robot.kinematics import Kinematics
from baggie.sim.renderer import DepthRenderer
from baggie.tasks.conditions import Score, strict_success
from baggie.workcell.simulated import SimulatedWorkcell, open_simulated
from commands import write_and_show
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
    rows = []
    with stopwatches(spent):
        for task in TASKS.names():
            for pictures in (False, True):
                cell = open_simulated(0, task, pictures=pictures)
                demonstrate(cell, number, pictures)  # the first warms up
                spent.clear()
                shown = [demonstrate(cell, seed, pictures) for seed in range(number)]
                cell.close()
                rows.append(
                    {"task": task, "height maps": "yes" if pictures else "no", **summed(shown, spent)}
                )
    notes = (
        "One thread, processor time. A demonstration is a fresh scene and as many picks and places as it takes, with "
        "height maps one before each step and one at the end. The last columns say where its seconds go."
    )
    write_and_show("block-demonstrations", "Demonstrations of the block tasks", rows, notes)


def demonstrate(cell: SimulatedWorkcell, seed: int, pictures: bool) -> tuple[float, int, bool, bool]:
    """One demonstration: seconds, steps, success by Ravens' score and strictly."""
    start = time.process_time()
    cell.reset([SEED, seed])
    score, steps = Score(cell.scene.conditions), 0
    while steps < cell.task.max_steps and (action := cell.demonstrate()) is not None:
        if pictures:
            cell.look()
        cell.execute(action)
        score.count(cell.state())
        steps += 1
    if pictures:
        cell.look()
    seconds = time.process_time() - start
    with patch.object(mujoco, "mj_step", mujoco.mj_step.__wrapped__):
        return seconds, steps, score.done, strict_success(cell.scene.conditions, cell)


def summed(shown: list[tuple[float, int, bool, bool]], spent: dict[str, float]) -> dict[str, Any]:
    """What many demonstrations say together."""
    seconds, steps, ravens, strict = (np.array(column) for column in zip(*shown, strict=True))
    parts = {part: spent.get(part, 0.0) / len(shown) for part in PARTS}
    parts["other"] = float(seconds.mean()) - sum(parts.values())
    low, median, high = np.percentile(seconds, [25, 50, 75])
    return {
        "per second": round(1 / float(seconds.mean()), 2),
        "median (s)": round(float(median), 2),
        "quartiles (s)": f"{low:.2f} to {high:.2f}",
        "steps": round(float(steps.mean()), 1),
        "Ravens": f"{ravens.sum()} of {len(shown)}",
        "strict": f"{strict.sum()} of {len(shown)}",
        **{f"{part} (s)": round(each, 2) for part, each in parts.items()},
    }


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
