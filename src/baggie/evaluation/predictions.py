"""What a policy says of recorded attempts, and how far that is from what was right."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from rich.console import Console
from rich.progress import track

from baggie.data.annotation import shown_goal
from baggie.errors import BaggieError
from baggie.evaluation.metrics import action_errors, references, summary, symmetry_of, within_stated
from baggie.geometry import PlanarPose
from baggie.policies import Policy
from baggie.types import Attempt, PickPlace, Plan


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


def predict(policy: Policy, attempts: Iterable[Attempt], total: int) -> list[Prediction]:
    """The policy's word on each attempt, each timed; the very first plan is made twice, to warm up."""
    predictions: list[Prediction] = []
    for attempt in track(attempts, "validating", total, console=Console(stderr=True)):
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


def measure(predictions: Sequence[Prediction]) -> dict[str, Any]:
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
