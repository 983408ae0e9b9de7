"""What a policy says of recorded attempts, and how far that is from what was right.

Pictures of a validation: a recorded attempt with the plan and what was right marked in it, and its heat maps.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from baggie.calibration.files import CameraIdentity
from baggie.calibration.image_to_robot.map import ImageToRobot
from baggie.data import Dataset
from baggie.data.summary import shown_goal
from baggie.errors import BaggieError
from baggie.evaluation.marked_pictures import Mark, Region, backdrop, heat_over, marked, save_jpeg
from baggie.geometry import FloatArray, Grid, PlanarPose
from baggie.metrics import action_errors, references, summary, symmetry_of, within_stated
from baggie.operator import Operator, progress
from baggie.policies import Policy
from baggie.types import Attempt, PickPlace, Plan
from baggie.vision.draw import paint_goal


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
    pick_within_m: float | None = None
    """What the plan said of itself, as `Plan` says it; None where it said nothing."""
    place_within_m: float | None = None
    message: str = ""
    """Why it could not tell."""
    symmetry: int = 4
    """How often a turn what is moved looks the same."""
    stands: PlanarPose | None = None
    """Where the middle of what was moved stood, if the plan picks it, too; None where it does not or nobody knows."""

    @property
    def best_reference(self) -> PickPlace:
        """The truth where it is known, else the labels."""
        return self.references.get("truth", self.references["labels"])

    def errors(self) -> dict[str, dict[str, float]]:
        """By reference, then by quantity, with units in the keys; nothing where there is no action."""
        if self.action is None:
            return {}
        return {
            name: action_errors(self.action, right, self.symmetry, self.stands)
            for name, right in self.references.items()
        }

    def worst_cm(self) -> float:
        """The greater of both errors against the best reference there is; infinite without an action."""
        if self.action is None:
            return float("inf")
        best = action_errors(self.action, self.best_reference, self.symmetry, self.stands)
        return max(best["pick_error_cm"], best["place_error_cm"])

    def to_json(self) -> dict[str, Any]:
        """Poses are [x, y, yaw] in metres and radians."""
        poses = dict(self.references) | ({"predicted": self.action} if self.action else {})
        return {
            "attempt_id": self.attempt_id,
            "decision_ms": self.decision_ms,
            "confidence": self.confidence,
            "pick_within_m": self.pick_within_m,
            "place_within_m": self.place_within_m,
            "message": self.message,
            "symmetry": self.symmetry,
            "poses": {
                name: {"pick": pose_list(p.pick), "place": pose_list(p.place)} for name, p in poses.items()
            },
            "errors": self.errors(),
        }


def predict(policy: Policy, attempts: Iterable[Attempt], total: int, operator: Operator) -> list[Prediction]:
    """The policy's word on each attempt, each timed; the very first plan is made twice, to warm up."""
    predictions: list[Prediction] = []
    with progress(operator, "validating", total) as advance:
        for attempt in attempts:
            goal = shown_goal(attempt)
            for _ in range(1 if predictions else 2):
                plan, message = None, ""
                start = time.perf_counter()
                try:
                    plan = policy.plan(attempt.before, goal)
                except BaggieError as error:
                    message = str(error)
                decision_ms = 1000 * (time.perf_counter() - start)
            predictions.append(_prediction(attempt, plan, decision_ms, message))
            advance()
    return predictions


def _prediction(attempt: Attempt, plan: Plan | None, decision_ms: float, message: str) -> Prediction:
    said = Prediction(
        attempt.attempt_id,
        None,
        references(attempt),
        decision_ms,
        message=message,
        symmetry=symmetry_of(attempt),
    )
    if plan is None:
        return said
    return replace(
        said,
        action=plan.action,
        confidence=plan.confidence,
        pick_within_m=plan.pick_within_m,
        place_within_m=plan.place_within_m,
    )


