"""Policies that want goals are judged on patterns of stacked bags, by a builder that says the next goal."""

from __future__ import annotations

import json
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from baggie.errors import BaggieError, DataError
from baggie.evaluation.builder import MOST_ANEW
from baggie.evaluation.closed_loop import EvaluateOptions, evaluate
from baggie.evaluation.log import LOG, Credit, read_episodes
from baggie.evaluation.setup import Setup, check_taught, task_of
from baggie.evaluation.terms import Terms
from baggie.geometry import PlanarPose, apply_homography
from baggie.metrics import success_rate
from baggie.operator import Nobody
from baggie.options.evaluating import ReportOptions
from baggie.policies import OraclePolicy, Policy
from baggie.registry import TASKS
from baggie.report.report import report
from baggie.tasks.pattern import LAYER_M, Pattern
from baggie.tasks.stacked import Stacked
from baggie.tasks.task import Scene
from baggie.types import PickPlace, Plan
from baggie.workcell.simulated import SimulatedWorkcell
from helpers.reports import Page
from helpers.seen_bags import BagTable, Eye
from helpers.streaming import Here

SITE = PlanarPose(0.48, 0.1)
LOOSE = [PlanarPose(x, -0.2) for x in (0.3, 0.43, 0.56)]
STACKS = ("bag-tower", "bag-pyramid", "bag-layers")
evaluate_here = partial(evaluate, executor=Here())


def options(out: Path, **changes) -> EvaluateOptions:
    given = {"policy": "oracle", "out": out, "task": "bag-tower", "episodes": 1, "workers": 1, "film": 0}
    return EvaluateOptions(**given | changes)


class JudgedTable(BagTable):
    """A table on which a tower of two counts; of what lands nobody but the judge knows."""

    def reset(self, seed):
        self.__init__(LOOSE, self.landing)  # type: ignore[misc]

    def __init__(self, bags=LOOSE, landing=()):
        super().__init__(bags, landing)
        self.landing = landing
        names = tuple(f"bag {number}" for number in self.bags)
        self.scene = Scene(
            (), {}, (Stacked(names, Pattern.parse("tower:2").at(SITE), self.settings.workspace),)
        )

    def wait(self, seconds):
        pass

    @contextmanager
    def film(self, size=(64, 48), fps=20):
        yield []


def opens(landing):
    def open_table(_options):
        cell = JudgedTable(landing=landing)
        return Setup(cell, Eye(cell))

    return open_table


def test_a_policy_that_wants_goals_is_given_those_of_the_pattern(tmp_path: Path) -> None:
    metrics = evaluate_here(options(tmp_path, episodes=2), opens([(0.0, 0.012), (0.0, 0.0), (0.0, 0.004)]))
    assert metrics["success"] == success_rate(2, 2)
    assert metrics["steps"]["mean"] == 3  # the first was laid anew
    assert metrics["layers"]["1"]["success"] == metrics["layers"]["2"]["success"] == success_rate(2, 2)
    assert metrics["layers"]["1"]["offset_cm"]["median"] == pytest.approx(0.0, abs=0.1)
    assert metrics["layers"]["2"]["offset_cm"]["median"] == pytest.approx(0.4, abs=0.1)


def test_the_judge_goes_by_the_truth_whatever_the_builder_believes(tmp_path: Path) -> None:
    class Misled(Eye):
        """Sees all 3 cm beside where it is."""

        def plan(self, observation, goal=None):
            plan = super().plan(observation, goal)
            action = plan.action
            return replace(plan, action=replace(action, place=action.place @ PlanarPose(0.0, 0.03)))

    def open_misled(_options):
        cell = JudgedTable()
        return Setup(cell, Misled(cell))

    metrics = evaluate_here(options(tmp_path), open_misled)
    (episode,) = read_episodes(tmp_path).values()
    assert metrics["success"]["rate"] == 0.0
    assert metrics["layers"]["1"] == {"success": success_rate(0, 1)}
    assert episode.credit == Credit(0.0, False, False, (False, False), ((None,), (None,)))
    assert len(episode.steps) == 2 * (1 + MOST_ANEW), "each bag is laid, and laid anew as often as may be"


