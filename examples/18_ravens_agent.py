"""Judge a policy in the environment of the Ravens benchmark, on its own test seeds and by its own score.

Shows a policy as an agent of Ravens: it sees the pictures of the three cameras fused, nothing else. Needs Ravens
(https://github.com/google-research/ravens) and PyBullet, but no TensorFlow, and a policy for the task: docs/ravens.md.

Prints how many episodes it finished and what they scored:

    finished 29 of 30, score 0.983
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np

from baggie import Policy
from baggie.errors import BaggieError
from baggie.ravens.adapters import RavensAgent

POLICY = "runs/pyramid"  # the folder of a training run, or a Hub id
ASSETS = Path("ravens/ravens/environments/assets")  # of Ravens' source, which is on the PYTHONPATH
TASK = "stack-block-pyramid"
EPISODES = 30


def environment() -> tuple[Any, Any]:
    """Ravens' environment and the task in it. Raises `BaggieError` where they are not here."""
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
    if not ASSETS.is_dir():
        raise BaggieError(f"expected Ravens' assets in {ASSETS}, got no such folder; change ASSETS")
    # Ravens' motions give up by the wall clock: on a busy machine actions fail that would not on an idle one. The time
    # that this process computes does not depend on others. Leave this line out to go by Ravens' own clock.
    module.time = SimpleNamespace(time=time.process_time, sleep=time.sleep)
    task = tasks.names[TASK]()
    task.mode = "test"
    return module.Environment(str(ASSETS), disp=False, shared_memory=False, hz=480), task


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


def main() -> None:
    """Every odd seed: Ravens trains on even ones and tests on odd ones."""
    try:
        env, task = environment()
        agent = RavensAgent(Policy.from_pretrained(POLICY))
        scores = [score(env, task, agent, seed) for seed in range(1, 2 * EPISODES, 2)]
    except BaggieError as error:
        sys.exit(f"error: {error}")
    print(f"finished {sum(value > 0.99 for value in scores)} of {len(scores)}, score {np.mean(scores):.3f}")


if __name__ == "__main__":
    main()
