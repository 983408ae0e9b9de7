"""Training: what it learns, what it writes, and that a kill costs nothing."""

import json
import math
import os
import signal
import socket
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
import yaml
from accelerate import Accelerator
from hypothesis import example, given
from hypothesis import strategies as st

from baggie.data.summary import goal_of
from baggie.errors import BaggieError, DataError
from baggie.geometry import PlanarPose, apply_homography
from baggie.learning import TrainOptions, train
from baggie.learning.keypoint import KeypointOptions, KeypointRecipe, calibrate_radii
from baggie.learning.loop import FILE, TrainingLoop, TrainingState, deferred_interrupt, prefetched
from baggie.learning.regression import RegressionRecipe
from baggie.learning.samples import SYSTEMATIC_M, Changes, Disagreement
from baggie.learning.split import USUAL_TRAIN, USUAL_VAL, Split, shares
from baggie.learning.train import plan_errors
from baggie.metrics import yaw_error_deg
from baggie.operator import Nobody
from baggie.options.training import TRAININGS
from baggie.policies import KeypointPolicy, load_policy
from baggie.policies.base import check_policy
from baggie.policies.keypoint import heads as planar_map
from baggie.policies.planning import STACKED_CELLS
from baggie.policies.regression import ResNet18
from baggie.types import LAYER_M, Goal, Observation, PickPlace, Plan
from baggie.vision.draw import paint_goal
from helpers.synthetic import (
    COLORS,
    Lying,
    box_corners,
    make_attempt,
    make_stacking,
    observe_bags,
)

SIZE = (320, 180)
ENOUGH = 80
"""Steps to learn eight attempts by heart."""


def make_attempts(count: int = 10):
    return [make_attempt(i, np.random.default_rng([1, i]), SIZE, depth=False) for i in range(count)]


ATTEMPTS = make_attempts()


@pytest.fixture(autouse=True)
def _one_thread():
    torch.set_num_threads(1)


def options(out: Path, policy: str = "keypoint", **changes) -> TrainOptions:
    given = {"train": 8, "val": 2, "steps": 6, "device": "cpu", "save_every_s": 1000.0} | changes
    return TRAININGS[policy](data=Path("drawn"), out=out, **given)


# --- what is learned
# ------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def overfitted(tmp_path_factory) -> Path:
    torch.set_num_threads(1)
    out = tmp_path_factory.mktemp("run")
    train(options(out, steps=ENOUGH), ATTEMPTS)
    return out


def test_learns_eight_attempts(overfitted, below):
    policy = load_policy(overfitted)
    plans = [policy.plan(attempt.before, goal_of(attempt)) for attempt in ATTEMPTS[:8]]
    pairs = [(plan.action, attempt.truth) for plan, attempt in zip(plans, ATTEMPTS, strict=False)]
    below("pick (m)", max(action.pick.distance(truth.before) for action, truth in pairs), 0.02)
    below("place (m)", max(action.place.distance(truth.after) for action, truth in pairs), 0.02)
    below("1 - confidence", max(1 - plan.confidence for plan in plans), 0.7)


def test_an_empty_table_is_one_clear_line(overfitted):
    empty = np.median([attempt.before.color for attempt in ATTEMPTS], axis=0).astype(np.uint8)
    with pytest.raises(BaggieError, match="no bag in sight"):
        load_policy(overfitted).plan(Observation(empty), goal_of(ATTEMPTS[0]))


def test_the_place_turns_with_the_goal(overfitted, below):
    policy, attempt = load_policy(overfitted), ATTEMPTS[0]
    goals = [PlanarPose(0.5, 0.05, yaw) for yaw in (-0.6, 0.0, 0.5)]
    places = [policy.plan(attempt.before, Goal(box_corners(goal, SIZE))).action.place for goal in goals]
    below("place yaw (deg)", max(map(yaw_error_deg, places, goals)), 3)


def test_a_goal_over_the_bag_does_not_hide_it(overfitted, below):
    policy, attempt = load_policy(overfitted), ATTEMPTS[0]
    over = Goal(attempt.box_before + np.array([3.0, 2.0]))
    there, away = (policy.plan(attempt.before, goal).action.pick for goal in (over, goal_of(attempt)))
    below("pick (m)", there.distance(away), 0.02)


def test_plans_alike_at_any_resolution(overfitted, below):
    policy, attempt = load_policy(overfitted), ATTEMPTS[0]
    double = replace(attempt.before, color=cv2.resize(attempt.before.color, (640, 360)))
    small = policy.plan(attempt.before, goal_of(attempt)).action
    large = policy.plan(double, goal_of(attempt).scaled(2, 2)).action
    below("pick (m)", small.pick.distance(large.pick), 0.003)
    below("place (m)", small.place.distance(large.place), 0.003)


