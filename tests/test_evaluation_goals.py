"""Goals of every kind: the scenes stay the same, a card counts only where it is seen, nothing is put on anything."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from baggie import seeds
from baggie.calibration.files import CameraIdentity
from baggie.calibration.image_to_robot.map import ImageToRobot
from baggie.collect.machine import MIN_DISTANCE_M
from baggie.errors import BaggieError, DataError, UnsureError
from baggie.evaluation.episode import CLEARANCE_M, CLICK_M, draw_goal, goal_in
from baggie.evaluation.log import read_episodes
from baggie.evaluation.setup import Setup, card_map
from baggie.geometry import PlanarPose, Rectangle
from baggie.options.evaluating import EvaluateOptions
from baggie.options.values import CARD_COLOR
from baggie.policies.baselines import OraclePolicy
from baggie.sim.bag import Bag
from baggie.tasks.conditions import State
from baggie.tasks.task import Scene
from baggie.types import Goal, Observation
from baggie.vision.draw import paint_goal
from helpers.bag_evaluations import FakeCell, evaluate_here, open_perfect, options, timeless
from helpers.synthetic import WORKSPACE, intrinsics, to_pixels

CARD = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * 0.065
KINDS = ("virtual", "turned", "card")


class Table(FakeCell):
    """A cell in which the goal card, lying on the table, is seen, and things stand where the test says."""

    def __init__(self, second=None, obstacles=(), symmetry=4, card_shows=True):
        super().__init__()
        self.settings = replace(self.settings, object_symmetry=symmetry)
        self.second, self.standing, self.card_shows = second, list(obstacles), card_shows
        self.card = None

    def reset(self, seed):
        super().reset(seed)
        if self.second:
            bags = Bag(), Bag(name="second bag")
            self.scene = Scene(bags, {"bag": self.bag, "second bag": self.second})

    def state(self):
        places = {"bag": self.bag} | ({"second bag": self.second} if self.second else {})
        return State({}, places, tuple(self.standing))

    def look(self):
        image = np.full((720, 1280, 3), 120, np.uint8)
        if self.card is not None and self.card_shows:
            flat = np.c_[CARD, np.ones(4)] @ self.card.matrix().T
            image = paint_goal(image, Goal(to_pixels(np.c_[flat[:, :2], np.zeros(4)]), color=CARD_COLOR))
        return Observation(image)

    def outline(self, pose):
        half = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * 0.06
        flat = np.c_[half, np.ones(4)] @ pose.matrix().T
        return to_pixels(np.c_[flat[:, :2], np.full(4, 0.015)])


def stream(seed, number):
    return (seeds.EVALUATION, seed, number)


def scene(cell, seed, number):
    cell.reset(stream(seed, number))
    return cell


def drawn(cell, kind, names):
    return draw_goal(cell, cell.bag, kind, names)


@pytest.fixture(scope="module")
def drawn_map():
    x, y, z = np.meshgrid(np.linspace(0.3, 0.7, 5), np.linspace(-0.3, 0.3, 5), (0.07, 0.17))
    robot = np.c_[x.ravel(), y.ravel(), z.ravel()]
    camera = CameraIdentity("drawn", 1280, 720)
    return ImageToRobot.fit(to_pixels(robot), robot, camera, intrinsics=intrinsics())


@pytest.mark.parametrize(
    ("seed", "number", "x", "y"),
    [
        (0, 0, 0.5556907075269759, 0.18450621567971268),
        (0, 1, 0.4209834345155555, -0.03356377634660873),
        (0, 2, 0.42950444397564647, -0.19269912720809151),
        (7, 0, 0.3819291067922154, -0.1840969787117102),
    ],
)
def test_goals_of_the_plain_closed_loop_are_what_they_always_were(seed, number, x, y):
    goal = drawn(scene(FakeCell(), seed, number), "virtual", stream(seed, number))
    assert (goal.x, goal.y, goal.yaw) == (x, y, 0.0)
    for kind in ("turned", "card"):  # the others differ in the angle alone
        turned = drawn(scene(FakeCell(), seed, number), kind, stream(seed, number))
        assert (turned.x, turned.y) == (x, y)
        assert turned.yaw != 0.0


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**20), st.sampled_from(KINDS), st.sampled_from([0, 2, 4]), st.integers(0, 2))
def test_goals_keep_clear_of_everything(seed, kind, symmetry, things):
    rng = np.random.default_rng(seed)
    standing = [PlanarPose(*map(float, WORKSPACE.sample(rng))) for _ in range(things)]
    cell = scene(Table(standing[0] if standing else None, standing[1:], symmetry), seed, 0)
    cell.settings = replace(cell.settings, workspace=Rectangle(0.2, 0.8, -0.4, 0.4))  # there is always room
    goal = drawn(cell, kind, stream(seed, 0))
    assert cell.settings.workspace.contains(goal.x, goal.y)
    assert goal.distance(cell.bag) >= MIN_DISTANCE_M
    assert all(goal.distance(other) >= CLEARANCE_M for other in standing)
    assert abs(goal.yaw) <= math.pi / max(symmetry, 1)


def test_a_full_table_is_told():
    everywhere = [PlanarPose(x, y) for x in (0.4, 0.5, 0.6) for y in np.arange(-0.25, 0.3, 0.1)]
    with pytest.raises(BaggieError, match="clear the workspace"):
        drawn(scene(Table(obstacles=everywhere), 0, 0), "virtual", stream(0, 0))


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**20))
def test_a_click_is_on_the_bag_to_be_moved_and_only_where_there_are_two(seed):
    cell = scene(Table(second=PlanarPose(0.4, 0.2)), seed, 0)
    setup = Setup(cell, OraclePolicy(cell.demonstrate))
    goals = [goal_in(setup, "virtual", PlanarPose(0.5, 0), cell.look(), stream(seed, 0)) for _ in range(2)]
    assert goals[0].object_at == goals[1].object_at
    bag = cell.bag
    rim = np.linspace(0, 2 * np.pi, 90)
    away = to_pixels(np.c_[bag.x + CLICK_M * np.cos(rim), bag.y + CLICK_M * np.sin(rim), np.full(90, 0.015)])
    middle = cell.outline(bag).mean(axis=0)
    assert (
        np.linalg.norm(np.array(goals[0].object_at) - middle)
        <= 1.02 * np.linalg.norm(away - middle, axis=1).max()
    )
    alone = Setup(scene(Table(), seed, 0), setup.policy)
    assert goal_in(alone, "virtual", PlanarPose(0.5, 0), cell.look(), stream(seed, 0)).object_at is None


@settings(max_examples=15, deadline=None)
@given(st.floats(0.38, 0.62), st.floats(-0.22, 0.22), st.floats(-0.78, 0.78))
def test_a_raised_card_is_where_a_bag_on_it_would_be_seen_and_one_as_seen_is_not(drawn_map, x, y, yaw):
    pose, cell = PlanarPose(x, y, yaw), scene(Table(), 0, 0)
    cell.lay_card(pose)
    off = []
    for to_robot in (drawn_map, None):
        setup = Setup(cell, OraclePolicy(cell.demonstrate), to_robot)
        goal = goal_in(setup, "card", pose, cell.look(), stream(0, 0))
        assert goal.style == "card"
        assert np.allclose(goal.color, CARD_COLOR, atol=2)
        off.append(np.linalg.norm(goal.center - cell.outline(pose).mean(axis=0)))
    assert off[0] < 0.3
    middle = np.array([[x, y, 0.0], [x, y, 0.015]])
    parallax = np.linalg.norm(np.diff(to_pixels(middle), axis=0))
    assert off[1] == pytest.approx(parallax, abs=0.3)


class PictureOracle(OraclePolicy):
    """Knows the bag from the truth and the goal from the picture alone: its corners, by the drawn camera's map."""

    to_robot = None
    radii_m = (None, None)

    def plan(self, observation, goal):
        self.seen = goal
        plan = super().plan(observation, goal)
        x, y = self.to_robot.at_height(0.015).to_robot(goal.center)[0]
        place = PlanarPose(float(x), float(y))
        return replace(
            plan,
            action=replace(plan.action, place=place),
            pick_within_m=self.radii_m[0],
            place_within_m=self.radii_m[1],
        )


