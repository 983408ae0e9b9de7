"""Whether plans for the steps of a task would count, by all that was as right as what the demonstrator chose."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Protocol

from baggie.data import Dataset
from baggie.evaluation.choices_of_maps import choices_of_maps
from baggie.evaluation.choices_of_scene import choices_of_scene
from baggie.evaluation.metrics import Rate, success_rate
from baggie.evaluation.predictions import Prediction
from baggie.sim.tasks import TASKS
from baggie.types import PickPlace


class Choices(Protocol):
    """What was as right as one recorded step."""

    def pick_counts(self, planned: PickPlace) -> bool:
        """Whether it picks one of the things that are still to be moved in this stage."""
        ...

    def place_counts(self, planned: PickPlace) -> bool:
        """Whether what is picked, or the nearest thing, comes to lie within 1 cm and 15 degrees of a free slot."""
        ...


def would_count(dataset: Dataset, predictions: Sequence[Prediction]) -> dict[str, Rate]:
    """The share of `pick`, of `place` and of `both` that would count as Ravens counts; a missing plan does not.

    Of a task of the simulator by its scene, of any other by its height maps, where it is a lower bound
    (`choices_of_maps`). Steps of which neither tells are left out; empty where that is all of them.
    """
    known = choices(dataset, [prediction.attempt_id for prediction in predictions])
    found = [(p.action, known[p.attempt_id]) for p in predictions if p.attempt_id in known]
    if not found:
        return {}
    picks = [action is not None and right.pick_counts(action) for action, right in found]
    places = [action is not None and right.place_counts(action) for action, right in found]
    both = [pick and place for pick, place in zip(picks, places, strict=True)]
    return {
        name: success_rate(sum(counted), len(found))
        for name, counted in (("pick", picks), ("place", places), ("both", both))
    }


def choices(dataset: Dataset, attempt_ids: Collection[int]) -> Mapping[int, Choices]:
    """By attempt id, of those of these steps of which the recording tells."""
    task = TASKS.get(dataset.collection.get("task", ""))
    if task is None:
        return choices_of_maps(dataset, attempt_ids)
    return choices_of_scene(dataset, task)