def test_a_run_holds_what_is_promised(overfitted):
    names = {path.name for path in overfitted.iterdir()}
    assert {"config.yaml", "policy.safetensors", "metrics.json", "resume.pt"} <= names
    assert any(name.startswith("events.out.tfevents") for name in names)
    metrics = json.loads((overfitted / "metrics.json").read_text())
    assert metrics["train_s"] > 0
    for reference in ("labels", "truth"):
        for quantity in ("pick_error_cm", "place_error_cm"):
            assert set(metrics[reference][quantity]) == {"mean", "median", "p95", "max", "n"}
            assert metrics[reference][quantity]["n"] == 2
    config = yaml.safe_load((overfitted / "config.yaml").read_text())
    assert (config["policy"], config["cell"], config["picture_size"]) == ("keypoint", 0, list(SIZE))
    assert config["training"]["split"]["train"] == list(range(8))
    assert config["training"]["split"]["val"] == [8, 9]


# --- calibration-free augmentation
# ----------------------------------------------------------------------------------


def with_a_dot(attempt, at):
    """The attempt with a black picture and one bright dot, at a pixel (u, v)."""
    picture = np.zeros((SIZE[1], SIZE[0], 3), np.uint8)
    cv2.circle(
        picture, tuple(np.round(np.asarray(at) * 16).astype(int)), 3 * 16, (255, 255, 255), -1, cv2.LINE_8, 4
    )
    return replace(attempt, before=replace(attempt.before, color=picture))


def test_warped_labels_are_exact():
    """For an f that is exact, g(A⁻¹ f(A·I)) is the label, whatever the warp A."""
    recipe = KeypointRecipe(ATTEMPTS)
    for seed in range(5):
        batch = recipe.batch(np.random.default_rng(seed))
        points = planar_map.apply_homographies(batch["to_picture"].unsqueeze(1), batch["cells"])
        found = recipe.policy.network.to_robot(points)
        assert torch.allclose(found, batch["xy"], atol=2e-5)


def test_warped_pictures_are_where_their_coordinates_say():
    """f is exact here: it finds the one dot in the warped picture, which must lead back to where it was."""
    dots = [attempt.box_before.mean(axis=0) for attempt in ATTEMPTS]
    attempts = [with_a_dot(attempt, dot) for attempt, dot in zip(ATTEMPTS, dots, strict=True)]
    recipe = KeypointRecipe(attempts, KeypointOptions(changes=Changes(new_looks=0.0)))
    normalized = apply_homography(recipe.policy.view.normalize(), np.array(dots))
    batch = recipe.batch(np.random.default_rng(0))
    half_pixels = []
    for image, to_picture in zip(batch["images"].numpy(), batch["to_picture"].numpy(), strict=True):
        gray = image[:3].astype(float).mean(axis=0)
        weight = np.where(gray > gray.max() / 2, gray, 0)
        v, u = np.mgrid[: gray.shape[0], : gray.shape[1]]
        centre = np.array([(weight * u).sum(), (weight * v).sum()]) / weight.sum()
        found = apply_homography(to_picture, [(centre - 0.5) / 2])
        half_pixels.append(np.linalg.norm(normalized - found, axis=1).min() * SIZE[0] / 2)
    assert max(half_pixels) < 0.3  # pixels of the camera's picture


def test_goals_are_exchanged_between_attempts():
    recipe = KeypointRecipe(ATTEMPTS)
    labels = {
        (tuple(np.float32(a.outcome.executed.pick.xy)), tuple(np.float32(a.outcome.executed.place.xy)))
        for a in ATTEMPTS
    }
    batches = [recipe.batch(np.random.default_rng(seed))["xy"].numpy() for seed in range(4)]
    pairs = {(tuple(pick), tuple(place)) for batch in batches for pick, place in batch}
    assert len(pairs - labels) > len(pairs) / 2


def test_batches_follow_from_their_seed():
    recipes = KeypointRecipe(ATTEMPTS), RegressionRecipe(ATTEMPTS, "solid", (0, 200, 0), None)
    for recipe in recipes:
        one, same, other = (recipe.batch(np.random.default_rng(seed)) for seed in (4, 4, 5))
        assert all(torch.equal(one[name], same[name]) for name in one)
        assert not torch.equal(one["images"], other["images"])


# --- stacks
# --------------------------------------------------------------------------------------------------------------------

STACKING = make_stacking(30, 0, SIZE, bags=2)
SURE_STEPS = 90


@pytest.fixture(scope="module")
def stacker(tmp_path_factory):
    torch.set_num_threads(1)
    out = tmp_path_factory.mktemp("stacker")
    train(options(out, train=28, val=2, steps=SURE_STEPS), STACKING)
    return load_policy(out)