def summarize_errors(predictions: Sequence[Prediction]) -> dict[str, Any]:
    """`labels` and `truth` as summaries of errors, `decision_ms`, and how often the policy could not tell.

    With `confidence` where plans state radii: for `labels` and `truth`, the share of picks and of places inside them,
    and the radii. Raises `BaggieError` where there is no plan at all.
    """
    planned = [prediction for prediction in predictions if prediction.action is not None]
    if not planned:
        why = f": {predictions[0].message}" if predictions else ""
        raise BaggieError(f"the policy could plan none of {len(predictions)} held-out attempts{why}")
    metrics: dict[str, Any] = {}
    confidence: dict[str, Any] = {}
    for reference in ("labels", "truth"):
        known = [prediction for prediction in planned if reference in prediction.references]
        errors = [prediction.errors()[reference] for prediction in known]
        if errors:
            metrics[reference] = {key: summary([e[key] for e in errors]) for key in errors[0]}
            confidence |= _confidence(reference, known, errors)
    if confidence:
        metrics["confidence"] = confidence
    metrics["decision_ms"] = summary([prediction.decision_ms for prediction in predictions])
    metrics["without_plan"] = len(predictions) - len(planned)
    return metrics


def _confidence(
    reference: str, predictions: Sequence[Prediction], errors: Sequence[Mapping[str, float]]
) -> dict[str, Any]:
    """How true the plans are to their radii by one reference, whose errors these are; empty where none states one.

    A place's radius is about where the object ends. Only labels tell: a release so far beside the planned one put the
    object just as far beside its goal.
    """
    found = within_stated(
        "pick", [e["pick_error_cm"] for e in errors], [p.pick_within_m for p in predictions]
    )
    if reference == "labels":
        found |= within_stated(
            "place", [e["place_error_cm"] for e in errors], [p.place_within_m for p in predictions]
        )
    return {reference: found} if found else {}


def pose_list(pose: PlanarPose) -> list[float]:
    """`[x, y, yaw]` in metres and radians."""
    return [pose.x, pose.y, pose.yaw]


_ROUGH_MM = 20.0
"""A map that is this far off still shows which way a plan is off."""


@dataclass(frozen=True)
class RecordedView:
    """What the pictures of a recording show, for drawing only."""

    region: Region
    """The part of the picture in which bags were seen."""
    to_robot: ImageToRobot | None
    """Fitted to where bags were seen when they were handled; None where those are too few to tell."""
    grid: Grid | None = None
    """Of pictures from straight above, which need no such map."""

    @classmethod
    def of(cls, dataset: Dataset) -> RecordedView:
        """From the numbers of all attempts that succeeded."""
        if dataset.grid is not None:
            return cls(Region(0, 0, *dataset.settings.picture_size), None, dataset.grid)
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
        if self.grid is not None:
            return Mark(name, *self.grid.to_pixels([planned.xy, right.xy]))
        center = np.asarray(box.mean(axis=0))
        if self.to_robot is None:
            return Mark(name, center, center)
        # The map is rough, but the difference of two points close together is not.
        a, b = self.to_robot.to_pixels([planned.xy, right.xy])
        return Mark(name, center + a - b, center)


def save_worst_pictures(
    out: Path, scene: RecordedView, attempt: Attempt, prediction: Prediction, policy: Policy
) -> dict[str, Any]:
    """The picture before with goal and marks, and the heat maps over it: their paths relative to `out`."""
    goal = shown_goal(attempt)
    picture = attempt.before.color if goal is None else paint_goal(attempt.before.color, goal)
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
    known = [
        mark for mark in marks if np.isfinite(mark.true).all()
    ]  # where nobody looked for it there is no place
    shown = marked(picture, scene.region, known) if known else scene.region.cut(picture)
    save_jpeg(out / f"{name}.jpg", shown)
    views = policy.plan(attempt.before, goal).views
    if views:
        save_jpeg(out / f"{name}-heat.jpg", heat_over(backdrop(attempt.before), scene.region, views))
        record["heat"] = f"{name}-heat.jpg"
    return record
