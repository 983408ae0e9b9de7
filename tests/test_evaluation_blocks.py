"""The closed loop with blocks: what is measured is what happened, step by step, whatever interrupts it."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from baggie import seeds
from baggie.cli.main import main
from baggie.errors import BaggieError, DataError, ReachError
from baggie.evaluation.closed_loop import EvaluateOptions, evaluate
from baggie.evaluation.log import LOG, Credit, Episode, read_episodes
from baggie.evaluation.setup import Setup, check_taught
from baggie.geometry import Grid, PlanarPose
from baggie.metrics import success_rate
from baggie.options.evaluating import ReportOptions
from baggie.policies import OraclePolicy
from baggie.registry import TASKS
from baggie.report.report import report
from baggie.tasks.conditions import State
from baggie.tasks.demonstrator import next_action
from baggie.tasks.task import Scene
from baggie.types import Observation, Outcome, PickPlace, Plan
from baggie.workcell.workcell import Workcell
from helpers.reports import Page
from helpers.streaming import Here

TASK = TASKS["block-pyramid"]
GRID = Grid(x=(0.3, 0.4), y=(-0.1, 0.1), pixel_m=0.005)
SLOT = PlanarPose(0.35, 0.05)


@dataclass
class OnSlot:
    """A condition of one's own: a quarter for each block that was put on `SLOT`."""

    cell: FakeBlockCell
    weight: float = 1.0

    def share(self, _state):
        return self.cell.counted / 4

    def holds(self, _state):
        return self.cell.counted == 4 and not self.cell.topples

    def next_action(self, _state, _tool):
        return PickPlace(self.cell.blocks[0], SLOT) if self.cell.blocks else None


class FakeBlockCell(Workcell):
    """Four blocks, a quarter of the task each when it comes to lie on `SLOT`; what lies there stays, or falls over."""

    topples = False

    def __init__(self):
        self.scene = Scene((), {}, (OnSlot(self),))

    def reset(self, seed):
        assert seed[0] == seeds.EVALUATION
        self.rng = seeds.generator(*seed)
        self.blocks = [PlanarPose(0.32, float(y)) for y in self.rng.uniform(-0.08, 0.0, 4)]
        self.counted = 0
        self.grasps_to_miss = int(seed[-1] % 2)

    def look(self):
        noise = self.rng.integers(0, 255, (*GRID.shape, 3))
        return Observation(noise.astype(np.uint8), grid=GRID, height=np.zeros(GRID.shape, np.float32))

    def state(self):
        return State({}, {})

    def wait(self, seconds):
        pass

    def demonstrate(self, rng=None):
        return next_action(self.scene.conditions, self.state())

    def carry_out(self, plan):
        if plan.action.place.x > 0.4:
            raise ReachError("too far")
        if self.grasps_to_miss:
            self.grasps_to_miss -= 1
            return Outcome(plan.action, "missed-grasp")
        near = [b for b in self.blocks if b.distance(plan.action.pick) < 0.01]
        if near and plan.action.place.distance(SLOT) < 0.01:
            self.blocks.remove(near[0])
            self.counted += 1
        return Outcome(plan.action)

    @contextmanager
    def film(self, size=(64, 48), fps=20):
        frames = []
        yield frames
        frames += [np.full((48, 64, 3), shade, np.uint8) for shade in range(0, 200, 20)]


class HeatDemonstrator(OraclePolicy):
    """Does what is right, moved by `off_m`, with heat maps; kills the evaluation in the middle if told to."""

    plans, die_at, off_m = 0, None, 0.0

    def plan(self, observation, goal=None):
        self.plans += 1
        if self.plans == self.die_at:
            os.kill(os.getpid(), signal.SIGKILL)
        plan = super().plan(observation, goal)
        place = plan.action.place
        heat = np.zeros(GRID.shape, np.float32)
        heat[20, 10] = 1
        action = replace(plan.action, place=replace(place, x=place.x + self.off_m))
        return Plan(action, views={"pick": heat, "place": heat[::-1].copy()})


class Undecided:
    name = "undecided"

    def plan(self, observation, goal=None):
        raise BaggieError("nothing in sight")


def open_right(_options):
    cell = FakeBlockCell()
    return Setup(cell, HeatDemonstrator(cell.demonstrate))


