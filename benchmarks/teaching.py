"""What the experiments about learning share: training on chosen attempts, once, and errors against the truth."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch

from baggie.data import open_dataset
from baggie.data.summary import goal_of
from baggie.geometry import FloatArray, apply_homography
from baggie.learning import KeypointTraining, train
from baggie.learning.keypoint import KeypointOptions, KeypointRecipe
from baggie.learning.split import Split
from baggie.metrics import yaw_error_deg
from baggie.operator import Nobody, Operator
from baggie.policies import load_policy
from baggie.policies.keypoint.policy import KeypointPolicy
from baggie.processes import LocalProcesses
from baggie.types import Attempt

ERRORS = "errors.json"


@dataclass(frozen=True)
class Lesson:
    """One training: what it is called, what it learns from, and how."""

    name: str
    recording: Path
    first: int
    """Of the demonstrations, by attempt id."""
    train: int
    val_after: int
    """Validation attempts come after so many demonstrations."""
    val: int = 50
    seed: int = 0
    steps: int | None = None
    options: KeypointOptions = field(default_factory=KeypointOptions)
    recipe: type[KeypointRecipe] = KeypointRecipe

    def attempts(self) -> list[Attempt]:
        """The training attempts and then those to measure on, which no lesson of the recording learns from."""
        split = _split(self.recording, self.val_after, self.val)
        return split.train[self.first : self.first + self.train] + split.val


@cache
def _split(recording: Path, train: int, val: int) -> Split:
    """Read once in every process: that takes as long as a tenth of a training."""
    return Split.of(open_dataset(recording), train, val)


def teach_all(lessons: Sequence[Lesson], runs: Path, workers: int = 2) -> dict[str, dict[str, Any]]:
    """Errors by lesson's name; two lessons at a time on one thread each. What is there already is kept."""
    missing = [lesson for lesson in lessons if not (runs / lesson.name / ERRORS).exists()]
    taught = LocalProcesses().stream(partial(_open_worker, runs), missing, workers, Nobody())
    for done, name in enumerate(taught, start=1):
        print(f"{done}/{len(missing)} {name}", flush=True)
    return {lesson.name: json.loads((runs / lesson.name / ERRORS).read_text()) for lesson in lessons}


def _open_worker(runs: Path, _operator: Operator) -> Callable[[Lesson], Iterable[str]]:
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
    return partial(_teach, runs)


def _teach(runs: Path, lesson: Lesson) -> list[str]:
    out = runs / lesson.name
    options = KeypointTraining(
        data=lesson.recording,
        out=out,
        train=lesson.train,
        val=lesson.val,
        seed=lesson.seed,
        steps=lesson.steps,
        device="cpu",
    )
    attempts = lesson.attempts()
    recipes: list[KeypointRecipe] = []

    def make(chosen: Sequence[Attempt]) -> KeypointRecipe:
        recipes.append(lesson.recipe(chosen, lesson.options))
        return recipes[0]

    metrics = train(options, attempts, make)
    errors = {"train_s": metrics["train_s"], **_errors(recipes[0], out, attempts[lesson.train :])}
    (out / ERRORS).write_text(json.dumps(errors))
    return [lesson.name]


def _errors(recipe: KeypointRecipe, out: Path, val: Sequence[Attempt]) -> dict[str, Any]:
    """Errors against the truth, cm and degrees; from the network itself: without heat maps a policy would not plan."""
    policy = recipe.policy
    if recipe.network_class is KeypointRecipe.network_class:
        loaded = load_policy(out)
        assert isinstance(loaded, KeypointPolicy)
        policy = loaded
    else:
        import safetensors.torch  # noqa: PLC0415

        policy.network.load_state_dict(safetensors.torch.load_file(out / "policy.safetensors"))
    errors = np.array([_error(policy, attempt) for attempt in val])
    return {
        "pick_cm": errors[:, 0].tolist(),
        "place_cm": errors[:, 1].tolist(),
        "yaw_deg": errors[:, 2].tolist(),
    }


def _error(policy: KeypointPolicy, attempt: Attempt) -> FloatArray:
    goal, view = goal_of(attempt), policy.view
    image = policy.goal_input.network_input(view.cut(attempt.before.color), view.goal_to_input(goal))
    corners = apply_homography(view.normalize(), goal.corners)
    anywhere, on_table = np.array([0, 0, 1e4], np.float32), np.zeros(2, np.float32)
    found = policy.read(image[None], anywhere, corners.astype(np.float32), on_table)
    assert attempt.truth is not None
    truth = np.stack([attempt.truth.before.xy, attempt.truth.after.xy])
    pick = replace(attempt.truth.before, yaw=float(found.yaw))
    return np.array(
        [*(100 * np.linalg.norm(found.xy - truth, axis=1)), yaw_error_deg(pick, attempt.truth.before)]
    )
