"""Judge a policy in the environment of the Ravens benchmark, on its own test seeds and by its own score.

    python examples/ravens_agent.py --policy RUN --assets ravens/ravens/environments/assets --task stack-block-pyramid

Needs Ravens (https://github.com/google-research/ravens) and PyBullet beside baggie, and no TensorFlow; docs/ravens.md
says how. RUN is the folder of a training run, a Hub id, or what `baggie export` wrote.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any, Literal

import numpy as np
import tyro
from rich.console import Console
from rich.progress import track

from baggie import Policy
from baggie.errors import BaggieError
from baggie.ravens.agent import RavensAgent


@dataclass(frozen=True)
class Options:
    """Judge a policy by Ravens' own score."""

    policy: str
    """The folder of a training run or of an exported policy, or a Hub id."""
    assets: Path
    """Ravens' folder `ravens/environments/assets`."""
    task: str = "stack-block-pyramid"
    """Ravens' name of the task."""
    episodes: int = 30
    """How many."""
    first_seed: int = 1
    """Seeds go up by two from here: Ravens trains on even ones and tests on odd ones."""
    clock: Literal["process", "wall"] = "process"
    """By which Ravens' motions give up. On a busy machine the wall clock, which is theirs, lets actions fail that would
    not on an idle one; the time this process computes does not.
    """
    show: bool = False
    """Open PyBullet's window."""


def main(options: Options) -> int:
    """Run all episodes and print what they scored; the exit status."""
    try:
        env, task = environment(options)
        agent = RavensAgent(Policy.from_pretrained(options.policy))
        seeds = [options.first_seed + 2 * i for i in range(options.episodes)]
        scores = [
            score(env, task, agent, seed) for seed in track(seeds, "judging", console=Console(stderr=True))
        ]
    except BaggieError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    finished = sum(value > 0.99 for value in scores)
    print(f"finished {finished} of {len(scores)}, score {np.mean(scores):.3f}")
    return 0


def environment(options: Options) -> tuple[Any, Any]:
    """Ravens' environment and the task in it."""
    # The package imports its own agents first, and with them TensorFlow, of which the environment has no need.
    sys.modules.setdefault("ravens.agents", ModuleType("ravens.agents"))
    try:
        from ravens import tasks  # type: ignore[import-not-found]  # noqa: PLC0415 -- not a dependency
        from ravens.environments import (  # type: ignore[import-not-found]  # noqa: PLC0415
            environment as module,
        )
    except ImportError as error:
        raise BaggieError(
            f"expected Ravens and PyBullet, got: {error}; install them as docs/ravens.md says"
        ) from None
    if options.task not in tasks.names:
        raise BaggieError(f"expected a task of Ravens, among {', '.join(tasks.names)}, got {options.task!r}")
    if not options.assets.is_dir():
        raise BaggieError(
            f"expected Ravens' assets in {options.assets}, got no such folder; give --assets .../environments/assets"
        )
    if options.clock == "process":
        module.time = SimpleNamespace(time=time.process_time, sleep=time.sleep)
        print(
            "motions give up by the time this process computes (--clock wall: by Ravens' own)",
            file=sys.stderr,
        )
    task = tasks.names[options.task]()
    task.mode = "test"
    return module.Environment(str(options.assets), disp=options.show, shared_memory=False, hz=480), task


def score(env: Any, task: Any, agent: RavensAgent, seed: int) -> float:
    """What one episode earns; 1 when everything is done."""
    np.random.seed(seed)  # noqa: NPY002 -- Ravens draws its scenes from it
    env.seed(seed)
    env.set_task(task)
    observation, info, total = env.reset(), None, 0.0
    agent.begin()
    for _ in range(task.max_steps):
        observation, reward, done, info = env.step(agent.act(observation, info))
        total += reward
        if done:
            break
    return total


if __name__ == "__main__":
    sys.exit(main(tyro.cli(Options)))
