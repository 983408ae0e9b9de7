"""How many plans for the steps of a task would count, by all that was as right as what the demonstrator chose.

A step carried something to somewhere, which the maps before and after it show (`baggie.vision.carried`). Steps that
have nothing to do with each other could have come in any order: before each of them all was right that any of them did.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Protocol

import cv2
import numpy as np
from scipy.spatial.distance import cdist

from baggie.data import Dataset
from baggie.evaluation.choices_of_scene import choices_of_scene
from baggie.evaluation.predictions import Prediction
from baggie.geometry import FloatArray, Grid, PlanarPose
from baggie.learning.demonstrations import carried_in
from baggie.learning.split import demonstration, with_after
from baggie.learning.symmetry import found_symmetries, turn_onto
from baggie.metrics import Rate, success_rate
from baggie.registry import TASKS
from baggie.tasks.conditions import counts
from baggie.types import Attempt, Observation, PickPlace
from baggie.vision.carried import CHANGED_M, ON_IT_PX, Carried, Mask, middle_of


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


_TOUCHES_PX = 3
"""What shares no square of so many pixels touches at most: things lie beside each other, maps show it to a pixel."""
_SAME = 0.5
"""Of a footprint, what is seen of the thing where it was put down that is picked there next."""


@dataclass(frozen=True)
class Fit:
    """A thing in place of the one that was put into a slot. Poses are those of their middles."""

    stands: PlanarPose
    """Where it is now. Its yaw is that of the other one's frame, had it to look as this one does."""
    slot: PlanarPose
    """Where the other one's frame was put."""
    symmetry: int
    """How often a turn both look the same; 0 for at any angle."""


@dataclass(frozen=True)
class SeenThing:
    """One that is still to be moved in this stage, as a map shows it."""

    seen: FloatArray
    """`(N, 2)` metres: the middles of the pixels that show it, at least one."""
    fits: Sequence[Fit]
    """One for each free slot of the stage that takes it."""


@dataclass(frozen=True)
class MapChoices:
    """What was as right as one recorded step."""

    things: Sequence[SeenThing]
    """At least one."""
    pixel_m: float
    """The size of the map's pixels."""

    def pick_counts(self, planned: PickPlace) -> bool:
        """Whether it picks one of the things where the map shows it."""
        return away_m(self._nearest(planned.pick).seen, planned.pick) <= ON_IT_PX * self.pixel_m

    def place_counts(self, planned: PickPlace) -> bool:
        """Whether the thing that is picked, or the nearest one, comes to lie within 1 cm and 15 degrees of a slot.

        Held where it is picked and turned as planned; turned, too, by what looks the same.
        """
        return any(
            counts(planned.carry(fit.stands).upright(0.0), fit.slot.upright(0.0), fit.symmetry)
            for fit in self._nearest(planned.pick).fits
        )

    def _nearest(self, pick: PlanarPose) -> SeenThing:
        return min(self.things, key=lambda thing: away_m(thing.seen, pick))


def choices_of_maps(dataset: Dataset, attempt_ids: Collection[int]) -> dict[int, MapChoices]:
    """By attempt id, of those of these steps that did something for the task and of which the maps tell what.

    What counts by this is a lower bound: slots that no demonstration used are unknown, and so is what a step moved of
    which the maps do not tell. Only where a task tells things of one outline and one stage apart by their colour, maps
    cannot, and what takes the other's slot counts.

    Empty where the recording has no height maps. Raises `DataError` where they are not all of one grid, or one is
    damaged.
    """
    found: dict[int, MapChoices] = {}
    for episode in carried_steps(dataset, attempt_ids):
        found |= choices_of_episode(episode)
    return {attempt_id: found[attempt_id] for attempt_id in attempt_ids if attempt_id in found}


