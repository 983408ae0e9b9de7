"""`baggie validate`: how far a policy's pick and place are off, on attempts it never saw."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track

from baggie.calibration.files import CameraIdentity
from baggie.calibration.image_to_robot.map import ImageToRobot
from baggie.data import Dataset, open_dataset
from baggie.data.annotation import goal_of
from baggie.errors import BaggieError
from baggie.evaluation.heldout import held_out
from baggie.evaluation.metrics import action_errors, references, summary
from baggie.evaluation.pictures import Mark, Region, heat_over, marked, save_jpeg
from baggie.evaluation.results import provenance, write_json
from baggie.evaluation.subjects import open_policy
from baggie.geometry import FloatArray, PlanarPose
from baggie.policies import Policy
from baggie.types import Attempt, PickPlace
from baggie.vision.draw import paint_goal

WORST = 10
_ROUGH_MM = 20.0
"""A map that is this far off still shows which way a plan is off."""


@dataclass(frozen=True)
class ValidateOptions:
    """Measure pick and place errors on attempts the policy never learned from.

    Example: baggie validate --policy runs/keypoint --data recordings/bags --out runs/keypoint/validation
    """

    policy: str
    """A training run's folder, a Hub id, or `color-mask`."""
    data: Path
    """The recording."""
    out: Path
    """Where metrics.json, predictions.json and pictures/ go."""
    last: int = 50
    """For a policy that was not trained: how many successful attempts, from the end, to measure it on."""
    calibration: Path | None = None
    """For `color-mask`: its image-to-robot map. By default the one in the recording's calibration/ folder."""


@dataclass(frozen=True)
class Prediction:
    """What a policy said of one attempt, and what it should have said."""

    attempt_id: int
    action: PickPlace | None
    """None where it could not tell."""
    references: Mapping[str, PickPlace]
    """`labels`: the poses the arm was really at; and where there is one, the simulator's `truth`."""
    decision_ms: float
    confidence: float = 0.0
    message: str = ""
    """Why it could not tell."""

    @property
    def best_reference(self) -> PickPlace:
        """The truth where it is known, else the labels."""
        return self.references.get("truth", self.references["labels"])

    def errors(self) -> dict[str, dict[str, float]]:
        """By reference, then by quantity, with units in the keys; nothing where there is no action."""
        if self.action is None:
            return {}
        return {name: action_errors(self.action, right) for name, right in self.references.items()}

    def worst_cm(self) -> float:
        """The greater of both errors against the best reference there is; infinite without an action."""
        if self.action is None:
            return float("inf")
        best = action_errors(self.action, self.best_reference)
        return max(best["pick_error_cm"], best["place_error_cm"])

    def to_json(self) -> dict[str, Any]:
        """Poses are [x, y, yaw] in metres and radians."""
        poses = dict(self.references) | ({"predicted": self.action} if self.action else {})
        return {
            "attempt_id": self.attempt_id,
            "decision_ms": self.decision_ms,
            "confidence": self.confidence,
            "message": self.message,
            "poses": {
                name: {"pick": pose_list(p.pick), "place": pose_list(p.place)} for name, p in poses.items()
            },
            "errors": self.errors(),
        }


def validate(options: ValidateOptions) -> dict[str, Any]:
    """Measure, write `metrics.json`, `predictions.json` and pictures of the ten worst; returns the metrics.

    Pick and place errors are against `"labels"` (poses the arm was really at) and, where the recording has
    it, against `"truth"` (the simulator's: the pick against the bag's place before, the place against that
    after). Raises `BaggieError` when there is nothing to measure on, or the policy can tell nothing.
    """
    dataset = open_dataset(options.data)
    policy = open_policy(options.policy, options.calibration or options.data)
    chosen = held_out(options.policy, dataset, options.last)
    predictions = predict(policy, (dataset[index] for index in chosen.indices), len(chosen.indices))
    metrics = {
        "policy": policy.name,
        "run": Path(options.policy).name,
        "held_out": {"attempts": len(predictions), "which": chosen.which},
        **measure(predictions),
        "provenance": provenance(),
    }
    by_error = sorted(
        zip(predictions, chosen.indices, strict=True), key=lambda p: p[0].worst_cm(), reverse=True
    )
    scene = Scene.of(dataset)
    worst = [
        save_pictures(options.out, scene, dataset[index], prediction, policy)
        for prediction, index in by_error[:WORST]
    ]
    records = [prediction.to_json() for prediction in predictions]
    write_json(options.out / "predictions.json", {"worst": worst, "predictions": records})
    write_json(options.out / "metrics.json", metrics)
    return metrics


