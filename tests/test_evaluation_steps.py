"""Validation on tasks of several steps: held-out episodes, turns modulo symmetry, and what would count as right."""

import math
from dataclasses import replace

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from baggie.data import DatasetWriter, open_dataset
from baggie.evaluation import validate as module
from baggie.evaluation.heldout import demonstrations
from baggie.evaluation.metrics import success_rate, turn_error_deg
from baggie.evaluation.validate import ValidateOptions, validate
from baggie.evaluation.would_count import Choices
from baggie.geometry import PlanarPose
from baggie.grid import Grid
from baggie.types import Attempt, Observation, Outcome, PickPlace, Plan

GRID = Grid(x=(0.3, 0.62), y=(-0.3, 0.3), pixel_m=0.01)
STEPS, EPISODES, UNFINISHED = 6, 3, 1
"""Of a pyramid of blocks."""
NOWHERE = np.full((4, 2), np.nan)

yaws = st.floats(-math.pi, math.pi)
poses = st.builds(PlanarPose, st.floats(0.3, 0.6), st.floats(-0.3, 0.3), yaws)


def step_of(episode, step):
    """Blocks 5 cm apart go to slots 5 cm apart; each is turned by another angle."""
    pick = PlanarPose(0.35, -0.2 + 0.05 * step + 0.01 * episode)
    return PickPlace(pick, PlanarPose(0.5, -0.15 + 0.05 * step, 0.1 * step))


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    root = tmp_path_factory.mktemp("steps") / "pyramids"
    rng = np.random.default_rng(0)
    rows, columns = GRID.shape
    collection = {"task": "block-pyramid", "seed": 0, "cell": 0, "object_symmetry": 4}
    settings = {"task": "build", "robot_type": "drawn", "picture_size": (columns, rows)}
    with DatasetWriter(root, collection=collection, **settings) as writer:
        for number in range(EPISODES * STEPS):
            episode, step = divmod(number, STEPS)
            color = rng.integers(0, 256, (rows, columns, 3)).astype(np.uint8)
            seen = Observation(color, grid=GRID, height=np.zeros(GRID.shape, np.float32))
            action = step_of(episode, step)
            attempt = Attempt(number, "build", seen, None, action, Outcome(action), NOWHERE, NOWHERE)
            reward = 0.0 if episode == UNFINISHED else 1 / STEPS
            writer.append(replace(attempt, episode=episode, step=step, reward=reward))
    return root


class Knowing:
    """Says of each recorded picture what `answer` makes of what was right there."""

    name = "transporter"

    def __init__(self, folder, answer):
        self.right = {a.before.color.tobytes(): (a.episode, a.step) for a in open_dataset(folder)}
        self.answer = answer

    def plan(self, observation, goal=None):
        assert goal is None
        heat = np.eye(*GRID.shape, dtype=np.float32)
        return Plan(self.answer(*self.right[observation.color.tobytes()]), views={"pick": heat})


def run_of(folder, recording, val):
    folder.mkdir()
    split = {"train": list(range(STEPS)), "val": list(val)}
    config = {"policy": "transporter", "training": {"data": str(recording), "split": split}}
    (folder / "config.yaml").write_text(yaml.safe_dump(config))
    return str(folder)


def validated(tmp_path, recording, monkeypatch, answer):
    monkeypatch.setattr(module, "open_policy", lambda *_: Knowing(recording, answer))
    run = run_of(tmp_path / "run", recording, range(2 * STEPS, 3 * STEPS))
    return validate(ValidateOptions(run, recording, tmp_path / "out"))


def test_only_steps_of_episodes_that_did_their_task_are_measured_on(recording):
    kept = {0, 1, 2} - {UNFINISHED}
    dataset = open_dataset(recording)
    assert [int(dataset.episodes[i]) for i in demonstrations(dataset)] == [e for e in kept for _ in range(6)]


def test_known_errors_are_recovered_modulo_symmetry(tmp_path, recording, monkeypatch):
    def off(episode, step):
        right = step_of(episode, step)
        place = PlanarPose(right.place.x, right.place.y + 0.004, right.place.yaw + math.pi / 2 + 0.1)
        return PickPlace(PlanarPose(right.pick.x + 0.003, right.pick.y), place)

    metrics = validated(tmp_path, recording, monkeypatch, off)
    assert metrics["held_out"]["attempts"] == STEPS
    assert metrics["symmetry"] == 4
    labels = metrics["labels"]
    assert labels["pick_error_cm"]["max"] == pytest.approx(0.3)
    assert labels["place_error_cm"]["max"] == pytest.approx(0.4)
    assert labels["turn_error_deg"]["mean"] == pytest.approx(math.degrees(0.1))
    assert metrics["would_count"]["both"] == success_rate(STEPS, STEPS)
    pictures = {path.name for path in (tmp_path / "out/pictures").iterdir()}
    assert pictures == {f"attempt-{n:06d}{kind}.jpg" for n in range(12, 18) for kind in ("", "-heat")}


def test_another_block_of_the_same_row_is_far_off_and_would_count(tmp_path, recording, monkeypatch):
    """The second block first: as good in the row of three, though not what the demonstrator chose."""
    metrics = validated(
        tmp_path, recording, monkeypatch, lambda e, s: step_of(e, 1) if s == 0 else step_of(e, s)
    )
    assert metrics["labels"]["pick_error_cm"]["max"] == pytest.approx(5.0)
    assert metrics["would_count"]["both"] == success_rate(STEPS, STEPS)


def test_a_block_of_another_row_does_not_count(tmp_path, recording, monkeypatch):
    """The red block, of the top, first; then blocks that lie in their slots already."""
    metrics = validated(
        tmp_path, recording, monkeypatch, lambda e, s: step_of(e, 5) if s == 0 else step_of(e, s - 1)
    )
    assert metrics["would_count"]["pick"] == metrics["would_count"]["both"] == success_rate(0, STEPS)


@given(poses, poses, yaws, st.integers(-4, 4), st.sampled_from([1, 2, 4]))
def test_a_turn_is_known_modulo_symmetry_whatever_way_the_cup_held(pick, place, held, turns, fold):
    right = PickPlace(pick, place)
    held_place = held + 2 * math.pi * turns / fold
    said = PickPlace(replace(pick, yaw=pick.yaw + held), replace(place, yaw=place.yaw + held_place))
    assert turn_error_deg(said, right, fold) == pytest.approx(0.0, abs=1e-6)
    wrong = PickPlace(said.pick, replace(said.place, yaw=said.place.yaw + math.pi / fold / 2))
    assert turn_error_deg(wrong, right, fold) == pytest.approx(90 / fold)
    assert turn_error_deg(wrong, right, 0) == 0.0


@given(st.permutations(range(3)), st.floats(0, 0.0099), yaws, st.booleans())
def test_any_block_in_any_slot_counts_within_a_centimetre_and_no_further(order, off, direction, beyond):
    """Turned as that block has to be, whichever slot it goes to."""
    actions = [step_of(0, step) for step in range(3)]
    choices = Choices(actions, symmetry=4)
    block, slot = actions[order[0]], actions[order[1]].place
    length = off + (0.0101 if beyond else 0.0)
    dx, dy = length * math.cos(direction), length * math.sin(direction)
    pick = PlanarPose(block.pick.x + dx, block.pick.y + dy)
    place = PlanarPose(slot.x + dx, slot.y + dy, block.place.yaw)
    planned = PickPlace(pick, place)
    assert choices.pick_counts(planned) is choices.place_counts(planned) is not beyond
    turned = PickPlace(pick, replace(place, yaw=place.yaw + math.radians(16)))
    assert not choices.place_counts(turned)
