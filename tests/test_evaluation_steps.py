"""Validation on tasks of several steps: held-out episodes, turns modulo symmetry, and what would count as right."""

import functools
import math
from dataclasses import replace
from unittest.mock import patch

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from baggie.data import DatasetWriter, open_dataset
from baggie.evaluation import validate as module
from baggie.evaluation.choices_of_scene import Done, SceneChoices, replayed
from baggie.evaluation.validate import demonstrations, validate
from baggie.geometry import Grid, PlanarPose
from baggie.metrics import success_rate, turn_error_deg
from baggie.options.evaluating import ValidateOptions
from baggie.registry import TASKS
from baggie.seeds import COLLECTION, STYLE, generator
from baggie.sim.objects import Block
from baggie.tasks import demonstrator as varied
from baggie.tasks.conditions import Score, State
from baggie.tasks.demonstrator import next_action, varied_action
from baggie.types import Attempt, Observation, Outcome, PickPlace, Plan
from helpers.ideal_arm import carried, poses_of

GRID = Grid(x=(0.25, 0.75), y=(-0.5, 0.5), pixel_m=0.01)
STEPS, EPISODES, UNFINISHED = 6, 3, 1
"""Of a pyramid of blocks."""
NOWHERE = np.full((4, 2), np.nan)
PYRAMID = TASKS["block-pyramid"]

yaws = st.floats(-math.pi, math.pi)
poses = st.builds(PlanarPose, st.floats(0.3, 0.6), st.floats(-0.3, 0.3), yaws)


def scene_of(episode):
    return PYRAMID.draw(generator(COLLECTION, 0, episode))


@functools.cache
def steps_of(episode):
    """What our own demonstrator does, by an arm without any error."""
    scene = scene_of(episode)
    there, steps = poses_of(scene), []
    while (action := next_action(scene.conditions, State.of(there))) is not None:
        there = carried(action, scene, there)
        steps.append(action)
    return steps


def step_of(episode, step):
    return steps_of(episode)[step]


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
    apart = step_of(2, 0).pick.distance(step_of(2, 1).pick)
    assert metrics["labels"]["pick_error_cm"]["max"] == pytest.approx(100 * apart)
    assert apart > 0.05
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


SIDE = 0.04
BLOCK_POSES = (PlanarPose(0.35, -0.2, 0.3), PlanarPose(0.35, 0.0, -1.0), PlanarPose(0.4, 0.2, 2.0))
SLOTS = (PlanarPose(0.55, -0.1, 0.2), PlanarPose(0.55, -0.05, 0.2))


on_it = st.builds(PlanarPose, st.floats(-0.0199, 0.0199), st.floats(-0.0199, 0.0199), yaws)
misses = st.tuples(st.floats(0, 0.0099), st.floats(0, math.radians(14.9)), yaws)


@given(st.integers(0, 2), st.integers(0, 1), on_it, st.integers(0, 3), misses)
def test_any_block_picked_anywhere_counts_where_it_comes_to_lie_in_any_slot(block, slot, at, alike, miss):
    """Within a centimetre and fifteen degrees of it, whatever looks the same and however the cup is turned."""
    choices = SceneChoices(
        [(Block(f"{n}", (SIDE,) * 3), pose) for n, pose in enumerate(BLOCK_POSES)], SLOTS, 4
    )
    pick, (off, turned, direction) = BLOCK_POSES[block] @ at, miss

    def placed(metres, radians):
        ends = PlanarPose(
            SLOTS[slot].x + metres * math.cos(direction),
            SLOTS[slot].y + metres * math.sin(direction),
            SLOTS[slot].yaw + alike * math.pi / 2 + radians,
        )
        return PickPlace(pick, ends @ at)

    right = placed(off, turned)
    assert choices.pick_counts(right)
    assert choices.place_counts(right)
    assert not choices.place_counts(placed(off + 0.0101, turned))
    assert not choices.place_counts(placed(off, turned + math.radians(15.2)))
    assert replace(choices, symmetry=1).place_counts(right) is (alike == 0)
    assert replace(choices, symmetry=0).place_counts(placed(off, turned + 0.4))
    beside = PickPlace(BLOCK_POSES[block] @ PlanarPose(SIDE / 2 + 0.001, at.y), right.place)
    assert not choices.pick_counts(beside)


def played(scene, seed):
    """Recorded steps of the style of others, each with what it earned, and what was right before each."""
    there, score, steps = poses_of(scene), Score(scene.conditions), []
    for step in range(100):
        action = varied_action(scene, State.of(there), generator(STYLE, seed, 0, step))
        if action is None:
            return steps
        after = carried(action, scene, there)
        moved = [name for name in after if after[name] is not there[name]]
        steps.append(Done(action, None if moved else "missed-grasp", score.count(State.of(after))))
        there = after
    raise AssertionError


@settings(max_examples=25, deadline=None)
@given(st.sampled_from([task for task in TASKS.all().values() if task.blocks]), st.integers(0, 2**32))
def test_of_every_style_all_counts_that_earned_something_and_nothing_that_was_wasted(task, seed):
    scene = task.draw(np.random.default_rng(seed))
    with patch.object(varied, "WASTED", 0.3):
        steps = played(scene, seed)
    told = list(replayed(scene, steps))
    assert len(told) == len(steps)
    for step, choices in zip(steps, told, strict=True):
        counts = choices.pick_counts(step.executed) and choices.place_counts(step.executed)
        assert counts is (step.reward > 0.0)


def test_where_steps_do_not_tell_where_things_went_nothing_is_said_any_more():
    scene = scene_of(0)
    right = [Done(action, None, 1 / STEPS) for action in steps_of(0)]
    assert len(list(replayed(scene, right))) == STEPS
    for wrong in (
        Done(right[2].executed, None, 0.0),  # it was said to have earned nothing
        Done(right[2].executed, None, math.nan),
        Done(right[2].executed, "dropped", 0.0),
        Done(replace(right[2].executed, pick=PlanarPose(0.3, 0.45)), None, 0.0),  # where nothing lay
    ):
        assert len(list(replayed(scene, [*right[:2], wrong, *right[3:]]))) == 3