def test_where_the_policy_sees_all_built_or_no_bag_the_episode_ends(tmp_path: Path) -> None:
    class Content(Eye):
        """Sees every bag where it is asked for one."""

        def plan(self, observation, goal=None):
            plan = super().plan(observation, replace(goal, object_at=None))
            there = plan.action.pick if goal.object_at is None else self._place(np.array([goal.object_at]), 0)
            return replace(plan, action=replace(plan.action, pick=there))

    def open_content(_options):
        cell = JudgedTable(landing=[(0.0, 0.04)] * 9)
        return Setup(cell, Content(cell))

    evaluate_here(options(tmp_path / "content"), open_content)
    (episode,) = read_episodes(tmp_path / "content").values()
    assert (episode.failure, len(episode.steps)) == ("unfinished", 2)

    def open_bare(_options):
        cell = JudgedTable(LOOSE[:1])
        return Setup(cell, Eye(cell))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(JudgedTable, "reset", lambda self, seed: None)
        evaluate_here(options(tmp_path / "bare"), open_bare)
    (episode,) = read_episodes(tmp_path / "bare").values()
    assert episode.failure == "no-plan"
    assert "a bag for slot 2 of 2 beside what is built, found none" in episode.message


def test_the_first_picture_shows_the_pattern(tmp_path: Path) -> None:
    evaluate_here(options(tmp_path), opens([]))
    shown = cv2.imread(str(tmp_path / "episodes" / "episode-0000-before.jpg"))
    cell = JudgedTable()
    u, v = cell.outline(SITE).mean(axis=0)
    scale = shown.shape[0] / cell.look().size[1]
    at_site = shown[
        round(v * scale) - 20 : round(v * scale) + 20, round(u * scale) - 20 : round(u * scale) + 20
    ]
    assert np.ptp(at_site) > 100  # a number on a shade, where the table is bare


def test_a_log_of_an_earlier_version_has_no_layers_and_goes_on(tmp_path: Path) -> None:
    evaluate_here(options(tmp_path), opens([]))
    record = json.loads((tmp_path / LOG).read_text())
    for name in ("layers", "offsets_cm"):
        del record["credit"][name]
    (tmp_path / LOG).write_text(json.dumps(record) + "\n")
    (old,) = read_episodes(tmp_path).values()
    assert old.credit == Credit(1.0, True, True)
    metrics = evaluate_here(options(tmp_path, episodes=2), opens([]))
    assert metrics["success"] == success_rate(2, 2)
    assert metrics["layers"]["1"]["success"] == success_rate(1, 1)
    record["credit"]["tilt"] = 1.0
    (tmp_path / LOG).write_text(json.dumps(record) + "\n")
    with pytest.raises(DataError, match="with \\['tilt'\\] besides"):
        read_episodes(tmp_path)


def test_the_page_has_a_row_for_each_layer(tmp_path: Path) -> None:
    evaluate_here(options(tmp_path / "runs/one", episodes=2), opens([(0.0, 0.0), (0.0, 0.007)]))
    page = Page(report(ReportOptions((tmp_path / "runs",), tmp_path / "r.html")).read_text())
    words = " ".join(page.words)
    assert "Layer by layer" in words
    assert "2 of 2, 0.7 cm" in words


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"task": "bag-place", "pattern": "tower:2"},
            "no --pattern with --task bag-place, got tower:2",
        ),
        ({"task": "block-pyramid", "one_color": True}, "no --one-color with --task block-pyramid"),
        (
            {"policy": "color-mask"},
            "--one-color with --task bag-tower and color-mask, which knows one colour",
        ),
        ({"calibration": Path("x")}, "no --calibration with --task bag-tower"),
        ({"pattern": "tower:0"}, "a pattern such as tower:3"),
        ({"pattern": "tower:9"}, "a pattern of 1 to 8 bags"),
        ({"pattern": "nowhere.yaml"}, "a file with a pattern at nowhere.yaml, got none"),
    ],
)
def test_what_cannot_be_stacked_is_refused_before_anything_is_written(
    tmp_path: Path, change, message: str
) -> None:
    with pytest.raises(BaggieError, match=message):
        evaluate(options(tmp_path / "out", **change), opens([]))
    assert not (tmp_path / "out").exists()


def test_an_evaluation_is_of_one_pattern(tmp_path: Path) -> None:
    evaluate_here(options(tmp_path, pattern="tower:2"), opens([]))
    for other in ("tower:3", None):
        with pytest.raises(BaggieError, match="holds an evaluation with pattern tower:2"):
            evaluate_here(options(tmp_path, pattern=other), opens([]))