def opener(to_robot, radii_m=(None, None), **table):
    def open_own(_options):
        cell = Table(**table)
        policy = PictureOracle(cell.demonstrate)
        policy.to_robot, policy.radii_m = to_robot, radii_m
        return Setup(cell, policy, to_robot)

    return open_own


@pytest.mark.parametrize("kind", KINDS)
def test_a_bag_is_brought_to_a_goal_of_any_kind(tmp_path, drawn_map, kind):
    metrics = evaluate_here(options(tmp_path, goal=kind, episodes=4), opener(drawn_map))
    assert (metrics["goal"], metrics["scenery"]) == (kind, "plain")
    assert metrics["success"]["rate"] == 1.0
    assert metrics["place_error_cm"]["max"] == pytest.approx(metrics["distance_cm"]["max"])
    assert metrics["place_error_cm"]["max"] < 0.15  # a mean of corners is not quite the middle
    assert metrics["pick_error_cm"]["max"] == metrics["pick_yaw_error_deg"]["max"] == 0
    assert "confidence" not in metrics
    assert metrics["asked_for_help"]["rate"] == 0.0


def test_a_card_that_is_not_seen_is_a_failure_of_its_own_never_taken_from_the_truth(tmp_path, drawn_map):
    metrics = evaluate_here(options(tmp_path, goal="card", episodes=2), opener(drawn_map, card_shows=False))
    assert metrics["failures"] == {"no-card": 2}
    assert metrics["success"]["rate"] == 0.0
    assert "pick_error_cm" not in metrics
    assert all(line["steps"] == [] for line in timeless(tmp_path))
    assert all("lay it where the camera sees" in line["message"] for line in timeless(tmp_path))