def open_beside(options):
    setup = open_right(options)
    setup.policy.off_m = 0.03
    return setup


def open_too_far(options):
    setup = open_right(options)
    setup.policy.off_m = 0.1
    return setup


def open_toppling(options):
    setup = open_right(options)
    setup.cell.topples = True
    return setup


def open_undecided(_options):
    return Setup(FakeBlockCell(), Undecided())


def open_deadly(options):
    setup = open_right(options)
    setup.policy.die_at = 7  # episode 0 takes 4 plans, episode 1 takes 5
    return setup


evaluate_here = partial(evaluate, executor=Here())


def options(out, **changes):
    given = {"policy": "oracle", "out": out, "task": TASK.name, "episodes": 4, "workers": 1, "film": 0}
    return EvaluateOptions(**given | changes)


def timeless(out):
    records = [json.loads(line) for line in (out / "episodes.jsonl").read_text().splitlines()]
    for record in records:
        record.pop("wall_s")
        for step in record["steps"]:
            step.pop("decision_ms")
    return sorted(records, key=lambda record: record["episode"])


def test_what_the_demonstrator_does_is_a_success_and_leaves_pictures_of_every_step(tmp_path):
    metrics = evaluate_here(options(tmp_path, film=1), open_right)
    assert metrics["success"] == metrics["ravens_success"] == success_rate(4, 4)
    assert metrics["partial_credit"]["mean"] == 1.0
    assert metrics["failures"] == {}
    assert metrics["failed_steps"] == {"missed-grasp": 2}  # in episodes 1 and 3, and made good
    steps = [4, 5, 4, 5]
    assert [len(record["steps"]) for record in timeless(tmp_path)] == steps
    assert metrics["steps"]["mean"] == 4.5
    assert metrics["decision_ms"]["n"] == sum(steps)
    kinds = [["before", "after", *(f"step-{k:02d}" for k in range(count))] for count in steps]
    pictures = {f"episode-{n:04d}-{kind}.jpg" for n, of_one in enumerate(kinds) for kind in of_one}
    assert {path.name for path in (tmp_path / "episodes").iterdir()} == pictures | {"episode-0000.mp4"}
    assert json.loads((tmp_path / "metrics.json").read_text()) == metrics


@pytest.mark.parametrize(
    ("opened", "expected"),
    [
        (open_undecided, ("no-plan", 1, 0.0)),
        (open_beside, ("unfinished", TASK.max_steps, 0.0)),
        (open_too_far, ("out-of-reach", TASK.max_steps, 0.0)),
        (open_toppling, ("ravens-only", 4, 1.0)),
    ],
)
def test_every_episode_that_fails_has_a_cause(tmp_path, opened, expected):
    cause, steps, done = expected
    metrics = evaluate_here(options(tmp_path, episodes=1), opened)
    assert metrics["success"]["rate"] == 0.0
    assert metrics["failures"] == {cause: 1}
    assert metrics["steps"]["max"] == steps
    assert metrics["partial_credit"]["mean"] == metrics["ravens_success"]["rate"] == done


@pytest.mark.slow
def test_killed_and_run_again_by_two_workers_gives_what_one_gives_undisturbed(tmp_path):
    program = (
        "import sys; from pathlib import Path; import test_evaluation_blocks as t; "
        "t.evaluate_here(t.options(Path(sys.argv[1])), t.open_deadly)"
    )
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])}
    command = [sys.executable, "-c", program, str(tmp_path / "killed")]
    killed = subprocess.run(command, env=environment, capture_output=True, check=False)
    assert killed.returncode == -signal.SIGKILL
    assert [record["episode"] for record in timeless(tmp_path / "killed")] == [0]
    evaluate(options(tmp_path / "killed", workers=2), open_right)
    evaluate_here(options(tmp_path / "whole"), open_right)
    assert timeless(tmp_path / "killed") == timeless(tmp_path / "whole")


def test_the_simulated_oracle_does_a_task(tmp_path):
    metrics = evaluate_here(options(tmp_path, task="place-red-in-green", episodes=1))
    assert metrics["success"]["rate"] == metrics["ravens_success"]["rate"] == 1.0
    (record,) = timeless(tmp_path)
    assert sum(step["reward"] for step in record["steps"]) == pytest.approx(
        record["credit"]["partial_credit"]
    )
    assert record["credit"]["partial_credit"] == 1.0


