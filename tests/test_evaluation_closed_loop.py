"""The closed loop in a cell without physics: what is measured is what happened, whatever interrupts it."""

import json
import os
import signal
import subprocess
import sys
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from baggie import seeds
from baggie.calibration.files import CameraIdentity
from baggie.calibration.image_to_robot.map import ImageToRobot
from baggie.data.files import CALIBRATION_FOLDER
from baggie.errors import BaggieError, DataError, ReachError
from baggie.evaluation import closed_loop as module
from baggie.evaluation.closed_loop import EvaluateOptions, evaluate
from baggie.evaluation.log import append_line, read_lines
from baggie.evaluation.setup import Bench
from baggie.geometry import PlanarPose
from baggie.policies import ColorMaskPolicy
from baggie.policies.baselines import OraclePolicy
from baggie.types import Observation, Outcome
from baggie.workcell.workcell import WorkcellSettings
from helpers.streaming import Here
from helpers.synthetic import RED, WORKSPACE, box_corners, to_pixels

SIZE = (320, 180)


class FakeCell:
    """A bag that lands where it is put; the first grasp of every third episode misses."""

    def __init__(self):
        self.settings = WorkcellSettings(workspace=WORKSPACE)

    def reset(self, seed):
        assert seed[0] == seeds.EVALUATION
        self.rng = seeds.generator(*seed)
        x, y = WORKSPACE.sample(self.rng, 0.02)
        self.bag = PlanarPose(float(x), float(y), float(self.rng.uniform(-0.7, 0.7)))
        self.misses = 1 if seed[-1] % 3 == 0 else 0

    def look(self):
        return Observation(np.full((SIZE[1], SIZE[0], 3), 90, np.uint8))

    def truth(self):
        return self.bag

    def goal_corners(self, pose):
        return box_corners(pose, SIZE)

    def second_truth(self):
        return None

    def obstacles(self):
        return []

    def lay_card(self, pose):
        self.card = pose

    def carry_out(self, plan):
        action = plan.action
        if self.misses:
            self.misses -= 1
            return Outcome(action, "missed-grasp")
        if action.place.x > 0.7:
            raise ReachError("too far")
        self.bag = PlanarPose(action.place.x, action.place.y, 0.0)
        return Outcome(action)

    @contextmanager
    def film(self, size=(64, 48), fps=20):
        frames = []
        yield frames
        frames += [np.full((48, 64, 3), shade, np.uint8) for shade in range(0, 200, 20)]

    def close(self):
        pass


class HeatOracle(OraclePolicy):
    """Tells the truth, with a heat map, and kills the evaluation in the middle of a plan if told to."""

    plans = 0
    die_at = None

    def plan(self, observation, goal):
        self.plans += 1
        if self.plans == self.die_at:
            os.kill(os.getpid(), signal.SIGKILL)
        view = np.zeros((9, 16), np.float32)
        view[4, 5] = 1
        return replace(super().plan(observation, goal), views={"pick": view})


class BlindPolicy:
    name = "blind"

    def plan(self, observation, goal):
        raise BaggieError("no bag in sight")


def open_perfect(_options, off_m=0.0):
    cell = FakeCell()
    bench = Bench(cell, HeatOracle(cell.truth, lambda: bench.goal @ PlanarPose(off_m, 0.0)))
    return bench


def open_off_by_25_mm(options):
    return open_perfect(options, 0.025)


def open_far(options):
    return open_perfect(options, 1.0)


def open_blind(_options):
    return Bench(FakeCell(), BlindPolicy())


def open_deadly(options):
    bench = open_perfect(options)
    bench.policy.die_at = 4  # the first episode takes two plans
    return bench


evaluate_here = partial(evaluate, executor=Here())


def options(out, **changes):
    return EvaluateOptions(
        **{"policy": "oracle", "out": out, "episodes": 5, "workers": 1, "film": 1} | changes
    )


