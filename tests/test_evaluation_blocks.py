"""The closed loop with blocks: what is measured is what happened, step by step, whatever interrupts it."""

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
from baggie.evaluation.block_episode import BlockBench, BlockEpisode
from baggie.evaluation.closed_loop import EvaluateOptions, evaluate
from baggie.evaluation.log import read_log
from baggie.evaluation.subjects import check_taught
from baggie.geometry import Grid, PlanarPose
from baggie.metrics import success_rate
from baggie.options.evaluating import ReportOptions
from baggie.policies import DemonstratorPolicy
from baggie.registry import TASKS
from baggie.report.report import report
from baggie.types import Observation, Outcome, PickPlace, Plan
from helpers.reports import Page
from helpers.streaming import Here

TASK = TASKS["block-pyramid"]
GRID = Grid(x=(0.3, 0.4), y=(-0.1, 0.1), pixel_m=0.005)
SLOT = PlanarPose(0.35, 0.05)


@dataclass
class FakeScore:
    total: float = 0.0

    @property
    def done(self):
        return self.total > 1 - 1e-9


class FakeBlockCell:
    """Four blocks, a quarter of the task each when it comes to lie on `SLOT`; what lies there stays, or falls over."""

    task = TASK
    topples = False

    def reset(self, seed):
        assert seed[0] == seeds.EVALUATION
        self.rng = seeds.generator(*seed)
        self.blocks = [PlanarPose(0.32, float(y)) for y in self.rng.uniform(-0.08, 0.0, 4)]
        self.score, self.counted = FakeScore(), 0
        self.grasps_to_miss = int(seed[-1] % 2)

    def look(self):
        noise = self.rng.integers(0, 255, (*GRID.shape, 3))
        return Observation(noise.astype(np.uint8), grid=GRID, height=np.zeros(GRID.shape, np.float32))

    def demonstrate(self):
        return PickPlace(self.blocks[0], SLOT) if self.blocks else None

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

    def count(self):
        before, self.score.total = self.score.total, self.counted / 4
        return self.score.total - before

    def strict_success(self):
        return self.score.done and not self.topples

    @contextmanager
    def film(self, size=(64, 48), fps=20):
        frames = []
        yield frames
        frames += [np.full((48, 64, 3), shade, np.uint8) for shade in range(0, 200, 20)]


class HeatDemonstrator(DemonstratorPolicy):
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
    return BlockBench(cell, HeatDemonstrator(cell.demonstrate))


def open_beside(options):
    bench = open_right(options)
    bench.policy.off_m = 0.03
    return bench


def open_too_far(options):
    bench = open_right(options)
    bench.policy.off_m = 0.1
    return bench


def open_toppling(options):
    bench = open_right(options)
    bench.cell.topples = True
    return bench


def open_undecided(_options):
    return BlockBench(FakeBlockCell(), Undecided())


def open_deadly(options):
    bench = open_right(options)
    bench.policy.die_at = 7  # episode 0 takes 4 plans, episode 1 takes 5
    return bench


evaluate_here = partial(evaluate, executor=Here())


def options(out, **changes):
    given = {"policy": "oracle", "out": out, "task": TASK.name, "episodes": 4, "workers": 1, "film": 0}
    return EvaluateOptions(**given | changes)


def timeless(out):
    records = [json.loads(line) for line in (out / "block-episodes.jsonl").read_text().splitlines()]
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
    ("bench", "expected"),
    [
        (open_undecided, ("no-plan", 1, 0.0)),
        (open_beside, ("unfinished", TASK.max_steps, 0.0)),
        (open_too_far, ("out-of-reach", TASK.max_steps, 0.0)),
        (open_toppling, ("ravens-only", 4, 1.0)),
    ],
)
def test_every_episode_that_fails_has_a_cause(tmp_path, bench, expected):
    cause, steps, done = expected
    metrics = evaluate_here(options(tmp_path, episodes=1), bench)
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
    assert sum(step["reward"] for step in record["steps"]) == pytest.approx(record["partial_credit"])
    assert record["partial_credit"] == 1.0


