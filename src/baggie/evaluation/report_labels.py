"""What the report says of the labels a policy learned from: those that do not fit what the others agree on."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from baggie.data import Dataset, open_dataset
from baggie.errors import BaggieError, DataError
from baggie.evaluation.pictures import TRUE, Mark, jpeg, marked
from baggie.evaluation.report_items import Training
from baggie.evaluation.report_values import Content, embedded
from baggie.evaluation.validation_pictures import Scene
from baggie.types import Attempt, Goal, Image
from baggie.vision.draw import paint_goal

MAX_PICTURES = 20
"""Of one training, the worst: a page should stay small enough to be mailed."""


def labels(trainings: Sequence[Training]) -> list[Content]:
    """One entry for each training that compared its labels with each other."""
    return [_labels(training) for training in trainings if "labels_fused" in training.metrics]


def _labels(training: Training) -> Content:
    fused, data = training.metrics["labels_fused"], training.config["training"]["data"]
    doubtful, twice = fused["doubtful"], fused["pictures_with_two_opinions"]
    about = ["No picture was labelled twice."]
    if twice:
        about = [
            f"{twice} pictures were labelled twice, by the collector's eye and by the release before. "
            f"The two differ systematically, by {fused['systematic_mm']:.1f} mm; half of that was corrected."
        ]
    if not doubtful:
        about.append("No label is doubtful.")
    pictures = [""] * len(doubtful)
    if doubtful:
        try:
            pictures = _pictures(open_dataset(data), doubtful)
        except DataError:
            about.append(f"There are no pictures of the doubtful ones: their recording {data} is not there.")
    rows = [
        {"attempt": d["attempt_id"], "what": d["what"], "off": f"{d['off_mm']:.1f} mm", "picture": picture}
        for d, picture in zip(doubtful, pictures, strict=True)
    ]
    return {"policy": training.policy, "about": " ".join(about), "rows": rows, "pictured": any(pictures)}


def _pictures(dataset: Dataset, doubtful: Sequence[dict[str, Any]]) -> list[str]:
    """As parts of the page; empty for what is not shown."""
    scene = Scene.of(dataset)
    index_of = {int(attempt_id): index for index, attempt_id in enumerate(dataset.attempt_ids)}
    shown = []
    for doubt in doubtful[:MAX_PICTURES]:
        try:
            picture = _picture(scene, dataset[index_of[doubt["attempt_id"]]], doubt["what"])
            shown.append(embedded(jpeg(picture), ".jpg"))
        except (KeyError, BaggieError):
            shown.append("")  # the recording is no longer what it was: its other pictures may still help
    return [*shown, *[""] * (len(doubtful) - len(shown))]


def _picture(scene: Scene, attempt: Attempt, what: str) -> Image:
    """The bag outlined as it was seen, and where the arm says it was: before for a pick, after for a place."""
    executed = attempt.outcome.executed
    if what == "pick":
        seen, box, pose = attempt.before, attempt.box_before, executed.pick
    else:
        seen, box, pose = attempt.after or attempt.before, attempt.box_after, executed.place
    inside = np.clip(box, 0, np.array(seen.size) - 1)  # a bag may reach out of the picture
    outlined = paint_goal(seen.color, Goal(inside, "outline", TRUE))
    if scene.to_robot is None:
        return scene.region.cut(outlined)
    by_arm = scene.to_robot.to_pixels([pose.xy])[0]
    return marked(outlined, scene.region, [Mark(what, by_arm, box.mean(axis=0))])
