"""An episode of Ravens whose pictures are noise, and the names of its files."""

from __future__ import annotations

import numpy as np

from baggie.geometry import PlanarPose
from baggie.ravens.format import RavensAction, RavensEpisode, RavensObject, RavensPose, planar_to_pose
from helpers.ravens_scene import STILL

FIELDS = ["action", "color", "depth", "info", "reward"]
NAME = "000003-9007.pkl"


def make_episode(number: int = 3, seed: int = 9007, steps: int = 1) -> RavensEpisode:
    rng = np.random.default_rng(seed)
    action = RavensAction(
        RavensPose((0.5, 0.3, 0.04), STILL), planar_to_pose(PlanarPose(0.4, -0.1, 1.2), 0.05)
    )
    block = RavensObject((0.45, -0.12, 0.019), STILL, (0.04, 0.04, 0.04))
    return RavensEpisode(
        number,
        seed,
        color=rng.integers(0, 256, (steps + 1, 3, 480, 640, 3), np.uint8),
        depth=rng.random((steps + 1, 3, 480, 640), np.float32),
        actions=(action,) * steps,
        rewards=np.array([0.0] + [1 / max(steps, 1)] * steps),
        info=(None, *({5: block, 6: block} for _ in range(steps))),
    )