def test_records_come_back_as_they_were_logged_and_another_version_is_refused(tmp_path):
    evaluate_here(options(tmp_path, episodes=1), open_right)
    log = tmp_path / LOG
    (episode,) = read_episodes(tmp_path).values()
    assert Episode.from_json(json.loads(json.dumps(episode.to_json()))) == episode
    record = json.loads(log.read_text())
    del record["steps"][0]["reward"]
    log.write_text(json.dumps(record) + "\n")
    with pytest.raises(DataError, match=r"without \['reward'\].*evaluate again"):
        read_episodes(tmp_path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"scenery": "light"}, "no --scenery with --task block-pyramid"),
        ({"goal": "card"}, "no --goal"),
        ({"radius_cm": 1.0}, "no --radius-cm"),
        ({"calibration": Path("x")}, "no --calibration"),
        ({"policy": "color-mask"}, "a policy that knows the task"),
        ({"task": "juggle"}, "a task among bag-place, .*block-pyramid"),
    ],
)
def test_what_means_nothing_with_blocks_is_refused(tmp_path, change, message):
    with pytest.raises(BaggieError, match=message):
        evaluate(options(tmp_path / "out", **change), open_right)
    assert not (tmp_path / "out").exists()


def test_another_task_in_the_same_folder_is_refused(tmp_path):
    evaluate_here(options(tmp_path, episodes=1), open_right)
    with pytest.raises(BaggieError, match="holds an evaluation with task block-pyramid"):
        evaluate_here(options(tmp_path, episodes=1, task="align-box-corner"), open_right)


def test_the_page_shows_success_failures_and_every_step(tmp_path):
    evaluate_here(options(tmp_path / "runs/good", film=1), open_right)
    evaluate_here(
        options(tmp_path / "runs/bad", episodes=2, seed=1, task="place-red-in-green"), open_toppling
    )
    text = report(ReportOptions((tmp_path / "runs",), tmp_path / "r.html")).read_text()
    assert "http" not in text
    page = Page(text)
    assert {"video", "numbers", "tasks", "origin"} <= set(page.ids)
    assert not {"closed-loop", "validation", "heat"} & set(page.ids)
    words = " ".join(page.words)
    assert "Things into place" in words
    assert "4 of 4 (51 to 100%)" in words
    assert "0 of 2" in words
    assert "ravens-only" in words
    assert {"oracle, block-pyramid", "oracle, place-red-in-green"} <= set(page.words)
    # Of the first policy: the start, the end and each step of three episodes.
    shown = [word for word in page.words if word in ("start", "end") or word.startswith("step ")]
    pictures = [source for source in page.sources if source.startswith("data:image")]
    assert len(shown) == len(pictures) > 3 * 2 + 2 * 2
    assert sum(source.startswith("data:video") for source in page.sources) == 1


@settings(max_examples=50)
@given(st.lists(st.floats(-0.5, 0.5), max_size=12))
def test_what_earlier_versions_logged_of_tasks_of_several_steps_is_read(rewards):
    record = {"planned": None, "executed": None, "confidence": 0.0, "failure": "", "message": ""}
    steps = [{**record, "reward": reward, "decision_ms": 1.0} for reward in rewards]
    ending = {"partial_credit": sum(rewards), "ravens_success": False, "success": False}
    line = {"episode": 3, "steps": steps, **ending, "failure": "unfinished", "message": "", "wall_s": 1.0}
    episode = Episode.from_json(line)
    assert episode.credit == Credit(**ending)
    assert [step.reward for step in episode.steps] == rewards
    assert episode.landing is None
    assert Episode.from_json(json.loads(json.dumps(episode.to_json()))) == episode


OLD_BAG = {
    "episode": 2,
    "start": [0.4, 0.1, 0.5],
    "goal": [0.6, -0.1, 0.0],
    "final": [0.61, -0.1, 0.1],
    "distance_cm": 1.0,
    "yaw_error_deg": 5.7,
    "planned": [0.4, 0.1, 0.5, 0.6, -0.1, 0.0],
    "executed": None,
    "pick_error_cm": 0.1,
    "place_error_cm": 0.2,
    "pick_yaw_error_deg": 0.3,
    "pick_within_m": 0.01,
    "place_within_m": None,
    "confidence": 0.7,
    "looks": 2,
    "failure": "out-of-reach",
    "message": "too far",
    "decision_ms": [3.0, 4.0],
    "wall_s": 9.0,
}