def test_of_two_bags_the_one_pointed_at_is_picked_and_places_are_right_in_any_layer(stacker, below):
    picks, places, chosen = [], [], []
    for seed in range(4):
        rng = np.random.default_rng([7, seed])
        low = Lying(PlanarPose(float(rng.uniform(0.4, 0.6)), -0.15, 0.3), 0, COLORS[0])
        under = Lying(PlanarPose(float(rng.uniform(0.4, 0.6)), 0.12, -0.2), 0, COLORS[2])
        high = replace(under, layer=1, color=COLORS[1])
        seen = observe_bags([low, under, high], rng, SIZE)
        for layer, bag in enumerate((low, high)):
            to = PlanarPose(0.61, float(rng.uniform(-0.08, -0.02)), 0.1)
            goal = Goal(box_corners(to, SIZE, layer + 2), layer=layer + 2, object_layer=bag.layer)
            at = box_corners(bag.pose, SIZE, bag.layer).mean(axis=0) + rng.uniform(-3, 3, 2)
            action = stacker.plan(seen, replace(goal, object_at=tuple(at))).action
            picks.append(action.pick.distance(bag.pose))
            places.append(action.place.distance(to))
            assert (action.pick_on_m, action.place_on_m) == (bag.layer * LAYER_M, (layer + 2) * LAYER_M)
        free = stacker.plan(seen, goal).action.pick
        chosen.append(min(free.distance(low.pose), free.distance(high.pose)))
    below("pick (m)", max(picks), 0.015)
    below("place (m), at least 0.013 if layers were not heeded", max(places), 0.012)
    below("without anybody pointing, to the nearer bag (m)", max(chosen), 0.04)


def test_of_bags_side_by_side_in_a_row_the_one_pointed_at_is_picked(stacker, below):
    picks, goal = [], Goal(box_corners(PlanarPose(0.42, -0.25), SIZE))
    for seed in range(4):
        rng = np.random.default_rng([9, seed])
        row = [
            Lying(PlanarPose(0.55, y), 0, color)
            for y, color in zip((-0.13, 0.0, 0.13), COLORS[:3], strict=True)
        ]
        seen = observe_bags(row, rng, SIZE)
        for bag in row:
            at = box_corners(bag.pose, SIZE).mean(axis=0) + rng.uniform(-3, 3, 2)
            picks.append(
                stacker.plan(seen, replace(goal, object_at=tuple(at))).action.pick.distance(bag.pose)
            )
    below("pick (m)", max(picks), 0.02)


def test_nobody_has_to_point_at_one_of_many_bags_and_an_empty_table_is_told_from_them(stacker, below):
    rng = np.random.default_rng(8)
    goal = Goal(box_corners(PlanarPose(0.5, 0.0), SIZE))
    places = [PlanarPose(x, y) for x in (0.4, 0.6) for y in (-0.2, -0.07, 0.06, 0.2)]
    colors = (*COLORS, *((b, r, g) for r, g, b in COLORS))
    many = [Lying(pose, 0, color) for pose, color in zip(places, colors, strict=True)]
    alone, among = (stacker.plan(observe_bags(bags, rng, SIZE), goal) for bags in (many[:1], many))
    below("of many bags, to the nearest (m)", min(among.action.pick.distance(pose) for pose in places), 0.02)
    below("1 - confidence among many", 1 - among.confidence, 0.7)
    below("1 - confidence alone", 1 - alone.confidence, 0.7)
    with pytest.raises(BaggieError, match="no bag in sight"):
        stacker.plan(observe_bags([], rng, SIZE), goal)


def test_labels_of_stacks_are_exact_in_their_layers_and_what_was_picked_is_pointed_at():
    recipe = KeypointRecipe(STACKING)
    layers = set()
    for seed in range(5):
        batch = recipe.batch(np.random.default_rng(seed))
        points = planar_map.apply_homographies(batch["to_picture"].unsqueeze(1), batch["cells"])
        found = recipe.policy.network.to_robot(points, batch["layers"])
        assert torch.allclose(found, batch["xy"], atol=2e-5)
        beside = (batch["near"][:, :2] - batch["cells"][:, 0]).norm(dim=-1)
        assert (beside < STACKED_CELLS - 2).all(), (
            "the middle of what is pointed at is within, and what is around it"
        )
        assert (beside > 0).any()
        assert (batch["near"][:, 2] == STACKED_CELLS).all()
        layers |= {tuple(pair) for pair in batch["layers"].tolist()}
    assert len(layers) == 4, "any goal, with its layer, in any picture"
    assert any(p is recipe.policy.network.to_robot.lift for p in recipe.optimizer().param_groups[1]["params"])