def timeless(out):
    lines = [json.loads(line) for line in (out / "episodes.jsonl").read_text().splitlines()]
    for line in lines:
        line.pop("wall_s"), line.pop("decision_ms")
    return sorted(lines, key=lambda line: line["episode"])


def test_oracle_always_succeeds(tmp_path):
    one = evaluate_here(options(tmp_path / "one"), open_perfect)
    assert one["success"]["rate"] == 1.0
    assert one["success"]["n"] == 5
    assert one["distance_cm"]["max"] < 1e-9
    assert one["failures"] == {}
    # It looked again where the gripper had missed: episodes 0 and 3.
    assert [line["looks"] for line in timeless(tmp_path / "one")] == [2, 1, 1, 2, 1]
    for line in timeless(tmp_path / "one"):
        assert np.hypot(*(np.array(line["goal"]) - line["start"])[:2]) >= 0.2
    names = {path.name for path in (tmp_path / "one/episodes").iterdir()}
    kinds = {f"episode-{n:04d}-{kind}.jpg" for n in range(5) for kind in ("before", "after", "heat")}
    assert names == kinds | {"episode-0000.mp4"}
    assert json.loads((tmp_path / "one/metrics.json").read_text()) == one


def test_a_known_error_is_what_is_measured(tmp_path):
    metrics = evaluate_here(options(tmp_path), open_off_by_25_mm)
    assert metrics["distance_cm"]["median"] == pytest.approx(2.5)
    assert metrics["success"]["rate"] == metrics["success_within"]["1_cm"]["rate"] == 0.0
    assert metrics["success_within"]["3_cm"]["rate"] == 1.0
    assert metrics["failures"] == {"off-goal": 5}


@pytest.mark.parametrize(("bench", "cause"), [(open_blind, "no-plan"), (open_far, "out-of-reach")])
def test_what_a_policy_cannot_do_is_a_failure_with_its_cause(tmp_path, bench, cause):
    metrics = evaluate_here(options(tmp_path, episodes=2, retries=0), bench)
    assert metrics["success"]["rate"] == 0.0
    assert set(metrics["failures"]) <= {cause, "missed-grasp"}
    assert metrics["failures"][cause] >= 1


def test_killed_and_run_again_by_two_workers_gives_what_one_gives_undisturbed(tmp_path):
    program = (
        "import sys; from pathlib import Path; import test_evaluation_closed_loop as t; "
        "t.evaluate_here(t.options(Path(sys.argv[1]), episodes=3), t.open_deadly)"
    )
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(Path(__file__).parent), *sys.path])}
    command = [sys.executable, "-c", program, str(tmp_path / "killed")]
    killed = subprocess.run(command, env=environment, capture_output=True, check=False)
    assert killed.returncode == -signal.SIGKILL
    done = timeless(tmp_path / "killed")
    assert [line["episode"] for line in done] == [0, 1]
    with (tmp_path / "killed/episodes.jsonl").open("a") as log:
        log.write('{"episode": 2, "sta')  # it might have died while writing, too
    evaluate(options(tmp_path / "killed", episodes=3, workers=2), open_perfect)
    evaluate_here(options(tmp_path / "whole", episodes=3), open_perfect)
    assert timeless(tmp_path / "killed") == timeless(tmp_path / "whole")


def test_more_episodes_add_to_those_there_are(tmp_path):
    evaluate_here(options(tmp_path, episodes=2), open_perfect)
    first = (tmp_path / "episodes.jsonl").read_text()
    assert evaluate_here(options(tmp_path, episodes=3), open_perfect)["success"]["n"] == 3
    assert (tmp_path / "episodes.jsonl").read_text().startswith(first)
    assert evaluate_here(options(tmp_path, episodes=2), open_perfect)["success"]["n"] == 2


def test_another_evaluation_in_the_same_folder_is_refused(tmp_path):
    evaluate_here(options(tmp_path, episodes=1), open_perfect)
    with pytest.raises(BaggieError, match="holds an evaluation with seed 0, not 1"):
        evaluate_here(options(tmp_path, episodes=1, seed=1), open_perfect)


