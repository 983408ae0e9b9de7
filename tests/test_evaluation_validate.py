"""Validation finds exactly the errors a policy makes, on exactly the attempts it has not learned from."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
import yaml

from baggie.data import DatasetWriter, open_dataset
from baggie.errors import BaggieError, DataError
from baggie.evaluation import validate as module
from baggie.evaluation.closed_loop import EvaluateOptions, evaluate
from baggie.evaluation.validate import demonstrations, held_out, validate
from baggie.learning import KeypointTraining, train
from baggie.metrics import success_rate
from baggie.options.evaluating import ValidateOptions
from helpers.recorded_bags import FAILED, SIZE, FakePolicy, record
from helpers.synthetic import TASK, make_attempt


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    return record(tmp_path_factory.mktemp("recording") / "bags")


def run_of(tmp_path, recording, train=(0, 1, 2), val=(4, 5, 6)):
    folder = tmp_path / "run"
    folder.mkdir()
    split = {"train": list(train), "val": list(val)}
    config = {"policy": "keypoint", "training": {"data": str(recording), "split": split}}
    (folder / "config.yaml").write_text(yaml.safe_dump(config))
    return folder


def test_known_errors_are_recovered_and_the_worst_are_shown(tmp_path, recording, monkeypatch):
    monkeypatch.setattr(module, "open_policy", lambda *_: FakePolicy(recording))
    run = run_of(tmp_path, recording, val=(4, 5, 6, 8, 9, 10, 11, 12, 13, 3))
    out = tmp_path / "out"
    metrics = validate(ValidateOptions(str(run), recording, out))
    kept = [4, 5, 6, 8, 9, 10, 11, 12, 13]  # attempt 3 failed
    truth = metrics["truth"]
    assert truth["pick_error_cm"]["mean"] == truth["pick_error_cm"]["max"] == pytest.approx(0.5)
    assert truth["place_error_cm"]["mean"] == pytest.approx(0.1 * np.mean(kept) + 0.2)
    assert truth["place_error_cm"]["max"] == pytest.approx(1.5)
    assert truth["pick_yaw_error_deg"]["median"] == pytest.approx(np.degrees(0.1))
    assert truth["place_yaw_error_deg"]["max"] == pytest.approx(0, abs=1e-6)
    # The labels are 2 mm off the truth, so errors against them are near, and not the same.
    assert metrics["labels"]["pick_error_cm"]["mean"] == pytest.approx(0.5, abs=0.2)
    assert metrics["labels"]["pick_error_cm"]["mean"] != pytest.approx(0.5, abs=1e-4)
    assert metrics["decision_ms"]["n"] == metrics["held_out"]["attempts"] == len(kept)
    assert json.loads((out / "metrics.json").read_text()) == metrics

    written = json.loads((out / "predictions.json").read_text())
    assert [prediction["attempt_id"] for prediction in written["predictions"]] == kept
    assert [case["attempt_id"] for case in written["worst"]] == kept[::-1]
    assert all(
        (out / case[kind]).stat().st_size > 1000 for case in written["worst"] for kind in ("picture", "heat")
    )


def test_a_quarter_turn_is_wrong_on_a_long_bag_and_right_on_a_square_or_a_round_one(tmp_path, monkeypatch):
    """The fake policy's picks are a quarter turn and 0.1 rad off."""
    said = [4, 2, 0, None]
    rng = np.random.default_rng(0)
    with DatasetWriter(tmp_path / "bags", task=TASK, robot_type="drawn", picture_size=SIZE) as writer:
        for i, symmetry in enumerate(said):
            writer.append(replace(make_attempt(i, rng, SIZE, depth=False), object_symmetry=symmetry))
    assert [attempt.object_symmetry for attempt in open_dataset(tmp_path / "bags")] == said
    monkeypatch.setattr(module, "open_policy", lambda *_: FakePolicy(tmp_path / "bags"))
    metrics = validate(ValidateOptions("color-mask", tmp_path / "bags", tmp_path / "out"))
    assert metrics["symmetry"] == [0, 2, 4]
    predictions = json.loads((tmp_path / "out/predictions.json").read_text())["predictions"]
    assert [prediction["symmetry"] for prediction in predictions] == [4, 2, 0, 4]
    off = [prediction["errors"]["truth"]["pick_yaw_error_deg"] for prediction in predictions]
    tenth = np.degrees(0.1)
    assert off == pytest.approx([tenth, 90 - tenth, 0, tenth])


def test_results_of_one_kind_are_not_written_over_those_of_another(tmp_path, recording):
    run = run_of(tmp_path, recording)
    asked = {
        "validation": lambda: validate(ValidateOptions(str(run), recording, run)),
        "evaluation": lambda: evaluate(EvaluateOptions("oracle", run, episodes=1)),
    }
    for ask in asked.values():
        with pytest.raises(BaggieError, match="run holds a training"):
            ask()
    assert [path.name for path in run.iterdir()] == ["config.yaml"]
    (tmp_path / "out").mkdir()
    (tmp_path / "out/evaluation.json").write_text("{}")
    with pytest.raises(BaggieError, match="out holds an evaluation"):
        train(KeypointTraining(recording, tmp_path / "out"))