def test_a_pick_is_read_near_where_it_was_and_its_heat_map_stays_whole():
    recipe = KeypointRecipe(STACKING)
    network, batch = recipe.policy.network.eval(), recipe.batch(np.random.default_rng(0))
    given = batch["images"], batch["to_picture"]
    with torch.no_grad():
        whole, there = network(*given), network(*given, batch["near"], batch["layers"])
        elsewhere = network(*given, batch["near"] + torch.tensor([15.0, 0.0, 0.0]), batch["layers"])
    for found, near in ((there, batch["near"]), (elsewhere, batch["near"] + torch.tensor([15.0, 0.0, 0.0]))):
        assert torch.equal(found.logits, whole.logits)
        assert torch.equal(found.cells[:, 1], whole.cells[:, 1])
        assert ((found.cells[:, 0] - near[:, :2]).norm(dim=-1) <= STACKED_CELLS).all()
    assert not torch.equal(there.cells[:, 0], elsewhere.cells[:, 0])


def test_what_lies_in_a_stack_or_right_beside_others_is_not_changed_in_pictures():
    attempts = make_stacking(24, 2, SIZE, bags=2)
    recipe = KeypointRecipe(attempts, KeypointOptions(changes=Changes(new_looks=1.0)))
    beside = [Lying(PlanarPose(0.5, y, 0.0), 0, color) for y, color in ((0.0, COLORS[0]), (0.13, COLORS[1]))]
    touching = replace(
        attempts[0],
        before=observe_bags(beside, np.random.default_rng(0), SIZE),
        box_before=box_corners(beside[0].pose, SIZE),
        pick_layer=0,
    )
    crowded = KeypointRecipe([touching, *attempts[1:]], recipe.options)
    changed = [
        any(
            not np.array_equal(
                recipe.samples.draw(np.random.default_rng(seed), number, number).shape.linear, np.eye(2)
            )
            for seed in range(8)
        )
        for number in range(len(attempts))
    ]
    in_stacks = [number for number, attempt in enumerate(attempts) if attempt.pick_layer]
    alone = [number for number in range(len(attempts)) if number not in in_stacks]
    assert len(in_stacks) > 3
    assert not any(changed[number] for number in in_stacks)
    assert sum(changed[number] for number in alone) > len(alone) / 2
    shapes = [crowded.samples.draw(np.random.default_rng(seed), 0, 0).shape for seed in range(8)]
    assert all(np.array_equal(shape.linear, np.eye(2)) for shape in shapes)


class OnTheTable(KeypointRecipe):
    """Says of everything that it lies on the table."""

    def batch(self, rng):
        batch = super().batch(rng)
        return batch | {"layers": torch.zeros(len(batch["xy"]), 2)}


def test_where_all_lies_on_the_table_a_policy_is_as_if_nobody_counted_to_the_bit(tmp_path):
    """And it learns nothing of layers."""
    names = {"images", "to_picture", "cells", "xy", "weight", "yaw", "yaw_weight", "phases"}
    assert KeypointRecipe(ATTEMPTS).batch(np.random.default_rng(0)).keys() == names
    for name, recipe in (("plain", KeypointRecipe), ("table", OnTheTable)):
        train(options(tmp_path / name, steps=3), ATTEMPTS, recipe)
    plain, table = weights(tmp_path / "plain"), weights(tmp_path / "table")
    assert all(torch.equal(plain[name], table[name]) for name in plain)
    counted = [replace(attempt, pick_layer=0, place_layer=0) for attempt in ATTEMPTS]
    train(options(tmp_path / "counted", steps=2), counted)
    policy = load_policy(tmp_path / "counted")
    assert not policy.knows_layers
    with pytest.raises(BaggieError, match="collect bag-stack"):
        policy.plan(ATTEMPTS[0].before, replace(goal_of(ATTEMPTS[0]), layer=1))


# --- going on, and what stops it
# ------------------------------------------------------------------------------------


def weights(out: Path) -> dict[str, torch.Tensor]:
    return load_policy(out).network.state_dict()


KILLED = """
import sys
from pathlib import Path
sys.path.insert(0, {tests!r})
import torch
torch.set_num_threads(1)
import test_learning
test_learning.train(test_learning.options(Path({out!r}), save_every_s=0.0, steps=9), test_learning.ATTEMPTS)
"""


@pytest.mark.slow
def test_a_killed_training_ends_in_the_same_weights(tmp_path):
    code = KILLED.format(tests=str(Path(__file__).parent), out=str(tmp_path / "killed"))
    child = subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.DEVNULL)
    resume = tmp_path / "killed" / FILE
    deadline = time.monotonic() + 120
    step = 0
    while step < 3 and child.poll() is None and time.monotonic() < deadline:
        time.sleep(0.02)
        step = torch.load(resume, weights_only=True)["step"] if resume.exists() else 0
    child.send_signal(signal.SIGKILL)
    assert child.wait() == -signal.SIGKILL, "it should not have come to its end"
    assert not (tmp_path / "killed" / "metrics.json").exists()
    at_kill = torch.load(resume, weights_only=True)["step"]
    assert 3 <= at_kill < 9

    train(options(tmp_path / "killed", steps=9), ATTEMPTS)
    train(options(tmp_path / "whole", steps=9), ATTEMPTS)
    killed, whole = weights(tmp_path / "killed"), weights(tmp_path / "whole")
    assert all(torch.equal(killed[name], whole[name]) for name in whole)


