"""`baggie validate`: how far a policy's pick and place are off, on attempts it never saw.

Which attempts a policy is measured on: never one it learned from, and it is always said which.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baggie.data import Dataset, open_dataset
from baggie.data.summary import did_its_task
from baggie.errors import BaggieError, DataError
from baggie.evaluation.predictions import RecordedView, predict, save_worst_pictures, summarize_errors
from baggie.evaluation.scored_plans import rates_that_count, with_what_was_carried
from baggie.evaluation.setup import config_of, open_policy
from baggie.geometry import FloatArray
from baggie.operator import Operator, TerminalOperator
from baggie.options.evaluating import ValidateOptions
from baggie.policies import ColorMaskPolicy
from baggie.results import VALIDATION, check_unmixed, provenance, write_json
from baggie.types import Goal
from baggie.vision.draw import check_goal


@dataclass(frozen=True)
class HeldOut:
    """Attempts to measure on."""

    indices: list[int]
    """In the dataset."""
    which: str
    """In words, for the results."""


def held_out(policy: str, dataset: Dataset, last: int) -> HeldOut:
    """The attempts of `dataset` that `policy` did not learn from.

    Those its training kept for validation, when this is the recording it was trained on, or may be: one that
    has moved is compared by what is in it, and where that is impossible its validation attempts are taken,
    which are safe either way. All successful attempts of any other recording. The last `last` for a policy
    that was never trained. Raises `BaggieError` when none is left.
    """
    usable = demonstrations(dataset)
    training = _training(policy)
    if training is None:
        chosen = HeldOut(usable[-last:], f"the last {len(usable[-last:])} that succeeded")
    else:
        chosen = _unseen(training, dataset, usable)
    if not chosen.indices:
        raise BaggieError(f"{dataset.root} has no successful attempt that is new to {policy}; collect more")
    return chosen


def demonstrations(dataset: Dataset) -> list[int]:
    """Indices of the attempts that succeeded, of episodes that did their task; reads no picture.

    Where the task marks goals, only those whose goal lies in the picture before.
    """
    numbers = dataset.numbers()
    usable = numbers["success"] & _of_whole_episodes(dataset.episodes, numbers["reward"])
    if not np.isfinite(numbers["box_after"]).any():
        return [int(index) for index in np.flatnonzero(usable)]

    def in_picture(index: int) -> bool:
        try:
            check_goal(Goal(numbers["box_after"][index]), dataset.settings.picture_size)
        except BaggieError:
            return False
        return True

    return [int(index) for index in np.flatnonzero(usable) if in_picture(int(index))]


def _of_whole_episodes(episodes: NDArray[np.int64], rewards: FloatArray) -> NDArray[np.bool_]:
    """`(N,)`; what stands alone (episode -1) is whole."""
    done = {int(each): did_its_task(rewards[episodes == each]) for each in np.unique(episodes) if each >= 0}
    return np.array([done.get(int(each), True) for each in episodes], bool)


def _training(policy: str) -> Mapping[str, Any] | None:
    """What a run's config.yaml says of its training; None for a policy without one."""
    found = config_of(policy).get("training")
    return found if isinstance(found, Mapping) and "split" in found else None


def _unseen(training: Mapping[str, Any], dataset: Dataset, usable: Sequence[int]) -> HeldOut:
    ids = dataset.attempt_ids
    learned, kept = set(training["split"]["train"]), set(training["split"]["val"])
    same = _same_recording(training, dataset)
    if same is False:
        return HeldOut(list(usable), "all that succeeded of another recording than it learned from")
    known = "" if same else f" (its recording {training['data']} is not there to compare with)"
    if kept:
        return HeldOut(
            [i for i in usable if ids[i] in kept], f"those its training kept for validation{known}"
        )
    rest = [i for i in usable if ids[i] not in learned]
    return HeldOut(rest, f"all that succeeded and its training did not use{known}")


def _same_recording(training: Mapping[str, Any], dataset: Dataset) -> bool | None:
    """Whether the training attempts are those of `dataset`; None when the recording trained on is gone."""
    try:
        original = open_dataset(training["data"])
    except DataError:
        return None
    if original.root.resolve() == dataset.root.resolve():
        return True
    learned = training["split"]["train"]
    ours, theirs = (_executed(recording, learned) for recording in (dataset, original))
    return ours is not None and theirs is not None and bool(np.array_equal(ours, theirs, equal_nan=True))


def _executed(dataset: Dataset, attempt_ids: Sequence[int]) -> np.ndarray | None:
    """`(N, 6)` executed poses of these attempts; None when one of them is missing."""
    index_of = {int(attempt_id): index for index, attempt_id in enumerate(dataset.attempt_ids)}
    if not all(attempt_id in index_of for attempt_id in attempt_ids):
        return None
    executed: np.ndarray = dataset.numbers()["executed"]
    return executed[[index_of[attempt_id] for attempt_id in attempt_ids]]


WORST = 10
CAMERA, HEIGHT_MAPS = "camera", "height maps"
"""What pictures a policy was measured on."""


def validate(options: ValidateOptions, *, operator: Operator | None = None) -> dict[str, Any]:
    """Measure, write `metrics.json`, `predictions.json` and pictures of the ten worst; returns the metrics.

    Pick and place errors are against `"labels"` (poses the arm was really at) and, where the recording has it, against
    `"truth"` (the simulator's: the pick against the bag's place before, the place against that after). Of a task with
    several steps the labels are what the demonstrator chose; `"would_count"`, where the recording tells, is the share
    of plans that would have been as right. A place is compared by where what was picked comes to lie, where height maps
    tell that the plan picks it, too. Raises `BaggieError` when there is nothing to measure on, or the policy can
    tell nothing. The person at the terminal is told how far it is, unless `operator` is given.
    """
    check_unmixed(options.out, VALIDATION)
    operator = operator or TerminalOperator()
    dataset = open_dataset(options.data)
    policy = open_policy(options.policy, options.calibration or options.data)
    if isinstance(policy, ColorMaskPolicy) and dataset.squeezed:  # the map sees what the recording shows
        policy.image_to_robot = policy.image_to_robot.squeezed(dataset.settings.picture_size)
    chosen = held_out(options.policy, dataset, options.last)
    attempts = (dataset[index] for index in chosen.indices)
    predictions = with_what_was_carried(dataset, predict(policy, attempts, len(chosen.indices), operator))
    counted = rates_that_count(dataset, predictions)
    symmetries = sorted({prediction.symmetry for prediction in predictions})
    metrics = {
        "policy": policy.name,
        "run": Path(options.policy).name,
        "held_out": {"attempts": len(predictions), "which": chosen.which},
        "pictures": CAMERA if dataset.grid is None else HEIGHT_MAPS,
        "symmetry": symmetries[0] if len(symmetries) == 1 else symmetries,
        **summarize_errors(predictions),
        **({"would_count": counted} if counted else {}),
        "provenance": provenance(),
    }
    by_error = sorted(
        zip(predictions, chosen.indices, strict=True), key=lambda p: p[0].worst_cm(), reverse=True
    )
    scene = RecordedView.of(dataset)
    worst = [
        save_worst_pictures(options.out, scene, dataset[index], prediction, policy)
        for prediction, index in by_error[:WORST]
    ]
    records = [prediction.to_json() for prediction in predictions]
    write_json(options.out / VALIDATION, {"worst": worst, "predictions": records})
    write_json(options.out / "metrics.json", metrics)
    return metrics
