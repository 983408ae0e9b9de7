"""What a report is made of: the folders that train, validate and evaluate wrote, read back."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import yaml
from numpy.typing import NDArray
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from baggie.errors import BaggieError, DataError
from baggie.evaluation.bag_place import BAGS
from baggie.evaluation.episode import Episode
from baggie.evaluation.log import read_log
from baggie.geometry import FloatArray

Series = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Steps and values, `(N,)` each."""
BASELINES = ("color-mask", "oracle")
_GOALS = {"turned": "turned goals", "card": "card"}


@dataclass(frozen=True)
class Training:
    """A folder that train wrote."""

    folder: Path
    policy: str
    """Its name; with the run's where several runs of one policy are reported."""
    run: str
    config: dict[str, Any]
    metrics: dict[str, Any]
    scalars: dict[str, Series]
    """By TensorBoard tag."""


@dataclass(frozen=True)
class Validation:
    """A folder that validate wrote."""

    folder: Path
    policy: str
    """Its name; with the run's where several runs of one policy are reported."""
    run: str
    metrics: dict[str, Any]
    predictions: list[dict[str, Any]]
    worst: list[dict[str, Any]]

    @property
    def reference(self) -> str:
        """The best one there is: `truth`, else `labels`."""
        return "truth" if "truth" in self.metrics else "labels"

    def errors_cm(self, quantity: str) -> list[float]:
        """Of every attempt with a plan; `quantity` is `pick` or `place`."""
        found = [prediction["errors"] for prediction in self.predictions if prediction["errors"]]
        return [errors[self.reference][f"{quantity}_error_cm"] for errors in found]

    def positions(self, quantity: str) -> tuple[FloatArray, FloatArray]:
        """True and predicted positions, `(N, 2)` metres each."""
        poses = [p["poses"] for p in self.predictions if p["errors"]]
        true, predicted = (
            np.array([pose[name][quantity][:2] for pose in poses]) for name in (self.reference, "predicted")
        )
        return true, predicted


@dataclass(frozen=True)
class Evaluation:
    """A folder that evaluate wrote."""

    folder: Path
    policy: str
    """Its name; with the run's where several runs of one policy are reported."""
    run: str
    metrics: dict[str, Any]
    episodes: list[Episode]

    @property
    def conditions(self) -> str:
        """In what it differs from the plain closed loop: scenery and how goals were given; empty for nothing."""
        scenery, goal = self.metrics["scenery"], self.metrics["goal"]
        return ", ".join(
            [*([scenery] if scenery != "plain" else []), *([_GOALS[goal]] if goal != "virtual" else [])]
        )

    def distances_cm(self) -> list[float]:
        """Of every episode, from bag to goal at the end."""
        return [episode.distance_cm for episode in self.episodes]

    def offsets_cm(self) -> FloatArray:
        """`(N, 2)`: from goal to bag at the end, x and y."""
        return np.array([100 * (np.array(e.final[:2]) - np.array(e.goal[:2])) for e in self.episodes])

    def picture(self, episode: Episode, kind: str) -> Path:
        """`before`, `after` or `heat`; may be missing."""
        return self.folder / "episodes" / f"episode-{episode.episode:04d}-{kind}.jpg"

    def videos(self) -> list[Path]:
        """Those there are, in the order of the episodes."""
        return sorted((self.folder / "episodes").glob("episode-????.mp4"))


@dataclass(frozen=True)
class Results:
    """Everything found; trained policies first, then baselines, each list by policy."""

    trainings: list[Training]
    validations: list[Validation]
    evaluations: list[Evaluation]

    def items(self) -> list[Training | Validation | Evaluation]:
        """All of them."""
        return [*self.trainings, *self.validations, *self.evaluations]

    def policies(self) -> list[str]:
        """Each policy once, baselines last."""
        names = dict.fromkeys(item.policy for item in self.items())
        return sorted(names, key=lambda name: name.startswith(BASELINES))


Found = TypeVar("Found", Training, Validation, Evaluation)


