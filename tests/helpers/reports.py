"""Runs to report on, and the page of a report taken apart."""

from dataclasses import replace
from html.parser import HTMLParser
from unittest.mock import patch

import numpy as np
import yaml

from baggie.data import DatasetWriter
from baggie.evaluation import validate as validation
from baggie.evaluation.validate import validate
from baggie.geometry import PlanarPose
from baggie.options.evaluating import ValidateOptions
from baggie.results import provenance, write_json
from helpers.bag_evaluations import evaluate_here, open_off_by_25_mm, open_perfect, options
from helpers.recorded_bags import SIZE, FakePolicy, record
from helpers.synthetic import TASK, make_attempt

VOID = {"meta", "img", "link", "br"}


class Page(HTMLParser):
    """Ids, sources and text of a page; fails on tags that are closed in another order than opened."""

    def __init__(self, text):
        super().__init__()
        self.ids, self.sources, self.words, self.open = [], [], [], []
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        values = dict(attrs)
        self.ids += [values["id"]] if "id" in values else []
        self.sources += [values[key] for key in ("src", "href") if key in values]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)


def fused(*doubtful):
    """What a training says of its labels; `doubtful` are (attempt, what, mm)."""
    listed = [{"attempt_id": number, "what": what, "off_mm": off} for number, what, off in doubtful]
    return {"pictures_with_two_opinions": 12, "systematic_mm": 1.26, "doubtful": listed}


def make_runs(folder):
    """Below `folder`: a trained policy, validated and evaluated, and a baseline, evaluated."""
    from torch.utils.tensorboard import SummaryWriter

    run = folder / "runs/keypoint"
    run.mkdir(parents=True)
    config = {"policy": "keypoint", "training": {"data": "x", "split": {"train": [0], "val": [4, 5, 6]}}}
    (run / "config.yaml").write_text(yaml.safe_dump(config))
    metrics = {"train_s": 187.0, "labels_fused": fused(), "provenance": provenance([0])}
    write_json(run / "metrics.json", metrics)
    with SummaryWriter(str(run)) as board:
        for step in range(10):
            board.add_scalar("train/loss", 1 / (1 + step), step)
    recording = record(folder / "recorded")
    with (
        patch.object(validation, "open_policy", lambda *_: FakePolicy(recording)),
        patch.object(FakePolicy, "name", "keypoint"),
    ):
        validate(ValidateOptions(str(run), recording, run / "validation"))
    evaluate_here(options(run / "evaluation", policy=str(run)), open_perfect)
    off = options(folder / "runs/baseline", policy="oracle", film=0)
    evaluate_here(off, open_off_by_25_mm)
    return folder / "runs"


def record_with_a_wrong_pick(folder, wrong, off_m):
    rng = np.random.default_rng(0)
    settings = {"task": TASK, "picture_size": SIZE, "collection": {}}
    with DatasetWriter(folder, robot_type="drawn", **settings) as writer:
        for attempt_id in range(12):
            attempt = make_attempt(attempt_id, rng, SIZE, depth=False)
            if attempt_id == wrong:
                executed = attempt.outcome.executed
                pick = PlanarPose(executed.pick.x, executed.pick.y + off_m, executed.pick.yaw)
                outcome = replace(attempt.outcome, executed=replace(executed, pick=pick))
                attempt = replace(attempt, outcome=outcome)
            writer.append(attempt)


def trained(folder, data, labels):
    folder.mkdir(parents=True)
    config = {"policy": folder.name, "training": {"data": str(data), "split": {"train": [], "val": []}}}
    (folder / "config.yaml").write_text(yaml.safe_dump(config))
    write_json(folder / "metrics.json", {"labels_fused": labels})