def test_after_ctrl_c_it_says_how_to_go_on_and_ends_in_the_same_weights(tmp_path, monkeypatch):
    made, asked = KeypointRecipe.batch, options(tmp_path / "a", train=4, val=1, steps=3)

    def interrupting(self, rng):
        os.kill(os.getpid(), signal.SIGINT)
        monkeypatch.setattr(KeypointRecipe, "batch", made)
        return made(self, rng)

    monkeypatch.setattr(KeypointRecipe, "batch", interrupting)
    with pytest.raises(KeyboardInterrupt, match="run the same command again to go on"):
        train(asked, ATTEMPTS)
    assert torch.load(tmp_path / "a" / FILE, weights_only=True)["step"] >= 1
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert train(asked, ATTEMPTS)["steps"] == 3
    train(replace(asked, out=tmp_path / "whole"), ATTEMPTS)
    interrupted, whole = weights(tmp_path / "a"), weights(tmp_path / "whole")
    assert all(torch.equal(interrupted[name], whole[name]) for name in whole)


class SecondOfTwo:
    """An accelerator of which there are two; the first hears Ctrl-C while both are at the third step."""

    def __init__(self, accelerator):
        self.accelerator, self.num_processes, self.is_main_process, self.asked = accelerator, 2, False, 0

    def __getattr__(self, name):
        return getattr(self.accelerator, name)

    def check_trigger(self):
        self.asked += 1
        return self.asked == 3


def test_ctrl_c_stops_all_processes_after_the_same_step(tmp_path):
    training = TrainingLoop(
        KeypointRecipe(ATTEMPTS[:8]),
        tmp_path,
        steps=6,
        seed=0,
        save_every_s=60.0,
        accelerator=SecondOfTwo(Accelerator(cpu=True)),
        operator=Nobody(),
    )
    with pytest.raises(KeyboardInterrupt, match="stopped after 3 of 6 steps"):
        training.run(lambda _policy: {})
    assert not (tmp_path / FILE).exists()  # the first process saves, for all


INTERRUPTED = """
import sys
from pathlib import Path
sys.path.insert(0, {tests!r})
import test_learning
test_learning.train(test_learning.options(Path({out!r}), save_every_s=0.0, steps=2000), test_learning.ATTEMPTS)
"""


@pytest.mark.slow
def test_ctrl_c_that_one_of_two_processes_hears_ends_and_saves_both(tmp_path):
    code = INTERRUPTED.format(tests=str(Path(__file__).parent), out=str(tmp_path / "run"))
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    told = {"WORLD_SIZE": "2", "MASTER_ADDR": "127.0.0.1", "MASTER_PORT": str(port), "OMP_NUM_THREADS": "1"}
    both = [
        subprocess.Popen(
            [sys.executable, "-c", code],
            env=os.environ | told | {"RANK": rank, "LOCAL_RANK": rank},
            stderr=subprocess.PIPE,
            text=True,
        )
        for rank in "01"
    ]
    deadline = time.monotonic() + 120
    while time.monotonic() < deadline and not (tmp_path / "run" / FILE).exists():
        time.sleep(0.05)
    both[1].send_signal(signal.SIGINT)
    said = [process.communicate(timeout=60)[1] for process in both]
    assert all("KeyboardInterrupt: stopped after" in words for words in said), said
    assert torch.load(tmp_path / "run" / FILE, weights_only=True)["step"] >= 1


def test_a_training_goes_on_where_it_was_begun_and_nowhere_else(tmp_path):
    part = torch.nn.Linear(1, 1)
    begun, elsewhere = (
        TrainingState(part, torch.optim.SGD(part.parameters()), None, where)
        for where in ("cuda with 2", "cpu")
    )
    begun.save(tmp_path)
    begun.load(tmp_path)
    with pytest.raises(DataError, match="begun on cuda with 2, not on cpu"):
        elsewhere.load(tmp_path)


def test_other_attempts_of_the_same_names_are_another_training(tmp_path):
    train(options(tmp_path, steps=1), ATTEMPTS)
    moved = [
        replace(attempt, commanded=PickPlace(attempt.commanded.place, attempt.commanded.pick))
        for attempt in ATTEMPTS
    ]
    with pytest.raises(DataError, match="other options or data"):
        train(options(tmp_path, steps=1), moved)
    path = tmp_path / "config.yaml"
    config = yaml.safe_load(path.read_text())
    assert config["training"]["task"] == ATTEMPTS[0].task
    del config["training"]["labels"], config["training"]["task"]  # as an older version wrote it
    path.write_text(yaml.safe_dump(config))
    assert train(options(tmp_path, steps=1), ATTEMPTS)["steps"] == 1


