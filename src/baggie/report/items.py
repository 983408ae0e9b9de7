"""What a report is made of: the folders that train, validate and evaluate wrote, and plain values for its template."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from baggie.evaluation import block_episode, episode
from baggie.evaluation.validate import HEIGHT_MAPS
from baggie.geometry import FloatArray

Series = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Steps and values, `(N,)` each."""
BASELINES = ("color-mask", "oracle")
_GOALS = {"turned": "turned goals", "card": "card"}


@dataclass(frozen=True)
class Reported:
    """A folder of results."""

    folder: Path
    policy: str
    """Its name; with the run's where several runs of one policy are reported."""
    run: str
    metrics: dict[str, Any]


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
class Tried(Reported):
    """A folder that evaluate wrote, of any kind of task."""

    speed: ClassVar[float]
    """Of its videos, in times the real one."""

    def picture(self, number: int, kind: str) -> Path:
        """`before`, `after`, `heat` or `step-SS`; may be missing."""
        return self.folder / "episodes" / f"episode-{number:04d}-{kind}.jpg"

    def videos(self) -> list[Path]:
        """Those there are, in the order of the episodes."""
        return sorted((self.folder / "episodes").glob("episode-????.mp4"))

    def ending(self, number: int) -> str:
        """How an episode ended, in words; empty where it is not known."""
        raise NotImplementedError


@dataclass(frozen=True)
class Evaluation(Tried):
    """With bags."""

    speed: ClassVar[float] = episode.PLAY_FPS / episode.FILM_FPS
    episodes: list[episode.Episode]

    @property
    def workcell(self) -> str | None:
        """The file of the real one, whose camera is all that knows where bags are; None where it was simulated."""
        return self.metrics.get("workcell")

    @property
    def place(self) -> str:
        """Which workcell it was in."""
        return self.workcell or f"cell {self.metrics['cell']}"

    @property
    def conditions(self) -> str:
        """In what it differs from the plain closed loop: scenery, of a simulated cell, and how goals were given; empty
        for nothing.
        """
        scenery, goal = self.metrics.get("scenery", "plain"), self.metrics["goal"]
        return ", ".join(
            [*([scenery] if scenery != "plain" else []), *([_GOALS[goal]] if goal != "virtual" else [])]
        )

    def distances_cm(self) -> list[float]:
        """Of every episode, from bag to goal at the end."""
        return [each.distance_cm for each in self.episodes]

    def offsets_cm(self) -> FloatArray:
        """`(N, 2)`: from goal to bag at the end, x and y."""
        return np.array([100 * (np.array(e.final[:2]) - np.array(e.goal[:2])) for e in self.episodes])

    def ending(self, number: int) -> str:
        """How far from its goal the bag ended."""
        found = [f"ends {e.distance_cm:.1f} cm from the goal" for e in self.episodes if e.episode == number]
        return found[0] if found else ""


@dataclass(frozen=True)
class BlockEvaluation(Tried):
    """With blocks."""

    speed: ClassVar[float] = block_episode.PLAY_FPS / block_episode.FILM_FPS
    episodes: list[block_episode.BlockEpisode]

    @property
    def task(self) -> str:
        """What was to be done, by its name."""
        return str(self.metrics["task"])

    def credits(self) -> list[float]:
        """Partial credit of every episode, in [0, 1] but for rounding."""
        return [each.partial_credit for each in self.episodes]

    def ending(self, number: int) -> str:
        """Whether it was a success, else how much of the task was done."""
        found = [in_words(each) for each in self.episodes if each.episode == number]
        return found[0] if found else ""


def in_words(tried: block_episode.BlockEpisode) -> str:
    """How an episode with blocks ended."""
    if tried.success:
        return f"done in {len(tried.steps)} steps"
    trouble = tried.message or tried.failure
    return f"{100 * tried.partial_credit:.0f}% done in {len(tried.steps)} steps · {trouble}"


@dataclass(frozen=True)
class Results:
    """Everything found; trained policies first, then baselines, each list by policy."""

    trainings: list[Training]
    validations: list[Validation]
    evaluations: list[Evaluation]
    blocks: list[BlockEvaluation]

    def items(self) -> list[Training | Validation | Evaluation | BlockEvaluation]:
        """All of them."""
        return [*self.trainings, *self.validations, *self.evaluations, *self.blocks]

    @property
    def of_bags(self) -> bool:
        """Whether there is anything about bags."""
        cameras = [v for v in self.validations if v.metrics.get("pictures") != HEIGHT_MAPS]
        return bool(self.evaluations or cameras)

    def policies(self) -> list[str]:
        """Each policy once, baselines last."""
        names = dict.fromkeys(item.policy for item in self.items())
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