def test_a_pattern_s_file_counts_by_what_it_says(tmp_path: Path) -> None:
    file, moved = tmp_path / "a.yaml", tmp_path / "b.yaml"
    file.write_text(Pattern.parse("pyramid:2-1").to_yaml())
    moved.write_text(file.read_text())
    of = [Terms.of(options(tmp_path, pattern=str(path)), Nobody()) for path in (file, moved)]
    assert of[0] == of[1]
    moved.write_text("tower:3\n")
    assert Terms.of(options(tmp_path, pattern=str(moved)), Nobody()) != of[0]
    assert task_of(options(tmp_path, pattern=str(file))).pattern == Pattern.parse("pyramid:2-1")


def test_a_task_has_as_many_bags_as_the_pattern_has_slots(tmp_path: Path) -> None:
    task = task_of(options(tmp_path, pattern="tower:5", one_color=True))
    scene = task.draw(np.random.default_rng(0))
    (stacked,) = scene.conditions
    assert isinstance(stacked, Stacked)
    assert len(scene.poses) == len(stacked.pattern.slots) == 5
    assert len({bag.color for bag in scene.things}) == 1
    assert task.max_steps > 5
    assert task_of(options(tmp_path)) is TASKS["bag-tower"]


@pytest.mark.parametrize("policy", ["keypoint", "regression", "transporter"])
def test_what_was_taught_to_stack_is_judged_on_all_stacks_and_what_was_not_on_none(
    tmp_path: Path, monkeypatch, policy: str
) -> None:
    taught = replace(TASKS["bag-place"], name="bag-stack", instruction="stack the bean bags")
    monkeypatch.setitem(TASKS._own, taught.name, "an.other:PACKAGE")
    monkeypatch.setitem(TASKS._found, taught.name, taught)

    def run(instruction: str | None) -> str:
        training = {"training": {"task": instruction}} if instruction else {}
        model = {"model": {"camera": {"matrix": []}}}
        (tmp_path / "config.yaml").write_text(yaml.safe_dump({"policy": policy} | model | training))
        return str(tmp_path)

    for task in STACKS:
        check_taught(run(taught.instruction), task)
        others = ((TASKS["bag-place"].instruction, "was taught bag-place"), (None, "does not say so"))
        for instruction, said in others:
            with pytest.raises(BaggieError, match=rf"was taught bag-stack, got .*, which {said}"):
                check_taught(run(instruction), task)
    check_taught(run(taught.instruction), "bag-stack")
    with pytest.raises(BaggieError, match=r"was taught bag-place, got .* taught bag-stack"):
        check_taught(run(taught.instruction), "bag-place")


class SimulatedEye(Policy):
    """Sees a simulated cell's bags as its state says, and goals by how its own outlines appear."""

    name = "eye"
    wants_goal = True

    def __init__(self, cell: SimulatedWorkcell) -> None:
        self.cell = cell

    def plan(self, observation, goal=None):
        places = list(self.cell.state().places.values())
        pixels = np.array([self.cell.outline(pose, goal.object_layer).mean(axis=0) for pose in places])
        heat = np.zeros((observation.size[1] // 4, observation.size[0] // 4), np.float32)
        for u, v in (pixels / 4).round().astype(int):
            heat[v, u] = 1.0
        near = 0 if goal.object_at is None else int(np.hypot(*(pixels - goal.object_at).T).argmin())
        here = PlanarPose(0.5, 0.0)
        length, width, _ = self.cell.settings.object_size_m
        seen = self.cell.outline(here, goal.layer).astype(np.float32)
        to_robot = cv2.getPerspectiveTransform(seen, here.outline(length, width).astype(np.float32))
        a, b, *_ = corners = apply_homography(to_robot, goal.corners)
        x, y = corners.mean(axis=0)
        place = PlanarPose(float(x), float(y), float(np.arctan2(*(b - a)[::-1])))
        action = PickPlace(places[near], place, goal.object_layer * LAYER_M, goal.layer * LAYER_M)
        return Plan(action, views={"pick": heat})


def open_in_simulator(options: EvaluateOptions) -> Setup:
    cell = SimulatedWorkcell(0, task_of(options), depth=False)
    return Setup(cell, OraclePolicy(cell.demonstrate) if options.seed else SimulatedEye(cell))


@pytest.mark.parametrize("seed", [0, 1], ids=["a policy that wants goals", "the oracle"])
def test_two_bags_are_stacked_in_the_simulator(tmp_path: Path, seed: int) -> None:
    metrics = evaluate_here(options(tmp_path, pattern="tower:2", seed=seed), open_in_simulator)
    assert metrics["success"] == success_rate(1, 1)
    assert metrics["layers"]["2"]["success"] == success_rate(1, 1)
    assert metrics["layers"]["2"]["offset_cm"]["max"] < 2.0
