"""A policy in Ravens' place: what it plans on the fused picture comes out as what Ravens would demonstrate."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import baggie
from baggie.errors import BaggieError
from baggie.geometry import FloatArray, Grid, PlanarPose
from baggie.policies.transporter.config import TransporterConfig
from baggie.policies.transporter.network import TransporterNet
from baggie.policies.transporter.policy import TransporterPolicy
from baggie.ravens.adapters import RavensAgent, planar
from baggie.ravens.format import RavensAction, RavensPose
from baggie.types import Goal, Observation, PickPlace, Plan
from helpers import ravens_scene

STEPS = len(ravens_scene.STARTS)


class Seeing:
    """Finds blocks by their colours, in the picture alone."""

    def __init__(self, step: int) -> None:
        self.moved = list(ravens_scene.STARTS)[step]
        self.onto = ["green", *ravens_scene.STARTS][step]

    def plan(self, observation: Observation, goal: Goal | None = None) -> Plan:
        start, stand = (middle(observation, name) for name in (self.moved, self.onto))
        grip = PlanarPose(0.005, -0.005)
        turn = ravens_scene.TURNS[self.moved]
        return Plan(PickPlace(PlanarPose(*start) @ grip, PlanarPose(*stand, turn) @ grip))


def middle(observation: Observation, name: str) -> FloatArray:
    """Where the block's top is, `(2,)` metres."""
    assert observation.grid is not None
    rows, columns = np.nonzero((observation.color == ravens_scene.COLORS[name]).all(axis=2))
    return observation.grid.to_robot(np.c_[columns, rows].mean(axis=0))[0]


class Planned:
    def __init__(self, action: PickPlace) -> None:
        self.action = action

    def plan(self, observation: Observation, goal: Goal | None = None) -> Plan:
        assert observation.grid is not None
        return Plan(self.action)


@pytest.mark.parametrize("step", range(STEPS))
def test_an_oracle_does_what_was_demonstrated(step: int) -> None:
    act = RavensAgent(Seeing(step)).act(ravens_scene.observation(step), None, None)
    for name, demonstrated in ravens_scene.action(step)._asdict().items():
        xyz, xyzw = act[name]
        np.testing.assert_allclose(xyz[:2], demonstrated.xyz[:2], atol=Grid.pixel_m)
        assert xyz[2] == pytest.approx(demonstrated.xyz[2], abs=5e-4)
        assert abs(np.dot(xyzw, demonstrated.xyzw)) == pytest.approx(1)


angles = st.floats(-3.1, 3.1)
lengths = st.floats(0.26, 0.74), st.floats(-0.49, 0.49)
poses = st.builds(PlanarPose, *lengths, angles)


@settings(max_examples=10, deadline=None)
@given(poses, poses)
def test_what_is_planned_is_done(pick: PlanarPose, place: PlanarPose) -> None:
    act = RavensAgent(Planned(PickPlace(pick, place))).act(ravens_scene.observation(0))
    assert act["pose0"][1].tolist() == [0, 0, 0, 1]  # the cup is round
    action = RavensAction(*(RavensPose(tuple(xyz), tuple(xyzw)) for xyz, xyzw in act.values()))
    done, wanted = (a.place @ a.pick.inverse() for a in (planar(action), PickPlace(pick, place)))
    np.testing.assert_allclose(done.matrix(), wanted.matrix(), atol=1e-9)


def test_heights_are_in_the_robots_frame() -> None:
    grid = Grid(z=(-0.1, 0.28))
    act = RavensAgent(Seeing(0), grid).act(ravens_scene.observation(0))
    assert act["pose0"][0][2] == pytest.approx(ravens_scene.SIDE_M, abs=5e-4)


def without_a_camera(obs: dict[str, Any]) -> dict[str, Any]:
    return {name: pictures[:2] for name, pictures in obs.items()}


def half_as_large(obs: dict[str, Any]) -> dict[str, Any]:
    return {name: [picture[::2, ::2] for picture in pictures] for name, pictures in obs.items()}


def in_floats(obs: dict[str, Any]) -> dict[str, Any]:
    return obs | {"color": [picture / 255 for picture in obs["color"]]}


@pytest.mark.parametrize("spoil", [without_a_camera, half_as_large, in_floats, lambda _: {}])
def test_another_observation_is_refused(spoil: Callable[[dict[str, Any]], dict[str, Any]]) -> None:
    with pytest.raises(BaggieError, match="expected the observation of Ravens' three cameras") as caught:
        RavensAgent(Seeing(0)).act(spoil(dict(ravens_scene.observation(0))))
    assert "\n" not in str(caught.value)


def test_a_plan_outside_the_map_is_refused() -> None:
    outside = Planned(PickPlace(PlanarPose(0.5, 0.0), PlanarPose(0.5, 0.6)))
    with pytest.raises(BaggieError, match=r"expected a plan inside the map.+y 0.600"):
        RavensAgent(outside).act(ravens_scene.observation(0))


SOURCE = Path(baggie.__file__).parents[1]


def example(cwd: Path, before: str) -> subprocess.CompletedProcess[str]:
    """Run the example after a statement about `example`, its module."""
    script = f"import importlib, sys; example = importlib.import_module('18_ravens_agent'); {before}; example.main()"
    paths = map(str, (cwd, SOURCE.parent / "examples", Path(__file__).parent, SOURCE))
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(paths), "OMP_NUM_THREADS": "1"}
    command = [sys.executable, "-c", script]
    return subprocess.run(command, cwd=cwd, env=env, capture_output=True, text=True, check=False)


def test_the_example_says_what_it_needs(tmp_path: Path) -> None:
    done = example(tmp_path, "sys.modules['ravens'] = None")
    assert done.returncode == 1
    assert done.stderr.startswith("error: expected Ravens and PyBullet")
    assert done.stderr.count("\n") == 1


STAND_IN = {
    "__init__.py": "from ravens import agents\nfrom ravens import tasks\n",
    "agents/__init__.py": "import tensorflow_is_not_here\n",
    "tasks/__init__.py": """
class Task:
    max_steps = 2
names = {"stack-block-pyramid": Task}
""",
    "environments/__init__.py": "",
    "environments/environment.py": """
import time
from helpers import ravens_scene

class Environment:
    def __init__(self, assets, disp, shared_memory, hz):
        pass
    def seed(self, seed):
        pass
    def set_task(self, task):
        pass
    def reset(self):
        return ravens_scene.observation(0)
    def step(self, action):
        began = time.time()
        for _ in range(3):  # somebody else computes
            time.sleep(0.05)
            if time.time() - began > 0.1:
                return ravens_scene.observation(0), 0.0, False, None
        return ravens_scene.observation(0), 1.0, True, None
""",
}
"""What the example needs of Ravens, whose package wants its agents' TensorFlow first, and gives up by the clock."""


def test_the_example_needs_no_tensorflow_and_goes_by_its_own_clock(tmp_path: Path) -> None:
    for name, content in STAND_IN.items():
        path = tmp_path / "ravens" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content)
    (tmp_path / "ravens/ravens/environments/assets").mkdir(parents=True)
    TransporterPolicy(TransporterNet(TransporterConfig(rotations=8)), Grid(), 0).save_pretrained(
        tmp_path / "runs/pyramid"
    )
    done = example(tmp_path, "example.EPISODES = 2")
    assert done.stdout == "finished 2 of 2, score 1.000\n", done.stderr
