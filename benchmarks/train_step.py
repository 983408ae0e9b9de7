"""How long one training step takes: ours beside the published recipe.

    python benchmarks/train_step.py

One step: batch made, forward, backward, optimizer; nothing prefetched. One thread, then two. Then the training loop as
it is, which makes batches in a thread of its own: how long a step takes there, and how busy the cores are. Writes
docs/results/train-step.{json,md}.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import cv2
import numpy as np
import torch

from baggie.learning.keypoint import KeypointRecipe
from baggie.learning.loop import Recipe, flushed_denormals, prefetched
from baggie.learning.regression import RegressionRecipe
from commands import spread_ms, write_and_show
from helpers.synthetic import make_attempt

ROUNDS = 15
ATTEMPTS = 20
LOOPED = "keypoint, batch 8"


def main() -> None:
    cv2.setNumThreads(1)
    attempts = [make_attempt(i, np.random.default_rng(i), (640, 360), depth=False) for i in range(ATTEMPTS)]
    recipes: dict[str, Recipe] = {
        LOOPED: KeypointRecipe(attempts),
        "regression, batch 1": RegressionRecipe(attempts, "solid", (0, 200, 0), None),
    }
    rows: list[dict[str, Any]] = []
    with flushed_denormals():
        for threads in (1, 2):
            torch.set_num_threads(threads)
            for name, ms in measure({name: stepper(recipe) for name, recipe in recipes.items()}).items():
                steps = recipes[name].steps
                minutes = float(np.median(ms)) * steps / 60_000
                row = {
                    "recipe": name,
                    "threads": threads,
                    **spread_ms(ms),
                    "steps": steps,
                    "minutes": minutes,
                }
                if name == LOOPED:
                    step_ms, batch_ms, busy = in_the_loop(recipes[name])
                    row |= {
                        "ms a step with batches made beside": step_ms,
                        "ms to make a batch": batch_ms,
                        "cores busy": f"{busy:.0%} of 2",
                        "minutes so": step_ms * steps / 60_000,
                    }
                rows.append(row)
    notes = f"Milliseconds a step, on recordings of 640 x 360; {ROUNDS} rounds, interleaved."
    write_and_show("train-step", "How long a training step takes", rows, notes)


def stepper(recipe: Recipe) -> Callable[[], None]:
    optimizer, network = recipe.optimizer(), recipe.policy.network.train()
    rng = np.random.default_rng(0)

    def step() -> None:
        loss, _ = recipe.loss(network, recipe.batch(rng))
        loss.backward()
        optimizer.step()
        optimizer.zero_grad()

    return step


def in_the_loop(recipe: Recipe, steps: int = 40) -> tuple[float, float, float]:
    """Milliseconds a step, milliseconds to make a batch, and the share of two cores' time that was used."""
    rng, started = np.random.default_rng(0), time.perf_counter()
    for _ in range(ROUNDS):
        recipe.batch(rng)
    batch_ms = 1000 * (time.perf_counter() - started) / ROUNDS
    optimizer, network = recipe.optimizer(), recipe.policy.network.train()
    wall, cpu = 0.0, 0.0
    for number, batch in enumerate(
        prefetched(lambda step: recipe.batch(np.random.default_rng(step)), range(steps))
    ):
        if number == 5:  # the first ones warm up
            wall, cpu = time.perf_counter(), time.process_time()
        loss, _ = recipe.loss(network, batch)
        loss.backward()
        optimizer.step()
        optimizer.zero_grad()
    seconds = time.perf_counter() - wall
    return 1000 * seconds / (steps - 5), batch_ms, (time.process_time() - cpu) / seconds / 2


def measure(steps: dict[str, Callable[[], None]]) -> dict[str, np.ndarray]:
    """Milliseconds of each round, interleaved, so that a busy moment hits all alike."""
    times: dict[str, list[float]] = {name: [] for name in steps}
    for turn in range(ROUNDS + 2):
        for name, step in steps.items():
            start = time.perf_counter()
            step()
            if turn >= 2:  # the first ones warm up
                times[name].append(1000 * (time.perf_counter() - start))
    return {name: np.array(values) for name, values in times.items()}


if __name__ == "__main__":
    main()
