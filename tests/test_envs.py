"""The Gymnasium environments: in processes of their own, and what a user may write into."""

from __future__ import annotations

import subprocess
import sys

import gymnasium
import numpy as np
import pytest

import baggie  # noqa: F401 -- registers the environments
from baggie.errors import BaggieError

IDS = sorted(name for name in gymnasium.registry if name.startswith("baggie/"))
ONE_OF_EACH = ["baggie/AlignBoxCorner-v0", "baggie/BagPlace-v0"]

SIDE_BY_SIDE = """
import sys
import baggie, gymnasium, numpy as np
from baggie.errors import BaggieError

def side_by_side(name):
    return gymnasium.make_vec(name, num_envs=2, vectorization_mode="async")

for name in sys.argv[1:]:
    envs = side_by_side(name)
    envs.reset(seed=0)
    *_, info = envs.step(np.full((2, 6), np.nan, np.float32))
    assert info["is_success"].dtype == bool, info
    envs.close()

one = gymnasium.make(sys.argv[1])
one.reset(seed=0)
envs = side_by_side(sys.argv[1])
try:
    envs.reset(seed=0)
except BaggieError as error:
    print(error)
envs.close(terminate=True)
"""


@pytest.mark.parametrize(
    "names", [["baggie/BagPlace-v0"], pytest.param(IDS, marks=pytest.mark.slow)], ids=len
)
def test_every_environment_runs_in_processes_of_its_own_and_a_fork_of_who_rendered_says_so(
    names: list[str],
) -> None:
    given = [sys.executable, "-W", "ignore", "-c", SIDE_BY_SIDE, *names]
    done = subprocess.run(given, check=False, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    (line,) = done.stdout.splitlines()
    assert 'context="spawn"' in line


@pytest.mark.parametrize("order", ["baggie, gymnasium", "gymnasium, baggie", "gymnasium.envs, baggie"])
def test_the_environments_are_known_in_whatever_order_things_are_imported(order: str) -> None:
    program = (
        f"import {order}; import gymnasium; print(*(name for name in gymnasium.registry if 'baggie' in name))"
    )
    done = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True)
    assert sorted(done.stdout.split()) == IDS


@pytest.mark.parametrize("name", ONE_OF_EACH)
def test_what_is_written_into_an_observation_or_a_picture_stays_there(name: str) -> None:
    env = gymnasium.make(name, render_mode="rgb_array", disable_env_checker=True)
    observation, info = env.reset(seed=1)
    assert not info["is_success"]
    shown = env.render()
    assert isinstance(shown, np.ndarray)
    kept = shown.copy()
    for array in (*observation.values(), shown):
        array[...] = 0
    np.testing.assert_array_equal(env.render(), kept)
    env.close()


def test_the_last_step_says_whether_the_bag_is_there() -> None:
    env = gymnasium.make("baggie/BagPlace-v0", disable_env_checker=True)
    env.reset(seed=3)
    inner = env.unwrapped
    bag, goal = inner._workcell.truth(), inner._goal  # type: ignore[attr-defined]
    action = np.array([bag.x, bag.y, bag.yaw, goal.x, goal.y, bag.yaw], np.float32)
    _, reward, terminated, _, info = env.step(action)
    assert terminated
    assert info["is_success"] is True
    assert info["distance_m"] == pytest.approx(-float(reward))
    env.close()


@pytest.mark.parametrize("mode", ["NEXT_STEP", "SAME_STEP"])
def test_vector_environments_say_how_the_last_step_ended(mode: str) -> None:
    """In `info`, or in its `final_info`: where LeRobot's evaluation looks for it. The step after it counts for 0."""
    kwargs = {"autoreset_mode": gymnasium.vector.AutoresetMode[mode]}
    envs = gymnasium.make_vec("baggie/BagPlace-v0", vectorization_mode="sync", vector_kwargs=kwargs)
    envs.reset(seed=0)
    refused = np.full((1, 6), np.nan, np.float32)
    for _ in range(3):
        *_, truncated, info = envs.step(refused)
    assert truncated.all()
    last = info["final_info"] if mode == "SAME_STEP" else info
    assert last["is_success"].tolist() == [False]
    _, rewards, *_, info = envs.step(refused)
    assert (rewards == 0).all() == (mode == "NEXT_STEP")
    assert ("refused" in info) == (mode == "SAME_STEP")
    envs.close()


@pytest.mark.parametrize("action", [np.zeros(5), np.zeros((6, 2)), ["a"] * 6, None], ids=str)
def test_an_action_of_another_shape_is_one_line(action: object) -> None:
    env = gymnasium.make("baggie/BagPlace-v0", disable_env_checker=True).unwrapped
    with pytest.raises(BaggieError, match="expected an action of six numbers") as error:
        env.step(action)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("cell", [-1, 1.5, "sim"])
def test_a_cell_that_is_none_is_one_line(cell: object) -> None:
    with pytest.raises(BaggieError, match=r"expected the number of a cell, .*; take 0"):
        gymnasium.make("baggie/BagPlace-v0", cell=cell)


def test_an_action_that_is_no_number_moves_nothing() -> None:
    env = gymnasium.make("baggie/BagPlace-v0", disable_env_checker=True)
    env.reset(seed=0)
    *_, info = env.step(np.array([0.5, 0, 0, 0.5, 0.1, np.nan], np.float32))
    assert "not finite" in info["refused"]
    assert not info["is_success"]
    env.close()