def test_confidence_is_measured_and_what_is_too_unsure_asks_for_help(tmp_path, drawn_map, monkeypatch):
    metrics = evaluate_here(options(tmp_path / "sure"), opener(drawn_map, (0.004, 1e-7)))
    confidence = metrics["confidence"]
    assert confidence["pick_within"]["rate"] == 1.0
    assert confidence["place_within"]["rate"] == 0.0
    assert confidence["pick_radius_cm"]["mean"] == pytest.approx(0.4)
    assert {line["steps"][-1]["place_within_m"] for line in timeless(tmp_path / "sure")} == {1e-7}

    def refuse(self, plan):
        raise UnsureError("less sure than asked for")

    monkeypatch.setattr(Table, "carry_out", refuse)
    asked = evaluate_here(options(tmp_path / "unsure"), opener(drawn_map, (0.1, 0.1)))
    assert asked["failures"] == {"unsure": 5}
    assert asked["asked_for_help"]["rate"] == 1.0
    assert asked["pick_error_cm"]["n"] == 5
    assert {len(line["steps"]) for line in timeless(tmp_path / "unsure")} == {1}


def test_a_round_bag_has_no_wrong_angle(tmp_path, drawn_map):
    evaluate_here(options(tmp_path, episodes=2), opener(drawn_map, symmetry=0))
    for line in timeless(tmp_path):
        assert line["landing"]["yaw_error_deg"] == line["steps"][-1]["pick_yaw_error_deg"] == 0.0


@pytest.mark.parametrize("change", [{"goal": "turned"}, {"scenery": "unseen"}])
def test_another_goal_or_scenery_in_the_same_folder_is_refused(tmp_path, change):
    evaluate_here(options(tmp_path, episodes=1), open_perfect)
    with pytest.raises(
        BaggieError, match=f"{next(iter(change))} (virtual|plain), not {next(iter(change.values()))}"
    ):
        evaluate_here(options(tmp_path, episodes=1, **change), open_perfect)
    with pytest.raises(BaggieError, match="scenery among plain, light"):
        evaluate_here(options(tmp_path, scenery="moon"), open_perfect)


def test_a_log_of_another_version_is_refused_in_one_line(tmp_path):
    evaluate_here(options(tmp_path, episodes=1), open_perfect)
    log = tmp_path / "episodes.jsonl"
    record = json.loads(log.read_text())
    del record["steps"][0]["pick_error_cm"]
    log.write_text(json.dumps(record) + "\n")
    with pytest.raises(
        DataError, match=r"episodes.jsonl: .*without \['pick_error_cm'\].*evaluate again"
    ) as raised:
        read_episodes(tmp_path)
    assert "\n" not in str(raised.value)


def test_the_map_that_raises_a_card_is_that_of_the_recording_trained_on_or_given(tmp_path, drawn_map):
    recording, run, other = tmp_path / "recording", tmp_path / "run", tmp_path / "other"
    run.mkdir()
    config = {"policy": "keypoint", "cell": 0, "training": {"data": str(recording)}}
    (run / "config.yaml").write_text(yaml.safe_dump(config))

    def found(goal="card", **changes):
        return card_map(EvaluateOptions(**{"policy": str(run), "out": Path("x"), "goal": goal} | changes))

    assert found() is None  # there is no such recording
    drawn_map.save(recording / "calibration/image-to-robot.yaml")
    assert found() == recording / "calibration/image-to-robot.yaml"
    assert found("virtual") is None
    assert found(cell=3) is None  # another camera
    drawn_map.save(other / "image-to-robot.yaml")
    assert found(cell=3, calibration=other) == other / "image-to-robot.yaml"
    assert found(policy="oracle") is None
    assert found(policy="oracle", calibration=recording) is not None
    flat = to_pixels(
        np.c_[np.array(np.meshgrid([0.4, 0.5, 0.6], [-0.2, 0, 0.2])).reshape(2, -1).T, np.zeros(9)]
    )
    robot = np.c_[np.array(np.meshgrid([0.4, 0.5, 0.6], [-0.2, 0, 0.2])).reshape(2, -1).T, np.zeros(9)]
    ImageToRobot.fit(flat, robot, CameraIdentity("drawn", 1280, 720)).save(
        recording / "calibration/image-to-robot.yaml"
    )
    assert found() is None  # it knows one height only
