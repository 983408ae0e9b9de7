"""How long Transporter Networks take to learn and to decide: ours beside the published sizes, on one thread.

    python benchmarks/transporter.py [--rounds 15] [--paper-rounds 3]

One map of 320 x 160 pixels, 36 rotations, a suction cup. A step is a batch of one made, forward, backward, Adam; a
decision goes from an observation to a plan. Each preset runs in a process of its own, for its peak memory. Times are
those of the processor, which a busy machine lengthens less than the clock's. Writes docs/results/transporter.{json,md}.
"""

from __future__ import annotations

import argparse
import multiprocessing
import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from baggie.options.values import Preset

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import cv2
import numpy as np
import torch

from baggie.geometry import Grid
from baggie.learning.loop import flushed_denormals
from baggie.learning.transporter import TransporterOptions, TransporterRecipe
from baggie.types import Observation
from commands import spread_ms, write_and_show
from helpers.box_scenes import box_demonstrations

GRID = Grid()
WARM_UP = 2


class Times(NamedTuple):
    """Of one preset."""

    parameters: int
    step_s: np.ndarray
    decision_s: np.ndarray
    decide_mb: float
    """Peak memory of the process before it first learned, beyond what it had when it began."""
    learn_mb: float


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--paper-rounds", type=int, default=3)
    asked = parser.parse_args()
    rounds: dict[Preset, int] = {"fast": asked.rounds, "paper": asked.paper_rounds}
    rows = []
    for preset, count in rounds.items():
        with multiprocessing.get_context("spawn").Pool(1) as pool:
            times = pool.apply(measure, (preset, count))
        for what, seconds, megabytes in (
            ("decision", times.decision_s, times.decide_mb),
            ("step", times.step_s, times.learn_mb),
        ):
            rows.append(
                {
                    "preset": preset,
                    "parameters": times.parameters,
                    "what": what,
                    "rounds": count,
                    **spread_ms(1000 * seconds),
                    "peak memory (MB)": round(megabytes),
                }
            )
    notes = (
        "One map of 320 x 160 pixels, 36 rotations, a suction cup, one thread. A step is a batch of one made, forward, "
        "backward, Adam; a decision goes from an observation to a plan. Processor time; peak memory of the process "
        "beyond what it had when it began, for decisions before it first learned."
    )
    write_and_show("transporter", "Transporter Networks, ours beside the published sizes", rows, notes)


def measure(preset: Preset, rounds: int) -> Times:
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    torch.manual_seed(0)
    shown = box_demonstrations(4, 0, grid=GRID)
    began_mb = peak_mb()
    recipe = TransporterRecipe(shown, TransporterOptions(preset, batch=1))
    network = recipe.policy.network
    seen = Observation(shown.colors[0], grid=GRID, height=shown.heights[0])
    with flushed_denormals():
        decision_s = timed(lambda: recipe.policy.plan(seen), rounds)
        decide_mb = peak_mb() - began_mb
        optimizer, rng = recipe.optimizer(), np.random.default_rng(0)

        def step() -> None:
            network.train()
            loss, _ = recipe.loss(network, recipe.batch(rng))
            loss.backward()
            optimizer.step()
            optimizer.zero_grad()

        step_s = timed(step, rounds)
    parameters = sum(parameter.numel() for parameter in network.parameters())
    return Times(parameters, step_s, decision_s, decide_mb, peak_mb() - began_mb)


def timed(run: Callable[[], object], rounds: int) -> np.ndarray:
    seconds = []
    for turn in range(min(WARM_UP, rounds) + rounds):
        began = time.process_time()
        run()
        if turn >= min(WARM_UP, rounds):
            seconds.append(time.process_time() - began)
    return np.array(seconds)


def peak_mb() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


if __name__ == "__main__":
    main()
