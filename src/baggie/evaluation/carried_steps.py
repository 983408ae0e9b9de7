"""What recorded steps carried, told by the height maps of their episodes."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial.distance import cdist

from baggie.data import Dataset
from baggie.evaluation.predictions import Prediction
from baggie.geometry import FloatArray, PlanarPose
from baggie.grid import Grid
from baggie.learning.demonstrations import carried_in
from baggie.learning.episodes import demonstration, with_after
from baggie.learning.symmetry import found_symmetries
from baggie.types import Attempt
from baggie.vision.carried import Carried, Mask


@dataclass(frozen=True, eq=False)
class CarriedStep:
    """A recorded step and what it carried."""

    attempt: Attempt
    """With a height map before it."""
    carried: Carried
    symmetry: int
    """How often a turn the thing looks the same; 0 for at any angle."""
    right: bool
    """Whether it did something for the task."""

    @property
    def grid(self) -> Grid:
        """Of the map before it."""
        assert self.attempt.before.grid is not None
        return self.attempt.before.grid

    @property
    def stands(self) -> PlanarPose:
        """Where the thing's middle was; the yaw of its frame is 0 there."""
        return pose_at(self.carried.middle, 0.0, self.grid)

    @cached_property
    def slot(self) -> PlanarPose:
        """Where the thing was put: by the poses the arm was really at, as a plan is judged by its own."""
        return self.attempt.outcome.executed.carry(self.stands)


def carried_steps(dataset: Dataset, attempt_ids: Collection[int]) -> list[list[CarriedStep]]:
    """By episode, all steps of which the maps tell what was carried, of the episodes to which these attempts belong.

    How often a turn things look the same is found in the maps where the recording does not say it. None at all where
    it has no height maps. Raises `DataError` where they are not all of one grid, or one is damaged.
    """
    if dataset.grid is None:
        return []
    told = [_told(episode) for episode in _episodes(dataset, attempt_ids)]
    known = [each for episode in told for each in episode]
    if not known:
        return []
    colors = np.stack([attempt.before.color for attempt, _, _ in known])
    found = iter(found_symmetries(colors, [thing for _, thing, _ in known]).tolist())
    return [
        [
            CarriedStep(attempt, thing, _said(attempt, symmetry), right)
            for (attempt, thing, right), symmetry in zip(episode, found, strict=False)
        ]
        for episode in told
    ]


def with_what_was_carried(dataset: Dataset, predictions: Sequence[Prediction]) -> list[Prediction]:
    """The same predictions, each with what the maps tell of the thing that the demonstrator carried.

    That is how often it looks the same and, where the plan picks it as well, where it stood. Raises what
    `carried_steps` raises.
    """
    episodes = carried_steps(dataset, [prediction.attempt_id for prediction in predictions])
    steps = {step.attempt.attempt_id: step for episode in episodes for step in episode}
    return [
        _known(each, steps[each.attempt_id]) if each.attempt_id in steps else each for each in predictions
    ]


def pixels_of(mask: Mask, grid: Grid) -> FloatArray:
    """`(N, 2)` metres: the middles of the pixels in a mask `(H, W)`."""
    return grid.to_robot(np.argwhere(mask)[:, ::-1])


def away_m(pixels: FloatArray, point: PlanarPose) -> float:
    """Metres from a point to the nearest of `(N, 2)` others, at least one."""
    return float(cdist(pixels, point.xy[None]).min())


def pose_at(pixel: FloatArray, yaw: float, grid: Grid) -> PlanarPose:
    """At a pixel (u, v) `(2,)`, in the robot's base frame."""
    x, y = grid.to_robot(pixel)[0]
    return PlanarPose(float(x), float(y), yaw)


def _episodes(dataset: Dataset, attempt_ids: Collection[int]) -> list[list[Attempt]]:
    """Those to which these attempts belong, step by step; an attempt of no episode is one by itself."""
    numbers, episodes = dataset.numbers(), dataset.episodes
    chosen = np.isin(dataset.attempt_ids, list(attempt_ids))
    rows = [[int(row)] for row in np.flatnonzero(chosen & (episodes < 0))]
    for episode in np.unique(episodes[chosen & (episodes >= 0)]):
        of_it = np.flatnonzero(episodes == episode)
        rows.append(of_it[np.argsort(numbers["step"][of_it])].tolist())
    return [[dataset[row] for row in of_it] for of_it in rows]


def _told(episode: Sequence[Attempt]) -> list[tuple[Attempt, Carried, bool]]:
    """The steps of which the maps tell what was carried, that, and whether each did something for the task."""
    right = {attempt.attempt_id for attempt in demonstration(episode)}
    carries = [(attempt, carried_in(attempt)) for attempt in with_after(episode)]
    return [(attempt, thing, attempt.attempt_id in right) for attempt, thing in carries if thing is not None]


def _said(attempt: Attempt, found: int) -> int:
    return found if attempt.object_symmetry is None else attempt.object_symmetry


def _known(prediction: Prediction, step: CarriedStep) -> Prediction:
    known = replace(prediction, symmetry=step.symmetry)
    if prediction.action is None:
        return known
    return replace(known, stands=step.carried.stood_at(prediction.action.pick, step.grid))
