"""`baggie train`: from a recording to a policy in a folder."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import torch
from accelerate import Accelerator

from baggie.calibration.files import REFERENCE_FILE
from baggie.data import Dataset, open_dataset
from baggie.data.files import CALIBRATION_FOLDER, read_complete_json
from baggie.data.summary import shown_goal
from baggie.errors import BaggieError, DataError
from baggie.learning.demonstrations import carried_in
from baggie.learning.loop import Recipe, TrainingLoop
from baggie.learning.split import Split
from baggie.metrics import action_errors, references, summary, symmetry_of
from baggie.operator import Line, Nobody, Operator, TerminalOperator
from baggie.options.training import TrainOptions
from baggie.policies import checkpoint
from baggie.policies.base import Policy
from baggie.policies.learned import LearnedPolicy, check_device
from baggie.registry import named
from baggie.results import TRAINING, check_unmixed, provenance
from baggie.types import Attempt

METRICS = "metrics.json"
_LATELY = ("task", "labels", "symmetry")
"""What older versions did not write down of a training."""


def train(
    options: TrainOptions,
    attempts: Sequence[Attempt] | None = None,
    make_recipe: Callable[[Sequence[Attempt]], Recipe] | None = None,
    *,
    operator: Operator | None = None,
) -> dict[str, Any]:
    """Train a policy, or go on with it, or find it finished; returns what stands in its `metrics.json`.

    `attempts` replaces the recording that `options.data` names; `make_recipe` makes a recipe of your own from those to
    learn from, in place of the one that the options name. The last weights (the last average of them,
    where the recipe keeps one) are the result, by rule: nothing is chosen by looking. The truth of simulated
    attempts goes into `metrics.json` and nowhere else. The person at the terminal is told how far it is, unless
    `operator` is given. Raises `BaggieError` for what a user can mend, and
    KeyboardInterrupt, whose message says how to go on, when stopped.
    """
    options.check()
    check_unmixed(options.out, TRAINING)
    accelerator = _accelerator(options.device)
    operator = (operator or TerminalOperator()) if accelerator.is_main_process else Nobody()
    recorded = open_dataset(options.data) if attempts is None else attempts
    kind: type[Recipe] = named(options.recipe)
    split = kind.split(recorded, options.train, options.val)
    torch.manual_seed(options.seed)
    recipe = kind.of(options, split.train) if make_recipe is None else make_recipe(split.train)
    steps = options.steps or _begun_with(options, recipe) or recipe.steps
    if isinstance(recorded, Dataset):
        recipe.policy.camera_size = recorded.camera_size
    recipe.policy.training = _record(options, split, steps) | recipe.chosen()
    _claim(options, recipe.policy, accelerator)
    if (options.out / METRICS).exists():
        note = f"{options.out} holds this very training, finished; to train again, give another --out"
        operator.tell(Line(note))
        finished: dict[str, Any] = read_complete_json(options.out / METRICS)
        return finished
    if None in (options.train, options.val):
        train, val = (len({each.attempt_id for each in part}) for part in (split.train, split.val))
        numbers = (
            f"learning from {train} attempts, measuring on {val} others (--train and --val say how many)"
        )
        operator.tell(Line(numbers))
    if isinstance(recorded, Dataset) and recorded.squeezed:
        (width, height), (to_width, to_height) = recorded.camera_size, recorded.settings.picture_size
        squeezed = (
            f"these pictures of {width} x {height} were squeezed to {to_width} x {to_height} when they were recorded; "
            "the policy will squeeze what it sees alike"
        )
        operator.tell(Line(squeezed))
    if note := recipe.note():
        operator.tell(Line(note))
    training = TrainingLoop(
        recipe,
        options.out,
        steps=steps,
        seed=options.seed,
        save_every_s=options.save_every_s,
        accelerator=accelerator,
        operator=operator,
    )
    judge = partial(plan_errors, attempts=split.val, symmetry=recipe.symmetry)
    seconds = training.run(judge)
    policy = training.policy
    metrics = {
        "policy": policy.name,
        "steps": steps,
        "train_s": seconds,
        **recipe.finish(policy, split.val),
        **judge(policy),
        "provenance": provenance([options.seed]),
    }
    if accelerator.is_main_process:
        policy.save_pretrained(options.out)
        reference = options.data / CALIBRATION_FOLDER / REFERENCE_FILE
        if reference.exists():  # so that whoever runs the policy notices that the camera has moved since
            shutil.copyfile(reference, options.out / REFERENCE_FILE)
        content = json.dumps(metrics, indent=2, allow_nan=False).encode()
        checkpoint.write_files(options.out, {METRICS: content})  # last: where it is, all is there
    return metrics


def _accelerator(device: str) -> Accelerator:
    check_device(device)
    return Accelerator(cpu=device == "cpu")


def _record(options: TrainOptions, split: Split, steps: int) -> dict[str, Any]:
    """What `config.yaml` says of any training; with what the recipe adds, all that decides its result."""
    return {
        "data": str(options.data),
        "task": split.train[0].task,
        "labels": _fingerprint(split.train),
        "seed": options.seed,
        "steps": steps,
        "split": {
            "rule": split.rule,
            "train": [attempt.attempt_id for attempt in split.train],
            "val": [attempt.attempt_id for attempt in split.val],
        },
    }


def _fingerprint(attempts: Sequence[Attempt]) -> str:
    """Changes when other attempts were recorded under the same name: a hash of what was done in them."""
    done = [(attempt.commanded.to_array(), attempt.outcome.executed.to_array()) for attempt in attempts]
    return hashlib.sha256(np.array(done).tobytes()).hexdigest()[:16]


def _begun_with(options: TrainOptions, recipe: Recipe) -> int | None:
    """The steps of a training that an older version began in the folder, where that usually took so many."""
    if recipe.steps_before is None or not (options.out / checkpoint.CONFIG).exists():
        return None
    begun = checkpoint.read_config(options.out).get("training") or {}
    return recipe.steps_before if begun.get("steps") == recipe.steps_before else None


def _claim(options: TrainOptions, policy: LearnedPolicy, accelerator: Accelerator) -> None:
    """Make the run's folder with its config, or check that an existing one is of this very training."""
    path = options.out / checkpoint.CONFIG
    if path.exists():
        found, asked = checkpoint.read_config(options.out), policy.config()
        # An older version's run is taken for one of this task, these attempts and this camera; of options that other
        # policies have it said the defaults.
        known = asked["training"]
        unsaid = {name: known[name] for name in _LATELY if name in known}
        said = found.get("training", {}).items()
        found["training"] = unsaid | {name: value for name, value in said if name in known}
        found["camera_size"] = asked["camera_size"]
        if _chosen(found) != _chosen(asked):
            raise DataError(
                f"{options.out} holds a training with other options or data: give another --out, or delete it"
            )
    elif accelerator.is_main_process:
        checkpoint.write_files(options.out, {checkpoint.CONFIG: checkpoint.config_bytes(policy.config())})
    accelerator.wait_for_everyone()