def predict(policy: Policy, attempts: Iterable[Attempt], total: int) -> list[Prediction]:
    """The policy's word on each attempt, each timed; the very first plan is made twice, to warm up."""
    predictions: list[Prediction] = []
    for attempt in track(attempts, "validating", total, console=Console(stderr=True)):
        goal = goal_of(attempt)
        right = references(attempt)
        for _ in range(1 if predictions else 2):
            action, confidence, message = None, 0.0, ""
            start = time.perf_counter()
            try:
                plan = policy.plan(attempt.before, goal)
                action, confidence = plan.action, plan.confidence
            except BaggieError as error:
                message = str(error)
            decision_ms = 1000 * (time.perf_counter() - start)
        predictions.append(Prediction(attempt.attempt_id, action, right, decision_ms, confidence, message))
    return predictions


def measure(predictions: Sequence[Prediction]) -> dict[str, Any]:
    """`labels` and `truth` as summaries of errors, `decision_ms`, and how often the policy could not tell."""
    planned = [prediction for prediction in predictions if prediction.action is not None]
    if not planned:
        why = f": {predictions[0].message}" if predictions else ""
        raise BaggieError(f"the policy could plan none of {len(predictions)} held-out attempts{why}")
    metrics: dict[str, Any] = {}
    for reference in ("labels", "truth"):
        errors = [e[reference] for prediction in planned if reference in (e := prediction.errors())]
        if errors:
            metrics[reference] = {key: summary([e[key] for e in errors]) for key in errors[0]}
    metrics["decision_ms"] = summary([prediction.decision_ms for prediction in predictions])
    metrics["without_plan"] = len(predictions) - len(planned)
    return metrics


@dataclass(frozen=True)
class Scene:
    """What the pictures of a recording show, for drawing only."""

    region: Region
    """The part of the picture in which bags were seen."""
    to_robot: ImageToRobot | None
    """Fitted to where bags were seen when they were handled; None where those are too few to tell."""

    @classmethod
    def of(cls, dataset: Dataset) -> Scene:
        """From the numbers of all attempts that succeeded."""
        numbers, size = dataset.successful().numbers(), dataset.settings.picture_size
        boxes = np.concatenate([numbers["box_before"], numbers["box_after"]])  # (2N, 4, 2)
        places = np.concatenate([numbers["executed"][:, 0:2], numbers["executed"][:, 3:5]])
        seen = np.isfinite(boxes).all(axis=(1, 2))
        region = Region.around(boxes.reshape(-1, 2), size)
        centers, on_table = boxes[seen].mean(axis=1), np.column_stack([places[seen], np.zeros(seen.sum())])
        camera = CameraIdentity("recorded", *size)
        try:
            return cls(region, ImageToRobot.fit(centers, on_table, camera, limit_mm=_ROUGH_MM))
        except BaggieError:
            return cls(region, None)

    def mark(self, name: str, box: FloatArray, planned: PlanarPose, right: PlanarPose) -> Mark:
        """A plan beside the middle of `box` `(4, 2)`, where the bag was seen when it was at `right`."""
        center = np.asarray(box.mean(axis=0))
        if self.to_robot is None:
            return Mark(name, center, center)
        # The map is rough, but the difference of two points close together is not.
        a, b = self.to_robot.to_pixels([planned.xy, right.xy])
        return Mark(name, center + a - b, center)


def save_pictures(
    out: Path, scene: Scene, attempt: Attempt, prediction: Prediction, policy: Policy
) -> dict[str, Any]:
    """The picture before with goal and marks, and the heat maps over it: their paths relative to `out`."""
    goal = goal_of(attempt)
    picture = paint_goal(attempt.before.color, goal)
    name = f"pictures/attempt-{attempt.attempt_id:06d}"
    record = {"attempt_id": attempt.attempt_id, "picture": f"{name}.jpg", "errors": prediction.errors()}
    if prediction.action is None:
        save_jpeg(out / f"{name}.jpg", scene.region.cut(picture))
        return record
    action, right = prediction.action, prediction.best_reference
    marks = [
        scene.mark("pick", attempt.box_before, action.pick, right.pick),
        scene.mark("place", attempt.box_after, action.place, right.place),
    ]
    save_jpeg(out / f"{name}.jpg", marked(picture, scene.region, marks))
    views = policy.plan(attempt.before, goal).views
    if views:
        save_jpeg(out / f"{name}-heat.jpg", heat_over(attempt.before.color, scene.region, views))
        record["heat"] = f"{name}-heat.jpg"
    return record


def pose_list(pose: PlanarPose) -> list[float]:
    """`[x, y, yaw]` in metres and radians."""
    return [pose.x, pose.y, pose.yaw]
