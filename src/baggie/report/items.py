"""What a report is made of: the folders that train, validate and evaluate wrote, and plain values for its template."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baggie.evaluation.episode import PLAY_FPS, ByConditions, ByDistance
from baggie.evaluation.log import Credit, Episode, Landing
from baggie.evaluation.terms import Terms
from baggie.evaluation.validate import HEIGHT_MAPS
from baggie.geometry import FloatArray

Series = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Steps and values, `(N,)` each."""
BASELINES = ("color-mask", "oracle")


@dataclass(frozen=True)
class Reported:
    """A folder of results."""

    folder: Path
    policy: str
    run: str
    metrics: dict[str, Any]
    label: str
    """What its row and its curves are called: the policy, and whatever tells it from others on the page."""


@dataclass(frozen=True)
class Training(Reported):
    """A folder that train wrote."""

    config: dict[str, Any]
    scalars: dict[str, Series]
    """By TensorBoard tag."""


@dataclass(frozen=True)
class Validation(Reported):
    """A folder that validate wrote."""

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
class Evaluation(Reported):
    """A folder that evaluate wrote."""

    terms: Terms
    episodes: list[Episode]

    def picture(self, number: int, kind: str) -> Path:
        """The picture `before`, `after`, `heat` or `step-SS` of an episode; may be missing."""
        return self.folder / "episodes" / f"episode-{number:04d}-{kind}.jpg"

    def videos(self) -> list[Path]:
        """The videos there are, in the order of the episodes."""
        return sorted((self.folder / "episodes").glob("episode-????.mp4"))

    @property
    def speed(self) -> float:
        """How many times faster than it was its videos show it."""
        return PLAY_FPS / (ByDistance if self.landings() else ByConditions).film_fps

    @property
    def radius_cm(self) -> float | None:
        """How near a goal in the picture counts as success; None for tasks that say themselves what counts."""
        return self.metrics.get("radius_cm")

    @property
    def test(self) -> tuple[str, str, float | None]:
        """What it was put to, wherever: the task, what is harder about it, and the radius."""
        return self.terms.task, self.terms.harder, self.radius_cm

    def landings(self) -> list[Landing]:
        """Where objects ended, of every episode with a goal in the picture."""
        return [each.landing for each in self.episodes if each.landing is not None]

    def credits(self) -> list[Credit]:
        """How much was done, of every episode of a task that itself says where things go."""
        return [each.credit for each in self.episodes if each.credit is not None]

    def distances_cm(self) -> list[float]:
        """From object to goal at the end, of every episode with a goal in the picture."""
        return [landing.distance_cm for landing in self.landings()]

    def offsets_cm(self) -> FloatArray:
        """`(N, 2)`: from goal to object at the end, x and y."""
        return np.array([100 * (np.array(e.final[:2]) - np.array(e.goal[:2])) for e in self.landings()])

    def ending(self, number: int) -> str:
        """How an episode ended, in words; empty where it is not known."""
        found = [in_words(episode) for episode in self.episodes if episode.episode == number]
        return found[0] if found else ""


def in_words(episode: Episode) -> str:
    """How an episode ended: how far from the goal, or how much of the task was done."""
    if episode.landing is not None:
        return f"ends {episode.landing.distance_cm:.1f} cm from the goal"
    steps = "1 step" if len(episode.steps) == 1 else f"{len(episode.steps)} steps"
    if episode.credit is None or episode.credit.success:
        return f"done in {steps}"
    trouble = episode.message or episode.failure
    return f"{100 * episode.credit.partial_credit:.0f}% done in {steps} · {trouble}"


@dataclass(frozen=True)
class Results:
    """Everything found; trained policies first, then baselines, each list by policy."""

    trainings: list[Training]
    validations: list[Validation]
    evaluations: list[Evaluation]

    def items(self) -> list[Training | Validation | Evaluation]:
        """All of them."""
        return [*self.trainings, *self.validations, *self.evaluations]

    @property
    def landed(self) -> list[Evaluation]:
        """Those that tell how far from their goals objects ended."""
        return [each for each in self.evaluations if each.landings()]

    @property
    def credited(self) -> list[Evaluation]:
        """Those that tell how much of a task was done."""
        return [each for each in self.evaluations if each.credits()]

    @property
    def with_goals(self) -> bool:
        """Whether there is anything about goals in pictures."""
        cameras = [v for v in self.validations if v.metrics.get("pictures") != HEIGHT_MAPS]
        return bool(self.landed or cameras)

    def labels(self) -> list[str]:
        """Each label once, baselines last."""
        names = dict.fromkeys(item.label for item in self.items())
        return sorted(names, key=lambda name: name.startswith(BASELINES))


Content = dict[str, Any]

_MIME = {".jpg": "image/jpeg", ".png": "image/png", ".mp4": "video/mp4"}


def figure(title: str, svg: str, note: str) -> Content:
    """A chart with its title and what to say below it."""
    return {"title": title, "svg": svg, "note": note}


def ms(milliseconds: float) -> str:
    """A decision's time in words."""
    return "below 1 ms" if milliseconds < 1 else f"{milliseconds:.0f} ms"


def duration(seconds: float) -> str:
    """A training's time in words."""
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.1f} minutes"


def data_uris(paths: Sequence[Path]) -> list[str]:
    """Of the files there are."""
    return [data_uri(path) for path in paths if path.exists()]


def data_uri(path: Path) -> str:
    """A picture or video as part of the page."""
    return embedded(path.read_bytes(), path.suffix)


def embedded(content: bytes, suffix: str) -> str:
    """The same from what a file with this suffix would hold."""
    return f"data:{_MIME[suffix]};base64,{base64.b64encode(content).decode()}"


def percent(rate: dict[str, Any]) -> str:
    """A `Rate` in words."""
    return f"{100 * rate['rate']:.0f}%"


def in_numbers(rate: dict[str, Any]) -> str:
    """A `Rate` as a count: `97 of 100`."""
    return f"{round(rate['rate'] * rate['n'])} of {rate['n']}"


def with_interval(rate: dict[str, Any]) -> str:
    """The same with its 95% interval: `97 of 100 (92 to 99%)`."""
    return f"{in_numbers(rate)} ({100 * rate['low']:.0f} to {100 * rate['high']:.0f}%)"
