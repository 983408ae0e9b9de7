"""The report shows everything that was measured and loads nothing from anywhere."""

import base64
import json
import re
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from baggie.errors import BaggieError, DataError
from baggie.evaluation.log import Credit, Episode, Landing
from baggie.evaluation.terms import Terms
from baggie.options.evaluating import ReportOptions
from baggie.report.items import Evaluation, Results, Training
from baggie.report.numbers import _about as numbers_about
from baggie.report.numbers import headline_tiles
from baggie.report.report import gather, labelled, report
from baggie.results import provenance, write_json, write_results
from helpers import bag_evaluations as closed_loop
from helpers.bag_evaluations import evaluate_here
from helpers.reports import Page, fused, make_runs, record_with_a_wrong_pick, trained

SECTIONS = ("video", "numbers", "closed-loop", "validation", "heat", "learning", "labels", "origin")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Not to be changed."""
    return make_runs(tmp_path_factory.mktemp("made"))


@pytest.fixture
def runs(made, tmp_path):
    return shutil.copytree(made, tmp_path / "runs")


def test_the_page_has_every_section_and_needs_nothing_else(tmp_path, runs):
    path = report(ReportOptions((runs,), tmp_path / "report.html", title="Bags & <goals>"))
    text = path.read_text()
    assert "http" not in text
    page = Page(text)
    assert [section for section in SECTIONS if section not in page.ids] == []
    for source in page.sources:
        assert source.startswith(("data:image/jpeg;base64,", "data:video/mp4;base64,", "#"))
    inside = [source for source in page.sources if source.startswith("#") and source[1:] in SECTIONS]
    assert inside == [f"#{section}" for section in SECTIONS]
    videos = [source for source in page.sources if source.startswith("data:video")]
    assert base64.b64decode(videos[0].split(",")[1]) == next(runs.rglob("*.mp4")).read_bytes()
    words = " ".join(page.words)
    assert "Bags & <goals>" in words
    assert "5 of 5 things to within 2 cm" in words  # the policy's
    assert "0 of 5 (0 to 43%)" in words  # the baseline's
    assert "0.50 cm" in words  # the pick error of the fake policy
    assert "off-goal" in words
    assert "From each true place" in words
    assert "val: attempts that were held out" in words
    assert len(re.findall(r"<svg", text)) == 2 + 4 + 1
    assert not re.findall(r"#0[0-9a-f]{5}\b", text)  # every colour of a chart is the page's


def test_a_policy_is_shown_under_each_test_it_was_put_to(tmp_path, runs):
    run = runs / "keypoint"
    unseen = closed_loop.options(run / "unseen", policy=str(run), film=0, scenery="unseen", goal="turned")
    evaluate_here(unseen, closed_loop.open_off_by_25_mm)
    words = " ".join(Page(report(ReportOptions((runs,), tmp_path / "r.html")).read_text()).words)
    assert "keypoint, unseen, turned goals" in words
    assert "Plans against the truth" in words
    assert "2.50 cm" in words  # its place error
    assert "5 of 5 things to within 2 cm" in words  # the plain closed loop is still what the page is about
    assert "pick and place inside their radius" in words
    assert "100% and 100%" in words  # of the validated policy: 5 mm of 6, 6 to 8 mm of 10.5


GOAL = {"landing": Landing((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0, 0.0)}
DONE = {"credit": Credit(1.0, ravens_success=True, success=True)}


def tried(policy, task, ended, **metrics):
    """An evaluation of one episode, which ended near a goal in the picture, or with a task done."""
    episode = Episode(0, (), "", "", 0.0, **ended)
    return Evaluation(Path(policy), policy, policy, metrics, policy, Terms(task, cell=0), [episode])


def labels_of(*evaluations, trainings=()):
    return labelled(Results(list(trainings), [], list(evaluations))).labels()


def test_tasks_are_told_apart_where_there_are_several():
    """One of goals in the picture beside the usual one, and two that say themselves what counts."""
    usual, there, tower = (
        tried("keypoint", "bag-place", GOAL),
        tried("mine", "bag-there", GOAL),
        tried("other", "tower", DONE),
    )
    oracle = tried("oracle", "bag-place", GOAL), tried("oracle", "tower", DONE)
    assert labels_of(usual, there, *oracle) == ["keypoint", "mine, bag-there", "oracle", "oracle, tower"]
    assert labels_of(there, tower) == ["mine, bag-there", "other, tower"]
    assert labels_of(tower, tried("other", "pyramid", DONE)) == ["other, tower", "other, pyramid"]
    assert labels_of(usual, tower) == ["keypoint", "other, tower"]
    assert labels_of(tower) == ["other"]
    learned = Training(Path("other"), "other", "other", {}, "other", {}, {})
    assert labels_of(usual, tower, trainings=[learned]) == ["other, tower", "keypoint"]
    about = numbers_about(Results([], [], [tower]), stated=False)
    assert about.startswith("Success is strict;")


def test_radii_are_told_apart_where_there_are_several():
    usual, wide, wider = (tried("mine", "bag-place", GOAL, radius_cm=radius) for radius in (2.0, 3.0, 5.0))
    assert labels_of(usual, wide) == ["mine", "mine, within 3 cm"]
    assert labels_of(wide, wider) == ["mine, within 3 cm", "mine, within 5 cm"]
    assert labels_of(wide) == ["mine"]


def test_what_counts_within_another_radius_is_not_put_beside(tmp_path, runs):
    run = runs / "keypoint"
    wide = closed_loop.options(run / "wide", policy=str(run), film=0, radius_cm=3.0)
    evaluate_here(wide, closed_loop.open_off_by_25_mm)
    results = gather([runs])
    assert {"keypoint", "keypoint, within 3 cm", "oracle"} <= set(results.labels())
    (tile,) = (tile for tile in headline_tiles(results, "keypoint") if tile["what"].startswith("within 2 cm"))
    assert [name for name, _ in tile["beside"]] == ["oracle"]


def test_a_page_can_be_made_of_one_kind_of_result(tmp_path, runs):
    page = Page(report(ReportOptions((runs / "baseline",), tmp_path / "report.html")).read_text())
    assert "closed-loop" in page.ids
    assert not {"validation", "learning", "video"} & set(page.ids)


def test_where_nobody_knows_the_truth_arrows_begin_at_what_was_recorded(tmp_path, runs):
    path = runs / "keypoint/validation/metrics.json"
    metrics = json.loads(path.read_text())
    del metrics["truth"]
    write_json(path, metrics)
    words = " ".join(Page(report(ReportOptions((runs,), tmp_path / "r.html")).read_text()).words)
    assert "From each recorded place" in words
    assert "From each true place" not in words


def test_two_runs_of_one_policy_are_told_apart(tmp_path, runs):
    (runs / "keypoint").rename(runs / "first")
    evaluation = runs / "second/evaluation"
    policy = runs / "first"
    evaluate_here(closed_loop.options(evaluation, policy=str(policy), film=0), closed_loop.open_perfect)
    words = " ".join(Page(report(ReportOptions((runs,), tmp_path / "r.html")).read_text()).words)
    assert "keypoint (first)" in words
    assert "keypoint (keypoint)" in words  # evaluated under its name of then


def cross_in(uri):
    """From the middle of the close-up, where the bag was seen, to the cross: (u, v), pixels."""
    content = np.frombuffer(base64.b64decode(uri.split(",")[1]), np.uint8)
    close_up = cv2.imdecode(content, cv2.IMREAD_COLOR_RGB)[:, -180:].astype(int)
    magenta = close_up[..., 2] - close_up[..., 1] > 40  # nothing else in the picture has more blue than green
    return np.median(np.argwhere(magenta), axis=0)[::-1] - (np.array([180, 360]) - 1) / 2


def test_doubtful_labels_are_listed_with_what_the_eye_and_the_arm_say(tmp_path):
    record_with_a_wrong_pick(tmp_path / "bags", wrong=5, off_m=0.03)
    doubtful = (5, "pick", 29.96), (7, "place", 9.04), (99, "pick", 8.0)
    trained(tmp_path / "runs/keypoint", tmp_path / "bags", fused(*doubtful))
    trained(tmp_path / "runs/moved", tmp_path / "gone", fused((5, "pick", 29.96)))
    trained(tmp_path / "runs/sure", tmp_path / "bags", fused())
    page = Page(report(ReportOptions((tmp_path / "runs",), tmp_path / "r.html")).read_text())
    words = " ".join(" ".join(page.words).split())
    assert "attempt label off by picture 5 pick 30.0 mm 7 place 9.0 mm 99 pick 8.0 mm moved" in words
    assert "12 pictures were labelled twice" in words
    assert "by 1.3 mm" in words
    assert f"their recording {tmp_path / 'gone'} is not there. attempt label off by 5 pick 30.0 mm" in words
    assert words.count("No label is doubtful.") == 1
    wrong, right = [source for source in page.sources if source.startswith("data:image/jpeg")]  # 99 has none
    off = [cross_in(uri) for uri in (wrong, right)]
    assert np.linalg.norm(off[0]) > 4 * np.linalg.norm(off[1])
    assert off[0][0] < -20  # towards +y, which is to the left in the picture


@pytest.mark.parametrize("folder", ["keypoint", "keypoint/validation"])
def test_results_of_two_runs_with_one_name_are_not_mixed(tmp_path, runs, folder):
    (tmp_path / "elsewhere/keypoint").mkdir(parents=True)
    copy = shutil.copytree(tmp_path / "runs" / folder, tmp_path / "elsewhere" / folder, dirs_exist_ok=True)
    with pytest.raises(
        BaggieError, match=f"{copy} and {tmp_path}/runs/{folder} are both of a run called keypoint"
    ):
        report(ReportOptions((tmp_path / "runs", tmp_path / "elsewhere"), tmp_path / "r.html"))


def test_nothing_to_report_and_broken_results_are_told(tmp_path, runs):
    with pytest.raises(BaggieError, match="expected a folder of results"):
        report(ReportOptions((tmp_path / "none",), tmp_path / "r.html"))
    (tmp_path / "empty").mkdir()
    with pytest.raises(BaggieError, match="found nothing to report"):
        report(ReportOptions((tmp_path / "empty",), tmp_path / "r.html"))
    (runs / "keypoint/validation/metrics.json").write_text('{"policy": "key')
    with pytest.raises(DataError, match=r"cannot read the results in .*validation"):
        report(ReportOptions((runs,), tmp_path / "r.html"))


def test_results_carry_where_they_come_from(tmp_path):
    rows = [{"policy": "a|b", "error_cm": 0.123456789}, {"policy": "c", "error_cm": 7.8, "n": 50}]
    json_path, markdown_path = write_results(
        tmp_path / "sub/errors", "Errors", rows, provenance([3, 4]), "A note."
    )
    content = json.loads(json_path.read_text())
    assert content["rows"] == rows
    origin = content["provenance"]
    assert origin["seeds"] == [3, 4]
    assert set(origin) == {"command", "seeds", "commit", "machine", "date", "python", "packages"}
    assert origin["machine"]["cores"] >= 1
    assert origin["packages"]["numpy"]
    lines = markdown_path.read_text().splitlines()
    assert lines[0] == "# Errors"
    assert lines[2:6] == [
        "| policy | error_cm | n |",
        "| --- | --- | --- |",
        "| a\\|b | 0.1235 |  |",
        "| c | 7.8 | 50 |",
    ]
    assert f"- date: {origin['date']}" in lines
    assert sum(line.startswith("- ") for line in lines) == 6