def _chosen(config: Any) -> Any:
    """A config without what nobody chose: what is None here an older version may not have known."""
    if not isinstance(config, Mapping):
        return config
    return {name: _chosen(value) for name, value in config.items() if value is not None}


def plan_errors(policy: Policy, attempts: Sequence[Attempt], symmetry: int | None = None) -> dict[str, Any]:
    """Measure how far plans are off: summaries by quantity of `labels` and `truth`; how many were `without_plan`.

    `symmetry`: how often a turn what is moved looks the same, as each attempt says unless given; yaws are compared
    modulo that part of a turn. Of a thing that the maps before and after tell, a place is off by as much as its middle
    comes to lie off, wherever it is held.
    Attempts for which the policy could not tell have no error; where that is all of them, nor are there summaries.
    """
    errors: defaultdict[str, list[dict[str, float]]] = defaultdict(list)
    without_plan = 0
    for attempt in attempts:
        try:
            action = policy.plan(attempt.before, shown_goal(attempt)).action
        except BaggieError:
            without_plan += 1
            continue
        same = symmetry_of(attempt) if symmetry is None else symmetry
        thing, grid = carried_in(attempt), attempt.before.grid
        stands = None if thing is None or grid is None else thing.stood_at(action.pick, grid)
        for reference, right in references(attempt).items():
            errors[reference].append(action_errors(action, right, same, stands))
    summaries = {
        reference: {key: summary([row[key] for row in rows]) for key in rows[0]}
        for reference, rows in errors.items()
    }
    return {**summaries, "without_plan": without_plan}
