"""The same world as a Gymnasium environment: one step is one whole pick and place.

Shows spaces, actions and what a step tells. The action is six numbers: pick x, y, yaw and place x, y, yaw, metres and
radians in the robot's base frame; the observation is a picture and the goal's corners in it. Blind chance plays here;
what the arm cannot do is refused, and nothing moves.

Prints what the spaces are, and what came of each step:

    observation: {'color': (360, 640, 3), 'goal': (4, 2)}, action: (6,)
    step 1: reward -0.355, success False, missed-grasp
    step 2: reward -0.438, success False, missed-grasp
    step 3: reward -0.438, success False, missed-grasp
    the episode is over: truncated
"""

from __future__ import annotations

import gymnasium

import baggie  # noqa: F401 -- registers the environments


def main() -> None:
    """One episode at random."""
    env = gymnasium.make("baggie/BagPlace-v0")
    spaces = env.observation_space
    assert isinstance(spaces, gymnasium.spaces.Dict)
    shapes = {name: space.shape for name, space in spaces.items()}
    print(f"observation: {shapes}, action: {env.action_space.shape}")

    env.reset(seed=0)
    env.action_space.seed(0)
    terminated = truncated = False
    step = 0
    while not (terminated or truncated):
        step += 1
        action = env.action_space.sample()  # a policy's: `policy.plan(...).action.to_array()`
        _, reward, terminated, truncated, info = env.step(action)
        came = info["refused"] if "refused" in info else (info["outcome"].failure or "carried")
        print(f"step {step}: reward {reward:.3f}, success {info['is_success']}, {came}")
    print(f"the episode is over: {'done' if terminated else 'truncated'}")
    env.close()


if __name__ == "__main__":
    main()
