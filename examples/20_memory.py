"""Memory of an episode: what changed nothing is not tried again.

Shows why whoever begins an episode asks a memory in place of its policy. A policy plans from one picture alone, so it
would repeat for ever what fails. The memory compares what is seen with what was seen before, and tells the policy where
picks came to nothing: `observation.tried`. The policy here picks the first thing it sees in a height map, but aims a
hand's width beside it as long as nobody tells it that nothing was there.

Prints what came of two picks without a memory, and with one:

    alone: missed-grasp, missed-grasp
    with a memory: missed-grasp, carried
"""

from __future__ import annotations

import cv2
import gymnasium
import numpy as np

import baggie
from baggie.geometry import Grid, PlanarPose
from baggie.policies.memory import Planner, remembering
from baggie.types import Goal, Observation, PickPlace, Plan

ASIDE = PlanarPose(0.45, 0.0)
BESIDE_M = 0.12
THING_M = 0.03
"""What is higher than this is no table."""


class FirstThingPolicy(baggie.Policy):
    """Picks the first thing in a height map and puts it aside; its aim is off at first."""

    name = "first-thing"

    def plan(self, observation: Observation, goal: Goal | None = None) -> Plan:
        """Looks at heights only."""
        assert observation.height is not None
        assert observation.grid is not None
        things = (observation.height > THING_M).astype(np.uint8)
        _, _, _, middles = cv2.connectedComponentsWithStats(things)  # the first is the table's
        x, y = observation.grid.to_robot(middles[1:2])[0].tolist()
        return Plan(PickPlace(PlanarPose(x if len(observation.tried) else x - BESIDE_M, y), ASIDE))


def picks(env: gymnasium.Env[dict[str, np.ndarray], np.ndarray], planner: Planner) -> str:
    """What came of two picks in the same scene."""
    seen, _ = env.reset(seed=0)
    came = []
    for _ in range(2):
        plan = planner.plan(Observation(seen["color"], grid=Grid(), height=seen["height"]))
        seen, _, _, _, info = env.step(plan.action.to_array().astype(np.float32))
        came.append("refused" if "refused" in info else (info["outcome"].failure or "carried"))
    return ", ".join(came)


def main() -> None:
    """Without, and with."""
    env = gymnasium.make("baggie/BlockPyramid-v0")
    policy = FirstThingPolicy()
    print("alone:", picks(env, policy))
    print("with a memory:", picks(env, remembering(policy)))  # a new one, or `begin()`, for each episode
    env.close()


if __name__ == "__main__":
    main()
