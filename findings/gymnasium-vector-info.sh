#!/usr/bin/env bash
# Gymnasium: what a vector environment says in `info` depends on which of its environments comes first.
#
# An environment may say a number as an integer at times and as a float at others: a distance of 0, say, when it is
# done. A vector environment makes one array per key, of the type of the first environment that has the key, and casts
# what all others say to it, without a word: 0.7 becomes 0, 0.5 becomes True. In the other order nothing is lost.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check gymnasium==1.4.0 numpy==2.4.6
"$folder/venv/bin/python" - <<'PYTHON'
import gymnasium
import numpy as np

print(f"gymnasium {gymnasium.__version__}, numpy {np.__version__}")
SAID = {
    "at the goal": {"distance": 0, "share": True, "offset": np.array([0, 0])},
    "on the way": {"distance": 0.7, "share": 0.5, "offset": np.array([0.5, -0.5])},
}


class Reach(gymnasium.Env):
    observation_space = gymnasium.spaces.Box(-1, 1, (1,), np.float32)
    action_space = gymnasium.spaces.Discrete(2)

    def __init__(self, which):
        self.info = SAID[which]

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return np.zeros(1, np.float32), {}

    def step(self, action):
        return np.zeros(1, np.float32), 0.0, False, False, self.info


def info_of(order):
    both = gymnasium.vector.SyncVectorEnv([lambda which=which: Reach(which) for which in order])
    both.reset()
    info = both.step(np.zeros(2, int))[4]
    both.close()
    return {key: info[key].tolist() for key in ("distance", "share", "offset")}


first, other = info_of(["at the goal", "on the way"]), info_of(["on the way", "at the goal"])
print("at the goal first:", first)
print("on the way first: ", other)
assert first == {"distance": [0, 0], "share": [True, True], "offset": [[0, 0], [0, 0]]}
assert other == {"distance": [0.7, 0.0], "share": [0.5, 1.0], "offset": [[0.5, -0.5], [0.0, 0.0]]}
print("seen: the second environment's numbers are cast to the types of the first one's")
PYTHON
