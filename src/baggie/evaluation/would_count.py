"""Whether plans for the steps of a task would count, by all that was as right as what the demonstrator chose."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from baggie.data import Dataset
from baggie.evaluation.metrics import Rate, success_rate, turn_error_deg
from baggie.evaluation.predictions import Prediction
from baggie.seeds import COLLECTION, generator
from baggie.sim.tasks import TASKS, Stage
from baggie.sim.tasks.scoring import ANGLE_RAD, POSITION_M
from baggie.types import PickPlace


@dataclass(frozen=True)
class Choices:
    """What was as right as one recorded step."""

    actions: Sequence[PickPlace]
    """That step and those that the demonstrator did later in the same stage: the blocks still to be moved, and the
    slots still free.
    """
    symmetry: int
    """How often a turn the stage's blocks look the same; 0 for at any angle."""

    def pick_counts(self, planned: PickPlace) -> bool:
        """Whether it picks within 1 cm of one of the blocks."""
        return self._nearest(planned).pick.distance(planned.pick) < POSITION_M

    def place_counts(self, planned: PickPlace) -> bool:
        """Whether it places within 1 cm of one of the slots, turned within 15 degrees as the nearest block has to be.

        All slots of a stage are taken to lie the same way.
        """
        near = min(planned.place.distance(action.place) for action in self.actions) < POSITION_M
        turn = turn_error_deg(planned, self._nearest(planned), self.symmetry)
        return near and turn < math.degrees(ANGLE_RAD)

    def _nearest(self, planned: PickPlace) -> PickPlace:
        return min(self.actions, key=lambda action: action.pick.distance(planned.pick))


def would_count(dataset: Dataset, predictions: Sequence[Prediction]) -> dict[str, Rate]:
    """The share of `pick`, of `place` and of `both` that would count as Ravens counts; a missing plan does not.

    Empty where the recording does not tell: it is not of one of our tasks, or no step is of a whole demonstration.
    """
    known = choices(dataset)
    found = [(p.action, known[p.attempt_id]) for p in predictions if p.attempt_id in known]
    if not found:
        return {}
    picks = [action is not None and right.pick_counts(action) for action, right in found]
    places = [action is not None and right.place_counts(action) for action, right in found]
    both = [pick and place for pick, place in zip(picks, places, strict=True)]
    return {
        name: success_rate(sum(counts), len(found))
        for name, counts in (("pick", picks), ("place", places), ("both", both))
    }


def choices(dataset: Dataset) -> dict[int, Choices]:
    """By attempt id, of demonstrations that took one step for each block."""
    task = TASKS.get(dataset.collection.get("task", ""))
    if task is None:
        return {}
    found: dict[int, Choices] = {}
    numbers = dataset.numbers()
    for episode in np.unique(dataset.episodes):
        rows = np.flatnonzero(dataset.episodes == episode)
        rows = rows[np.argsort(numbers["step"][rows])]
        # The scene was drawn from this stream: it says again which stages it had.
        stages = task.draw(generator(COLLECTION, dataset.collection["seed"], int(episode))).stages
        if len(rows) == sum(len(stage.blocks) for stage in stages) and numbers["success"][rows].all():
            found |= _of_episode(stages, rows.tolist(), dataset.attempt_ids, numbers)
    return found


def _of_episode(
    stages: Sequence[Stage], rows: Sequence[int], attempt_ids: np.ndarray, numbers: Mapping[str, Any]
) -> dict[int, Choices]:
    found, begin = {}, 0
    for stage in stages:
        of_stage = rows[begin : begin + len(stage.blocks)]
        actions = [PickPlace.from_array(numbers["executed"][row]) for row in of_stage]
        for step, row in enumerate(of_stage):
            found[int(attempt_ids[row])] = Choices(actions[step:], stage.symmetry)
        begin += len(stage.blocks)
    return found