def test_what_earlier_versions_logged_of_bags_is_read():
    episode = Episode.from_json(OLD_BAG)
    missed, last = episode.steps
    assert (missed.failure, missed.planned, missed.decision_ms) == ("missed-grasp", None, 3.0)
    assert (last.failure, last.message, last.decision_ms) == ("out-of-reach", "too far", 4.0)
    assert (last.pick_error_cm, last.pick_within_m, last.confidence) == (0.1, 0.01, 0.7)
    assert episode.landing is not None
    assert episode.landing.final == (0.61, -0.1, 0.1)
    assert episode.succeeded(1.0)
    assert not episode.succeeded(0.9)
    assert Episode.from_json(json.loads(json.dumps(episode.to_json()))) == episode
    assert (
        Episode.from_json(OLD_BAG | {"decision_ms": [], "looks": 0}).steps == ()
    )  # there was no card to be seen


def test_an_evaluation_begun_by_an_earlier_version_goes_on(tmp_path):
    evaluate_here(options(tmp_path, episodes=2), open_right)
    new = timeless(tmp_path)
    kept = {"planned", "executed", "reward", "confidence", "failure", "message", "decision_ms"}
    with (tmp_path / LOG).open() as log, (tmp_path / "block-episodes.jsonl").open("w") as old:
        record = json.loads(log.readline())
        steps = [{name: step[name] for name in kept} for step in record["steps"]]
        flat = {name: record[name] for name in ("episode", "failure", "message", "wall_s")}
        credit = {name: record["credit"][name] for name in ("partial_credit", "ravens_success", "success")}
        old.write(json.dumps({**flat, **credit, "steps": steps}) + "\n")
    (tmp_path / LOG).unlink()
    assert evaluate_here(options(tmp_path, episodes=2), open_right)["success"] == success_rate(2, 2)
    assert timeless(tmp_path) == new[1:]


FROM_ABOVE_TASKS = {name for name, task in TASKS.all().items() if task.view == "height-map"}
WITH_GOAL = {name for name, task in TASKS.all().items() if task.has_goal}
PYRAMID, BAG = TASK.instruction, TASKS["bag-place"].instruction
FROM_ABOVE = {"policy": "transporter", "model": {"camera": None}}
BY_CAMERA = {"policy": "transporter", "model": {"camera": {"matrix": []}}}


@pytest.mark.parametrize(
    ("config", "instruction", "tasks"),
    [
        ({"policy": "keypoint"}, BAG, {"bag-place"}),
        (BY_CAMERA, BAG, {"bag-place"}),
        (FROM_ABOVE, PYRAMID, {"block-pyramid"}),
        ({"policy": "regression"}, None, WITH_GOAL),  # a run begun before runs said what they were taught
        (FROM_ABOVE, None, FROM_ABOVE_TASKS),
        (FROM_ABOVE, "stack block pyramid", FROM_ABOVE_TASKS),  # in somebody else's words
        ({"policy": "color-mask"}, None, WITH_GOAL),
    ],
)
def test_a_policy_is_judged_on_what_it_was_taught(tmp_path, capsys, config, instruction, tasks):
    run, out = tmp_path / "run", tmp_path / "out"
    run.mkdir()
    training = {"training": {"task": instruction}} if instruction else {}
    (run / "config.yaml").write_text(yaml.safe_dump(config | training))
    for task in TASKS.names():
        if task in tasks:
            check_taught(str(run), task)
            continue
        assert main(["evaluate", "--policy", str(run), "--task", task, "--out", str(out)]) == 1
        (line,) = capsys.readouterr().err.splitlines()
        assert line.startswith("error: expected a policy that ")
        assert (f"which was taught {min(tasks)}" in line) == (instruction in {BAG, PYRAMID})
    assert not out.exists()
    for named in ("oracle", "color-mask"):
        check_taught(named, "bag-place")