def test_a_finished_run_says_so_and_is_left_alone(overfitted, capsys):
    before = (overfitted / "policy.safetensors").stat().st_mtime_ns
    metrics = train(options(overfitted, steps=ENOUGH), ATTEMPTS)
    assert metrics == json.loads((overfitted / "metrics.json").read_text())
    assert (overfitted / "policy.safetensors").stat().st_mtime_ns == before
    assert "finished" in capsys.readouterr().err


def test_another_training_in_the_same_folder_is_refused(overfitted):
    for changes in ({"steps": ENOUGH + 1}, {"steps": ENOUGH, "seed": 1}, {"steps": ENOUGH, "train": 7}):
        with pytest.raises(DataError, match="other options or data"):
            train(options(overfitted, **changes), ATTEMPTS)


@pytest.mark.parametrize("policy", ["keypoint", "regression"])
def test_a_run_that_an_older_version_began_is_this_very_training(tmp_path, policy):
    """It wrote down options of other policies, too, as nobody could have chosen them."""
    asked = options(tmp_path, policy, train=4, val=1, steps=1)
    train(asked, ATTEMPTS)
    config = yaml.safe_load((tmp_path / "config.yaml").read_text())
    config["training"] = {"weights": None, "new_looks": 0.25, "rearranged": None} | config["training"]
    (tmp_path / "config.yaml").write_text(yaml.safe_dump(config))
    before = (tmp_path / "policy.safetensors").stat().st_mtime_ns
    train(asked, ATTEMPTS)
    assert (tmp_path / "policy.safetensors").stat().st_mtime_ns == before


def test_a_damaged_state_is_one_clear_line(tmp_path):
    train(options(tmp_path, steps=1), ATTEMPTS)
    (tmp_path / "metrics.json").unlink()
    (tmp_path / FILE).write_bytes((tmp_path / FILE).read_bytes()[:5000])
    with pytest.raises(DataError, match=r"resume\.pt cannot be read") as error:
        train(options(tmp_path, steps=1), ATTEMPTS)
    assert "\n" not in str(error.value)


# --- which attempts
# -------------------------------------------------------------------------------------------------


@given(st.integers(2, 600))
@example(2)
@example(250)
def test_of_what_there_is_four_fifths_teach_and_one_fifth_measures(there):
    train, val = shares(there, None, None, ("attempts", "that succeeded"))
    assert train <= USUAL_TRAIN
    assert val <= USUAL_VAL
    assert 1 <= val <= train
    assert train + val == min(there, USUAL_TRAIN + USUAL_VAL)
    if there <= 250:
        assert abs(train - 0.8 * there) < 0.7


@given(st.integers(1, 300), st.integers(1, 300), st.integers(0, 300))
def test_numbers_that_are_given_are_kept_or_refused(there, train, val):
    if train + val <= there:
        assert shares(there, train, val, ("attempts", "that succeeded")) == (train, val)
    else:
        with pytest.raises(
            DataError, match=rf"needs {train + val} that succeeded, but the recording has {there}"
        ):
            shares(there, train, val, ("attempts", "that succeeded"))
    if train < there:
        assert shares(there, train, None, ("attempts", "that succeeded")) == (
            train,
            min(there - train, USUAL_VAL),
        )
    if 0 < val < there:
        assert shares(there, None, val, ("attempts", "that succeeded")) == (
            min(there - val, USUAL_TRAIN),
            val,
        )


def test_a_small_recording_teaches_and_says_how_much_of_it(tmp_path, capsys):
    train(options(tmp_path, train=None, val=None, steps=1), ATTEMPTS)
    split = load_policy(tmp_path).training["split"]
    assert (split["train"], split["val"]) == ([*range(8)], [8, 9])
    assert "learning from 8 attempts, measuring on 2 others" in capsys.readouterr().err


def test_failures_are_never_learned_from():
    failed = [make_attempt(i, np.random.default_rng(i), SIZE, failure="dropped", depth=False) for i in (0, 3)]
    split = Split.of(sorted([*failed, *ATTEMPTS[4:]], key=lambda a: a.attempt_id), 4, 2)
    assert [a.attempt_id for a in split.train] == [4, 5, 6, 7]
    assert [a.attempt_id for a in split.val] == [8, 9]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda a: a[:9], "needs 10 that succeeded, but the recording has 9"),
        (lambda a: [*a[:9], replace(a[9], cell=4)], "mixes cells"),
        (
            lambda a: [*a[:9], make_attempt(9, np.random.default_rng(9), (160, 90), depth=False)],
            "mixes picture sizes",
        ),
    ],
)
def test_unfit_recordings_are_one_clear_line(tmp_path, change, message):
    with pytest.raises(DataError, match=message) as error:
        train(options(tmp_path), change(ATTEMPTS))
    assert "\n" not in str(error.value)