def choices_of_episode(steps: Sequence[CarriedStep]) -> dict[int, MapChoices]:
    """By attempt id, of the steps of one episode that were right; those that were not say where things have been."""
    right = [number for number, step in enumerate(steps) if step.right]
    stages = dict(zip(right, stages_of([steps[number].carried for number in right]), strict=True))
    found = {}

    @cache  # the same of two things before every step of their stage
    def turn(number: int, other: int) -> float | None:
        if number == other:
            return 0.0
        thing, there = steps[number].carried, steps[other]
        return turn_onto(thing.stood, there.carried.stood, there.symmetry)

    for now in right:
        left = [later for later in right if later >= now and stages[later] == stages[now]]
        things = [_seen(steps, now, thing, left, turn) for thing in left]
        found[steps[now].attempt.attempt_id] = MapChoices(
            [thing for thing in things if len(thing.seen)], steps[now].grid.pixel_m
        )
    return found


def stages_of(things: Sequence[Carried]) -> list[int]:
    """The stage of each step of an episode, from 1: one more than the greatest of the steps it depends on.

    It depends on an earlier one where what the two things covered, before or after, does more than touch: it picks the
    same thing again, takes one that the other had covered, or puts one on the other or where that had been.
    """
    stages: list[int] = []
    for number, thing in enumerate(things):
        before = zip(stages, things[:number], strict=True)
        stages.append(1 + max((stage for stage, other in before if _meet(thing, other)), default=0))
    return stages


def _seen(
    steps: Sequence[CarriedStep],
    now: int,
    number: int,
    left: Sequence[int],
    turn_between: Callable[[int, int], float | None],
) -> SeenThing:
    """What the step `number` carries, as it is before the step `now`, and into which slots of those `left` it fits.

    `turn_between`: radians by which what one step carries has to be turned to lie as what another does; None where it
    is of another kind.
    """
    mask, mover = steps[number].carried.stood, number
    for earlier in reversed(range(now, number)):  # where it had been before a step that was not right
        put = steps[earlier]
        here = _alike(mask & put.carried.lies, put.attempt.after, steps[mover].attempt.before)
        if np.count_nonzero(here) > _SAME * np.count_nonzero(mask):
            mask, mover = put.carried.stood, earlier
    grid = steps[now].grid
    middle, fits = middle_of(mask), []
    for other in left:
        step, turn = steps[other], turn_between(mover, other)
        if turn is not None:
            fits.append(Fit(pose_at(middle, -turn, grid), step.slot, step.symmetry))
    # It is seen where the map is as high as when it was moved; where it is higher, something else covers it.
    visible = _alike(mask, steps[now].attempt.before, steps[mover].attempt.before)
    return SeenThing(pixels_of(visible, grid), fits)


def _alike(mask: Mask, seen: Observation | None, then: Observation) -> Mask:
    """Where in a mask `(H, W)` two maps are as high."""
    assert seen is not None
    assert seen.height is not None
    assert then.height is not None
    return np.asarray(mask & (np.abs(seen.height - then.height) <= CHANGED_M))


def _meet(thing: Carried, other: Carried) -> bool:
    """Whether what two things covered, before or after, does more than touch."""
    common = (thing.stood | thing.lies) & (other.stood | other.lies)
    return bool(cv2.erode(common.astype(np.uint8), np.ones((_TOUCHES_PX, _TOUCHES_PX))).any())


class Choices(Protocol):
    """What was as right as one recorded step."""

    def pick_counts(self, planned: PickPlace) -> bool:
        """Whether it picks one of the things that are still to be moved in this stage."""
        ...

    def place_counts(self, planned: PickPlace) -> bool:
        """Whether what is picked, or the nearest thing, comes to lie within 1 cm and 15 degrees of a free slot."""
        ...


def rates_that_count(dataset: Dataset, predictions: Sequence[Prediction]) -> dict[str, Rate]:
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
    name = dataset.collection.get("task", "")
    if name not in TASKS:
        return choices_of_maps(dataset, attempt_ids)
    return choices_of_scene(dataset, TASKS[name])
