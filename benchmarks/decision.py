"""How long a decision takes, from a picture of 1280 x 720 and a goal to a plan: every policy there is.

    python benchmarks/decision.py

The networks are untrained: their weights make no difference to the time. One thread, then two; learned policies run by
PyTorch, and exported, by onnxruntime. Writes docs/results/decision.{json,md}.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

import cv2
import numpy as np
import torch

from baggie.calibration.files import CameraIdentity
from baggie.calibration.image_to_robot.map import ImageToRobot
from baggie.data.summary import goal_of
from baggie.learning.keypoint import KeypointRecipe
from baggie.policies import ColorMaskPolicy, LearnedPolicy, Policy, RegressionPolicy, load_policy
from baggie.policies.export import export_policy
from baggie.policies.regression import RegressionNet
from commands import spread_ms, write_and_show
from helpers.synthetic import RED, make_attempt, to_pixels

ROUNDS = 25
SIZE = (1280, 720)


def main() -> None:
    recorded = [make_attempt(i, np.random.default_rng(i), (640, 360), depth=False) for i in range(20)]
    keypoint = KeypointRecipe(recorded).policy
    with torch.no_grad():
        keypoint.network.heat.weight.mul_(300)  # untrained, but as sure as a trained one, or it refuses
    regression = RegressionPolicy(RegressionNet(), (640, 360), 0, "solid", (0, 200, 0))
    attempt = make_attempt(0, np.random.default_rng(0), SIZE, depth=False)
    goal = goal_of(attempt)
    rows: list[dict[str, Any]] = []
    with TemporaryDirectory() as folder:
        for policy in (keypoint, regression):
            export_policy(policy, Path(folder, policy.name))
        for threads in (1, 2):
            torch.set_num_threads(threads)
            cv2.setNumThreads(threads)
            contenders = engines([keypoint, regression], Path(folder))  # loaded anew, with as many threads
            times = np.zeros((ROUNDS, len(contenders)))
            for turn in range(-2, ROUNDS):  # the first ones warm up
                for column, (_, policy) in enumerate(contenders):
                    start = time.perf_counter()
                    policy.plan(attempt.before, goal)
                    times[max(turn, 0), column] = 1000 * (time.perf_counter() - start)
            rows += [
                {"policy": policy.name, "engine": engine, "threads": threads, **spread_ms(ms)}
                for (engine, policy), ms in zip(contenders, times.T, strict=True)
            ]
    notes = f"From a picture of {SIZE[0]} x {SIZE[1]} to a plan; {ROUNDS} rounds, interleaved."
    write_and_show("decision", "How long a decision takes", rows, notes)


def engines(trained: Sequence[LearnedPolicy], exported: Path) -> list[tuple[str, Policy]]:
    """Every policy with what runs it."""
    found: list[tuple[str, Policy]] = [("opencv", color_mask())]
    for policy in trained:
        found += [("pytorch", policy), ("onnxruntime", load_policy(exported / policy.name))]
    return found


def color_mask() -> ColorMaskPolicy:
    robot = np.array([[x, y, 0.015] for x in (0.35, 0.5, 0.65) for y in (-0.25, 0.0, 0.25)])
    fitted = ImageToRobot.fit(to_pixels(robot, SIZE), robot, CameraIdentity("drawn", *SIZE))
    return ColorMaskPolicy(fitted, RED)


if __name__ == "__main__":
    main()