def a_calibration(folder, off_px=0.0):
    """Of the drawn camera, as a recording keeps it."""
    points = np.array([[x, y, 0.015] for x in (0.4, 0.5, 0.6) for y in (-0.2, 0.0, 0.2)])
    camera = CameraIdentity("drawn", *SIZE)
    fitted = ImageToRobot.fit(to_pixels(points, SIZE) + off_px, points, camera)
    ColorMaskPolicy(fitted, RED).save(folder / CALIBRATION_FOLDER)
    return folder


def test_another_calibration_is_another_evaluation(tmp_path):
    one, other = a_calibration(tmp_path / "one"), a_calibration(tmp_path / "other", off_px=5.0)

    def asked(calibration, **changes):
        given = {"policy": "color-mask", "calibration": calibration, "episodes": 1, "goal": "turned"}
        return options(tmp_path / "out", **given | changes)

    with pytest.raises(DataError, match="color-mask policy"):  # before anything is written
        evaluate_here(asked(tmp_path / "nowhere"), open_perfect)
    evaluate_here(asked(one), open_perfect)
    for given in (other, None):
        with pytest.raises(BaggieError, match="holds an evaluation with calibration"):
            evaluate_here(asked(given), open_perfect)
    moved = a_calibration(tmp_path / "moved")
    assert (
        evaluate_here(asked(moved, episodes=2), open_perfect)["success"]["n"] == 2
    )  # the same one, elsewhere


def test_another_device_is_another_evaluation(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "check_device", lambda _device: None)
    evaluate_here(options(tmp_path, episodes=1), open_perfect)
    with pytest.raises(BaggieError, match="holds an evaluation with device cpu, not cuda"):
        evaluate_here(options(tmp_path, episodes=1, device="cuda"), open_perfect)


def test_a_real_workcell_is_another_evaluation_than_a_simulated_one(tmp_path):
    evaluate_here(options(tmp_path, policy="color-mask", episodes=1), open_perfect)
    with pytest.raises(BaggieError, match=r"holds an evaluation with workcell None, not cell\.yaml"):
        evaluate_here(
            options(tmp_path, policy="color-mask", episodes=1, workcell=Path("cell.yaml")), open_perfect
        )


def test_an_evaluation_of_an_older_version_goes_on_and_is_told_apart_from_then_on(tmp_path):
    evaluate_here(options(tmp_path, episodes=1), open_perfect)
    path = tmp_path / "evaluation.json"
    written = json.loads(path.read_text())
    path.write_text(json.dumps({key: value for key, value in written.items() if key != "device"}))
    assert evaluate_here(options(tmp_path, episodes=2), open_perfect)["success"]["n"] == 2
    assert json.loads(path.read_text()) == written


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"task": "juggle"}, "task among bag-place"),
        ({"episodes": 0}, "--episodes"),
        ({"workers": 0}, "--workers"),
    ],
)
def test_impossible_wishes_are_refused(tmp_path, change, message):
    with pytest.raises(BaggieError, match=message):
        evaluate(options(tmp_path, **change), open_perfect)


def test_log_gives_back_what_was_written_and_names_a_broken_line(tmp_path):
    log = tmp_path / "log.jsonl"
    assert read_lines(log) == []
    records = [{"a": 1, "b": [1.5, "x"]}, {"a": 2}]
    for record in records:
        append_line(log, record)
    assert read_lines(log) == records
    with log.open("a") as file:
        file.write('{"a": 3, "b')  # somebody is writing it
    unfinished = log.read_bytes()
    assert read_lines(log) == records
    assert log.read_bytes() == unfinished  # and goes on to do so
    append_line(log, {"a": 4})  # whoever writes knows that nobody else does
    assert read_lines(log) == [*records, {"a": 4}]
    log.write_text('{"a": 1}\nnonsense\n{"a": 2}\n')
    with pytest.raises(DataError, match="line 2"):
        read_lines(log)
