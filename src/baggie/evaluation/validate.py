"""`baggie validate`: how far a policy's pick and place are off, on attempts it never saw."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from baggie.data import open_dataset
from baggie.evaluation.carried_steps import with_what_was_carried
from baggie.evaluation.heldout import held_out
from baggie.evaluation.predictions import measure, predict
from baggie.evaluation.results import VALIDATION, check_unmixed, provenance, write_json
from baggie.evaluation.subjects import open_policy
from baggie.evaluation.validation_pictures import Scene, save_pictures
from baggie.evaluation.would_count import would_count
from baggie.policies import ColorMaskPolicy
from baggie.ranges import Count, Options

WORST = 10
CAMERA, HEIGHT_MAPS = "camera", "height maps"
"""What pictures a policy was measured on."""


@dataclass(frozen=True)
class ValidateOptions(Options):
    """Measure pick and place errors on attempts the policy never learned from.

    Example: baggie validate --policy runs/keypoint --data recordings/bags --out runs/keypoint/validation
    """

    policy: str
    """A training run's folder, a Hub id, or `color-mask`."""
    data: Path
    """The recording."""
    out: Path
    """Where metrics.json, predictions.json and pictures/ go."""
    last: Count = 50
    """For a policy that was not trained: how many successful attempts, from the end, to measure it on."""
    calibration: Path | None = None
    """For `color-mask`: its image-to-robot map. By default the one in the recording's calibration/ folder."""


def validate(options: ValidateOptions) -> dict[str, Any]:
    """Measure, write `metrics.json`, `predictions.json` and pictures of the ten worst; returns the metrics.

    Pick and place errors are against `"labels"` (poses the arm was really at) and, where the recording has it, against
    `"truth"` (the simulator's: the pick against the bag's place before, the place against that after). Of a task with
    several steps the labels are what the demonstrator chose; `"would_count"`, where the recording tells, is the share
    of plans that would have been as right. A place is compared by where what was picked comes to lie, where height maps
    tell that the plan picks it, too. Raises `BaggieError` when there is nothing to measure on, or the policy can
    tell nothing.
    """
    check_unmixed(options.out, VALIDATION)
    dataset = open_dataset(options.data)
    policy = open_policy(options.policy, options.calibration or options.data)
    if isinstance(policy, ColorMaskPolicy) and dataset.squeezed:  # the map sees what the recording shows
        policy.image_to_robot = policy.image_to_robot.squeezed(dataset.settings.picture_size)
    chosen = held_out(options.policy, dataset, options.last)
    attempts = (dataset[index] for index in chosen.indices)
    predictions = with_what_was_carried(dataset, predict(policy, attempts, len(chosen.indices)))
    counted = would_count(dataset, predictions)
    symmetries = sorted({prediction.symmetry for prediction in predictions})
    metrics = {
        "policy": policy.name,
        "run": Path(options.policy).name,
        "held_out": {"attempts": len(predictions), "which": chosen.which},
        "pictures": CAMERA if dataset.grid is None else HEIGHT_MAPS,
        "symmetry": symmetries[0] if len(symmetries) == 1 else symmetries,
        **measure(predictions),
        **({"would_count": counted} if counted else {}),
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
    write_json(options.out / VALIDATION, {"worst": worst, "predictions": records})
    write_json(options.out / "metrics.json", metrics)
    return metrics