def gather(folders: Sequence[Path]) -> Results:
    """Read the results in these folders and below them.

    Raises `BaggieError` when a folder is missing or holds none, or when two runs go by one name; `DataError` when a
    file of theirs is broken.
    """
    for folder in folders:
        if not folder.is_dir():
            raise BaggieError(
                f"expected a folder of results, {folder} is none; run train, validate or evaluate first"
            )
    trainings = _read(folders, "config.yaml", _training)
    validations = _read(folders, "predictions.json", _validation)
    evaluations = _read(folders, BAGS.log, _evaluation)
    _check_told_apart(trainings)
    _check_told_apart(validations)
    runs = {(item.policy, item.run) for item in Results(trainings, validations, evaluations).items()}
    if not runs:
        names = ", ".join(map(str, folders))
        raise BaggieError(
            f"found nothing to report in {names}; expected folders that train, validate or evaluate wrote"
        )
    several = {policy for policy, count in Counter(policy for policy, _ in runs).items() if count > 1}

    def named(items: Sequence[Found]) -> list[Found]:
        return [replace(i, policy=f"{i.policy} ({i.run})") if i.policy in several else i for i in items]

    def told_apart(items: Sequence[Evaluation]) -> list[Evaluation]:
        """Each under its conditions: a policy is as many rows as there are tests it was put to."""
        return [replace(i, policy=f"{i.policy}, {i.conditions}") if i.conditions else i for i in items]

    return Results(named(trainings), named(validations), told_apart(named(evaluations)))


def _check_told_apart(items: Sequence[Training | Validation]) -> None:
    """What was trained and what was tested are put together by policy and run: each may be there once."""
    seen: dict[tuple[str, str], Path] = {}
    for item in items:
        other = seen.setdefault((item.policy, item.run), item.folder)
        if other != item.folder:
            raise BaggieError(
                f"expected every run of {item.policy} to have a name of its own, {other} and {item.folder} are both of "
                f"a run called {item.run}; report one of them, or rename its folder before it is tested"
            )


def _read(folders: Sequence[Path], marker: str, read: Callable[[Path], Found | None]) -> list[Found]:
    places = sorted({path.parent for folder in folders for path in folder.resolve().rglob(marker)})
    found = []
    for place in places:
        try:
            item = read(place)
        except (OSError, ValueError, KeyError, TypeError, yaml.YAMLError) as error:
            raise DataError(f"cannot read the results in {place}: {error!r}; make them again") from error
        if item is not None:
            found.append(item)
    return sorted(found, key=lambda item: (item.policy in BASELINES, item.policy, item.run))


def _training(folder: Path) -> Training | None:
    if not (folder / "metrics.json").exists():
        return None  # unfinished, or somebody else's config.yaml
    config = yaml.safe_load((folder / "config.yaml").read_text())
    events = EventAccumulator(str(folder), size_guidance={"scalars": 0}).Reload()
    scalars = {}
    for tag in events.Tags()["scalars"]:
        points = events.Scalars(tag)
        scalars[tag] = (np.array([p.step for p in points], float), np.array([p.value for p in points], float))
    return Training(
        folder, str(config["policy"]), folder.name, config, _json(folder / "metrics.json"), scalars
    )


def _validation(folder: Path) -> Validation:
    content, metrics = _json(folder / "predictions.json"), _json(folder / "metrics.json")
    return Validation(
        folder, metrics["policy"], metrics["run"], metrics, content["predictions"], content["worst"]
    )


def _evaluation(folder: Path) -> Evaluation | None:
    if not (folder / "metrics.json").exists():
        return None  # still running
    metrics = _json(folder / "metrics.json")
    episodes = read_log(folder / BAGS.log, Episode)
    chosen = sorted((e for e in episodes if e.episode < metrics["success"]["n"]), key=lambda e: e.episode)
    return Evaluation(folder, metrics["policy"], metrics["run"], metrics, chosen)


def _json(path: Path) -> Any:
    return json.loads(path.read_text())