def test_a_folder_that_cannot_be_written(tmp_path):
    (tmp_path / "taken").write_text("a file")
    with pytest.raises(DataError, match="cannot be written") as error:
        train(options(tmp_path / "taken" / "run"), ATTEMPTS)
    assert "\n" not in str(error.value)


def test_goals_a_policy_cannot_tell_are_counted(overfitted):
    policy = load_policy(overfitted)
    far = replace(ATTEMPTS[9], box_after=np.array([[5.0, 5], [25, 5], [25, 25], [5, 25]]))
    measured = plan_errors(policy, [ATTEMPTS[8], far])
    assert measured["without_plan"] == 1
    assert measured["labels"]["pick_error_cm"]["n"] == 1
    assert plan_errors(policy, [far]) == {"without_plan": 1}


@pytest.mark.parametrize(("symmetry", "off_deg"), [(1, 90), (2, 90), (4, 0), (0, 0)])
def test_yaws_are_compared_modulo_the_object_s_symmetry(symmetry, off_deg):
    class QuarterTurned:
        name = "turned"

        def plan(self, observation, goal=None):
            right = next(a for a in ATTEMPTS if a.before is observation).outcome.executed
            return Plan(replace(right, pick=replace(right.pick, yaw=right.pick.yaw + np.pi / 2)))

    labels = plan_errors(QuarterTurned(), ATTEMPTS[:3], symmetry)["labels"]
    assert labels["pick_yaw_error_deg"]["max"] == pytest.approx(off_deg, abs=1e-6)
    assert labels["turn_error_deg"]["max"] == pytest.approx(off_deg, abs=1e-6)
    assert labels["place_yaw_error_deg"]["max"] == pytest.approx(0)


@pytest.mark.parametrize(("symmetry", "off_deg"), [(None, 0), (1, 90), (2, 90), (4, 0), (0, 0)])
def test_yaws_are_compared_as_each_attempt_says(symmetry, off_deg):
    square, other = (replace(ATTEMPTS[0], object_symmetry=each) for each in (4, symmetry))

    class QuarterTurned:
        name = "turned"

        def plan(self, observation, goal=None):
            right = ATTEMPTS[0].outcome.executed
            return Plan(replace(right, pick=replace(right.pick, yaw=right.pick.yaw + np.pi / 2)))

    errors = plan_errors(QuarterTurned(), [square, other])["labels"]["pick_yaw_error_deg"]
    assert errors["mean"] == pytest.approx(off_deg / 2, abs=1e-6)