def test_records_come_back_as_they_were_logged_and_another_version_is_refused(tmp_path):
    evaluate_here(options(tmp_path, episodes=1), open_right)
    log = tmp_path / "block-episodes.jsonl"
    (episode,) = read_log(log, BlockEpisode)
    assert BlockEpisode.from_json(json.loads(json.dumps(episode.to_json()))) == episode
    record = json.loads(log.read_text())
    del record["steps"][0]["reward"]
    log.write_text(json.dumps(record) + "\n")
    with pytest.raises(DataError, match=r"without \['reward'\].*evaluate again"):
        read_log(log, BlockEpisode)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"scenery": "light"}, "no --scenery with --task block-pyramid"),
        ({"goal": "card"}, "no --goal"),
        ({"radius_cm": 1.0}, "no --radius-cm"),
        ({"calibration": Path("x")}, "no --calibration"),
        ({"policy": "color-mask"}, "a policy that looks at height maps"),
        ({"task": "juggle"}, "a task among bag-place, block-pyramid"),
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
    evaluate_here(options(tmp_path / "runs/bad", episodes=2, seed=1, task="align-box-corner"), open_toppling)
    text = report(ReportOptions((tmp_path / "runs",), tmp_path / "r.html")).read_text()
    assert "http" not in text
    page = Page(text)
    assert {"video", "numbers", "blocks", "origin"} <= set(page.ids)
    assert not {"closed-loop", "validation", "heat"} & set(page.ids)
    words = " ".join(page.words)
    assert "Blocks into place" in words
    assert "4 of 4 (51 to 100%)" in words
    assert "0 of 2" in words
    assert "ravens-only" in words
    assert {"oracle, block-pyramid", "oracle, align-box-corner"} <= set(page.words)
    # Of the first policy: the start, the end and each step of three episodes.
    shown = [word for word in page.words if word in ("start", "end") or word.startswith("step ")]
    pictures = [source for source in page.sources if source.startswith("data:image")]
    assert len(shown) == len(pictures) > 3 * 2 + 2 * 2
    assert sum(source.startswith("data:video") for source in page.sources) == 1


@settings(max_examples=50)
@given(st.lists(st.floats(-0.5, 0.5), min_size=1, max_size=12))
def test_a_step_says_what_it_has_done(rewards):
    record = {"planned": None, "executed": None, "confidence": 0.0, "failure": "", "message": ""}
    steps = [{**record, "reward": reward, "decision_ms": 1.0} for reward in rewards]
    ending = {"partial_credit": sum(rewards), "ravens_success": False, "success": False}
    line = {"episode": 3, "steps": steps, **ending, "failure": "unfinished", "message": "", "wall_s": 1.0}
    assert json.loads(json.dumps(BlockEpisode.from_json(line).to_json())) == line


FROM_ABOVE_TASKS = {name for name, task in TASKS.all().items() if task.view == "height-map"}
PYRAMID, BAG = TASK.instruction, TASKS["bag-place"].instruction
FROM_ABOVE = {"policy": "transporter", "model": {"camera": None}}
BY_CAMERA = {"policy": "transporter", "model": {"camera": {"matrix": []}}}


@pytest.mark.parametrize(
    ("config", "instruction", "tasks"),
    [
        ({"policy": "keypoint"}, BAG, {"bag-place"}),
        (BY_CAMERA, BAG, {"bag-place"}),
        (FROM_ABOVE, PYRAMID, {"block-pyramid"}),
        ({"policy": "regression"}, None, {"bag-place"}),  # a run begun before runs said what they were taught
        (FROM_ABOVE, None, FROM_ABOVE_TASKS),
        (FROM_ABOVE, "stack block pyramid", FROM_ABOVE_TASKS),  # in somebody else's words
        ({"policy": "color-mask"}, None, {"bag-place"}),
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