def test_attempts_without_a_plan_are_counted_and_come_first(tmp_path, recording, monkeypatch):
    monkeypatch.setattr(module, "open_policy", lambda *_: FakePolicy(recording, blind=(12,)))
    metrics = validate(ValidateOptions("color-mask", recording, tmp_path, last=4))
    assert metrics["without_plan"] == 1
    assert metrics["truth"]["pick_error_cm"]["n"] == 3
    assert json.loads((tmp_path / "predictions.json").read_text())["worst"][0]["attempt_id"] == 12
    monkeypatch.setattr(module, "open_policy", lambda *_: FakePolicy(recording, blind=range(20)))
    with pytest.raises(BaggieError, match="none of 4 held-out attempts: no bag in sight"):
        validate(ValidateOptions("color-mask", recording, tmp_path / "blind", last=4))


def test_confidence_is_the_share_inside_the_stated_radii(tmp_path, recording, monkeypatch):
    monkeypatch.setattr(module, "open_policy", lambda *_: FakePolicy(recording))
    metrics = validate(ValidateOptions("color-mask", recording, tmp_path / "stated", last=9))
    truth, labels = metrics["confidence"]["truth"], metrics["confidence"]["labels"]
    # Picks are off by 5 mm of 6; the place of attempt k by k + 2 mm of 10.5: 4, 5, 6 and 8 are inside.
    assert truth["pick_within"] == success_rate(9, 9)
    assert labels["place_within"] == success_rate(4, 9)
    assert "place_within" not in truth  # the truth is where the bag was put, and not where it was let go
    assert truth["pick_radius_cm"]["mean"] == labels["pick_radius_cm"]["mean"] == pytest.approx(0.6)
    assert labels["place_radius_cm"]["mean"] == pytest.approx(1.05)
    assert labels["pick_within"]["n"] == 9
    written = json.loads((tmp_path / "stated/predictions.json").read_text())["predictions"]
    assert {(p["pick_within_m"], p["place_within_m"]) for p in written} == {(0.006, 0.0105)}
    monkeypatch.setattr(FakePolicy, "radii_m", (None, None))
    assert "confidence" not in validate(ValidateOptions("color-mask", recording, tmp_path / "silent", last=9))


def ids(chosen, dataset):
    return [int(dataset.attempt_ids[index]) for index in chosen.indices]


def test_training_attempts_are_never_measured_on_where_the_recording_is_or_was(tmp_path, recording):
    run = str(run_of(tmp_path, recording))
    original, copy = open_dataset(recording), open_dataset(shutil.copytree(recording, tmp_path / "copy"))
    for dataset in (original, copy):
        chosen = held_out(run, dataset, 50)
        assert ids(chosen, dataset) == [4, 5, 6]
        assert "kept for validation" in chosen.which
    moved = run_of(tmp_path / "copy", tmp_path / "gone")
    chosen = held_out(str(moved), original, 50)
    assert ids(chosen, original) == [4, 5, 6]
    assert "not there to compare" in chosen.which


def test_another_recording_is_used_whole_and_said_so(tmp_path, recording):
    run = str(run_of(tmp_path, recording))
    other = open_dataset(record(tmp_path / "other", seed=1))
    chosen = held_out(run, other, 50)
    assert chosen.indices == demonstrations(other)
    assert len(chosen.indices) == 12
    assert "another recording" in chosen.which


def test_without_validation_attempts_the_rest_is_taken(tmp_path, recording):
    dataset = open_dataset(recording)
    run = run_of(tmp_path, recording, train=range(10), val=())
    assert ids(held_out(str(run), dataset, 50), dataset) == [10, 11, 12, 13]
    (run / "config.yaml").unlink()
    run.rmdir()
    run = run_of(tmp_path, recording, train=range(14), val=())
    with pytest.raises(BaggieError, match="no successful attempt that is new"):
        held_out(str(run), dataset, 50)


def test_untrained_policies_get_the_last_successful_attempts(recording):
    dataset = open_dataset(recording)
    chosen = held_out("color-mask", dataset, 7)
    assert ids(chosen, dataset) == [6, 8, 9, 10, 11, 12, 13]
    assert not set(FAILED) & set(ids(held_out("color-mask", dataset, 50), dataset))


def test_no_recording_and_no_policy_are_told_in_one_line(tmp_path, recording):
    for policy, data in (("color-mask", tmp_path / "none"), (str(tmp_path / "norun"), recording)):
        with pytest.raises(DataError) as raised:
            validate(ValidateOptions(policy, data, tmp_path / "out"))
        assert "\n" not in str(raised.value)