def test_a_device_that_is_not_there(tmp_path, monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(BaggieError, match="device cuda was asked for"):
        train(options(tmp_path, device="cuda"), ATTEMPTS)


def test_weights_are_for_a_resnet(tmp_path):
    with pytest.raises(BaggieError, match="add --backbone resnet18"):
        train(options(tmp_path, weights="some/where"), ATTEMPTS)


@pytest.mark.parametrize("changes", [{"goal_style": "outline"}, {"goal_color": (200, 0, 0)}])
def test_the_look_of_goals_that_are_never_painted_is_refused(tmp_path, changes):
    (name,) = changes
    message = (
        f"expected no --{name.replace('_', '-')} with --goal-input region, .* got .*add --goal-input painted"
    )
    with pytest.raises(BaggieError, match=message):
        train(options(tmp_path, **changes), ATTEMPTS)
    options(tmp_path, goal_input="painted", **changes).check()


def test_the_published_recipe_takes_goals_of_any_look_and_published_weights(tmp_path):
    published = ResNet18().state_dict()
    torch.save(published, tmp_path / "resnet18.pth")
    look = {"goal_style": "outline", "goal_color": (1, 2, 3)}
    asked = options(tmp_path, policy="regression", weights=str(tmp_path / "resnet18.pth"), **look)
    asked.check()
    policy = RegressionRecipe.of(asked, ATTEMPTS[:1]).policy
    assert (policy.goal_input.style, policy.goal_input.color) == ("outline", (1, 2, 3))
    for part in (policy.network.pick, policy.network.place):
        assert torch.equal(part.resnet.conv1.weight, published["conv1.weight"])
        assert torch.equal(part.resnet.layer2[1].conv2.weight, published["layer2.1.conv2.weight"])


def test_a_keypoint_policy_starts_from_published_weights(tmp_path):
    published = ResNet18().state_dict()
    torch.save(published, tmp_path / "resnet18.pth")
    chosen = KeypointOptions(backbone="resnet18", weights=str(tmp_path / "resnet18.pth"))
    features = KeypointRecipe(ATTEMPTS, chosen).policy.network.features.state_dict()
    assert torch.equal(features["layer2.1.conv2.weight"], published["layer2.1.conv2.weight"])
    assert torch.equal(features["conv1.weight"], published["conv1.weight"])


@pytest.mark.parametrize("changes", [{"backbone": "resnet18"}, {"goal_input": "painted"}, {"new_looks": 1.0}])
def test_every_kind_of_keypoint_policy_trains_and_loads(tmp_path, changes):
    train(options(tmp_path, steps=2, **changes), ATTEMPTS)
    policy = load_policy(tmp_path)
    assert isinstance(policy, KeypointPolicy)
    with torch.no_grad():
        policy.network.heat.weight.mul_(300)  # as sure as a trained one
    check_policy(policy, ATTEMPTS[0].before, goal_of(ATTEMPTS[0]))


def test_a_real_card_is_seen_and_not_drawn(overfitted, tmp_path):
    """A painted policy plans alike for a goal it paints and for a card that was there before."""
    train(options(tmp_path, steps=2, goal_input="painted", goal_color=(10, 180, 60)), ATTEMPTS)
    policy = load_policy(tmp_path)
    with torch.no_grad():
        policy.network.heat.weight.mul_(300)
    drawn = goal_of(ATTEMPTS[0])
    there = replace(
        ATTEMPTS[0].before, color=paint_goal(ATTEMPTS[0].before.color, replace(drawn, color=(10, 180, 60)))
    )
    card = policy.plan(there, replace(drawn, style="card")).action
    assert policy.plan(ATTEMPTS[0].before, drawn).action.place.distance(card.place) < 0.003


# --- how sure it may be
# ---------------------------------------------------------------------------------------------


def inside_radii(policy, attempts) -> np.ndarray:
    """How many picks and places `(2,)` are within the radii that the policy states."""
    inside = []
    for attempt in attempts:
        plan, executed = policy.plan(attempt.before, goal_of(attempt)), attempt.outcome.executed
        inside.append(
            [
                plan.action.pick.distance(executed.pick) <= plan.pick_within_m + 1e-6,
                plan.action.place.distance(executed.place) <= plan.place_within_m + 1e-6,
            ]
        )
    return np.sum(inside, axis=0)


def test_radii_hold_nine_of_ten_errors_of_the_attempts_they_were_set_on_and_about_as_many_of_others(
    overfitted,
):
    policy = load_policy(overfitted)
    _, held_out, new = np.split(np.array(make_attempts(70), dtype=object), [10, 30])
    agreed = Disagreement(np.zeros(2), np.ones(2), np.zeros((3, 2)))
    assert calibrate_radii(policy, list(held_out), agreed, 2) is not None
    picks, places = inside_radii(policy, held_out)
    assert places == 19  # ⌈0.9 · 21⌉ of 20
    assert picks >= 19
    assert (inside_radii(policy, new) >= 30).all()  # 3 standard deviations below nine tenths of 40


def test_a_second_opinion_narrows_what_labels_may_be_off_alike(overfitted):
    policy = load_policy(overfitted)
    held_out = make_attempts(30)[10:]
    goal, picture = goal_of(held_out[0]), held_out[0].before
    agreed = Disagreement(np.zeros(2), np.ones(2), np.zeros((3, 2)))
    radii = []
    for opinions in (1, 2):
        calibrate_radii(policy, held_out, agreed, opinions)
        plan = policy.plan(picture, goal)
        radii.append((plan.pick_within_m, plan.place_within_m))
    assert radii[0][0] ** 2 - radii[1][0] ** 2 == pytest.approx(SYSTEMATIC_M**2 / 2 * math.log(10), rel=1e-3)
    assert radii[0][1] == radii[1][1]


def test_without_enough_held_out_attempts_nothing_is_said(overfitted):
    policy = load_policy(overfitted)
    agreed = Disagreement(np.zeros(2), np.ones(2), np.zeros((3, 2)))
    assert calibrate_radii(policy, ATTEMPTS[:9], agreed, 2) is None
    plan = policy.plan(ATTEMPTS[0].before, goal_of(ATTEMPTS[0]))
    assert plan.pick_within_m is None
    assert plan.place_within_m is None


# --- helpers
# --------------------------------------------------------------------------------------------------------


def test_prefetching_keeps_the_order_and_passes_errors_on():
    for workers in (1, 3):
        made = prefetched(lambda step: step * step, range(3, 20), workers)
        assert list(made) == [step * step for step in range(3, 20)]
    assert list(prefetched(str, range(5, 5))) == []
    with pytest.raises(ZeroDivisionError):
        list(prefetched(lambda step: 1 // (step - 2), range(5)))


def interrupted_twice() -> None:
    with deferred_interrupt() as asked:
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.01)
        assert asked.is_set()
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(1)


def test_a_second_ctrl_c_breaks():
    with pytest.raises(KeyboardInterrupt):
        interrupted_twice()
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
