"""The pictures of the README: a bag being moved by a trained policy, what the camera saw, where the policy pointed.

python benchmarks/media.py --policy runs/keypoint
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import tyro
from PIL import Image

import baggie
from baggie import seeds
from baggie.collect.machine import random_place
from baggie.evaluation.marked_pictures import Region, heat_over, save_jpeg
from baggie.types import Goal
from baggie.vision.draw import paint_goal
from baggie.workcell.simulated import open_simulated


@dataclass(frozen=True)
class Options:
    """What to show."""

    policy: Path = Path("runs/keypoint")
    """A training run."""
    cell: int = 0
    """The simulated workcell it was trained in."""
    episode: int = 1000
    """Names the scene, in the stream of evaluations."""
    out: Path = Path("docs/media")
    """Where the pictures go."""


def main(options: Options) -> None:
    """Run one episode and save what it looks like."""
    cell, policy = open_simulated(options.cell), baggie.load_policy(options.policy)
    stream = (seeds.EVALUATION, options.episode)
    cell.reset(stream)
    goal = Goal(
        cell.outline(random_place(cell.settings.workspace, cell.truth(), seeds.generator(*stream, 1)))
    )
    observation = cell.look()
    plan = policy.plan(observation, goal)
    with cell.film((640, 480), fps=8) as frames:
        cell.execute(plan.action)
        cell.look()
    options.out.mkdir(parents=True, exist_ok=True)
    small = [Image.fromarray(cv2.resize(frame, (480, 360), interpolation=cv2.INTER_AREA)) for frame in frames]
    small[0].save(
        options.out / "attempt.webp", save_all=True, append_images=small[1:], duration=60, loop=0, quality=60
    )
    everything = Region(0, 0, *observation.size)
    save_jpeg(options.out / "picture.jpg", everything.cut(paint_goal(observation.color, goal)))
    save_jpeg(options.out / "plan.jpg", heat_over(observation.color, everything, plan.views))


if __name__ == "__main__":
    main(tyro.cli(Options))
