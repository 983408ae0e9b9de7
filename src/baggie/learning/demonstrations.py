"""Demonstrations that `transporter` learns from, in memory: height maps, or one camera's pictures rectified to such."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from baggie.calibration.files import MAP_FILE
from baggie.calibration.image_to_robot.map import ImageToRobot
from baggie.calibration.image_to_robot.rectify import Leaning, Rectifier
from baggie.data.files import CALIBRATION_FOLDER
from baggie.data.summary import goal_of, shown_goal
from baggie.errors import DataError
from baggie.geometry import FloatArray, Grid, PlanarPose, rotation
from baggie.learning.augmentation import randomly_turned, unchanged, with_shape, without_object
from baggie.learning.samples import directions, mask_alone
from baggie.learning.symmetry import Origin, check_symmetries, found_symmetries
from baggie.policies.planning import GoalInput
from baggie.policies.transporter.policy import UNKNOWN, Scale
from baggie.types import Attempt, PickPlace
from baggie.vision.carried import Carried, place_of

_PIXEL_M = 0.003125
"""As in Ravens, and about what a picture of 640 pixels shows of a table 1.6 m wide."""
_MARGIN_M = 0.01
"""Beyond all boxes, turned as they may be: other goals lie a little further out."""


def from_camera(attempts: Sequence[Attempt]) -> bool:
    """Whether the pictures are a camera's own, rather than height maps."""
    return len(attempts) > 0 and attempts[0].before.grid is None


def rectifier_for(attempts: Sequence[Attempt], recording: Path) -> Rectifier:
    """To a grid over all that was picked and placed in pictures of one size, by the recording's own map.

    It knows layers where one of the attempts is above the table. Raises `DataError` where the recording has no map, and
    `CalibrationError` for layers where that knows one height only.
    """
    path = recording / CALIBRATION_FOLDER / MAP_FILE
    if not path.exists():
        raise DataError(
            f"expected the map from the picture to the robot in {path}, where `baggie collect` puts it, got no such "
            "file; take a recording with one, or train keypoint, which needs none"
        )
    size = attempts[0].before.size
    to_robot = ImageToRobot.load(path).squeezed(size)
    pixels = np.concatenate([[attempt.box_before, goal_of(attempt).corners] for attempt in attempts])
    boxes = to_robot.to_robot(pixels.reshape(-1, 2)).reshape(-1, 4, 2)
    middles = boxes.mean(axis=1)
    reach = float(np.nanmax(np.linalg.norm(boxes - middles[:, None], axis=2))) + _MARGIN_M
    stacked = any(attempt.pick_layer or attempt.place_layer for attempt in attempts)
    leaning = Leaning.of(to_robot) if stacked else None
    executed = (_as_seen(each.outcome.executed, each, leaning) for each in attempts)
    handled = [(action.pick.xy, action.place.xy) for action in executed]
    places = np.concatenate([middles[np.isfinite(middles).all(axis=1)], *handled])
    low = np.floor((places.min(axis=0) - reach) / _PIXEL_M)
    high = np.ceil((places.max(axis=0) + reach) / _PIXEL_M)
    (x_low, x_high), (y_low, y_high) = (np.c_[low, high] * _PIXEL_M).tolist()
    return Rectifier.of(to_robot, Grid((x_low, x_high), (y_low, y_high), pixel_m=_PIXEL_M), leaning)


def rectified(attempt: Attempt, rectifier: Rectifier) -> Attempt:
    """The attempt with the picture before, the boxes, and what was commanded as it appears from straight above."""
    return replace(
        attempt,
        before=rectifier.observation(attempt.before.color),
        box_before=rectifier.to_grid(attempt.box_before),
        box_after=rectifier.to_grid(attempt.box_after),
        commanded=_as_seen(attempt.commanded, attempt, rectifier.leaning),
    )


def _as_seen(action: PickPlace, attempt: Attempt, leaning: Leaning | None) -> PickPlace:
    """An attempt's action with pick and place where they appear from straight above, by its layers."""
    if leaning is None:
        return action
    pick = leaning.seen(action.pick, attempt.pick_layer or 0)
    return replace(action, pick=pick, place=leaning.seen(action.place, attempt.place_layer or 0))


def with_seen_symmetry(attempts: Sequence[Attempt]) -> list[Attempt]:
    """Rectified attempts; those that do not say how often a turn their object looks the same told by all their boxes.

    2 where most are long, else 4: a soft square that was squeezed looks long now and then.
    """
    _, long = directions(np.stack([attempt.box_before for attempt in attempts]))
    seen = 2 if long.mean() > 0.5 else 4
    return [
        replace(attempt, object_symmetry=seen) if attempt.object_symmetry is None else attempt
        for attempt in attempts
    ]


def with_turns(attempts: Sequence[Attempt], rng: np.random.Generator) -> list[Attempt]:
    """Rectified attempts, and each once more with its object and its goal turned on the spot.

    Objects that were always put down square to the table would teach a network to look at the table's grain, and goals
    that are always square to each other that nothing has to be turned.
    """
    return [*attempts, *(_turned(attempt, rng) for attempt in attempts)]


def _turned(attempt: Attempt, rng: np.random.Generator) -> Attempt:
    grid, before, action = attempt.before.grid, attempt.before, attempt.commanded
    assert grid is not None
    pick, place = action.pick, action.place
    mask = mask_alone(attempt, before.color, attempt.box_before)
    if mask is not None:
        about = grid.to_pixels(pick.xy)[0]
        shape = randomly_turned(rng, unchanged(pick.yaw), grid.pixel_m * np.eye(2))
        table = without_object(before.color, mask)
        color, _ = with_shape(before.color, table, mask, about, shape)
        before, pick = replace(before, color=color), replace(pick, yaw=shape.yaw)
    angle = rng.uniform(-math.pi / 4, math.pi / 4)
    about_goal = attempt.box_after.mean(axis=0)
    return replace(
        attempt,
        before=before,
        box_after=(attempt.box_after - about_goal) @ rotation(angle).T + about_goal,
        commanded=PickPlace(pick, PlanarPose(place.x, place.y, place.yaw + angle)),
    )


_NOT_TURNED_RAD = 1e-6
_HIGHER_M = 0.05
"""Above what was picked; an arm that hangs over the table is higher, and a thing on another is not."""
_LANDS_PX = 2.5
"""Well placed, however exactly it was shown: maps tell the middle of a thing to a pixel."""
_AS_EXACT_PX = 1.5
"""A footprint of a dozen pixels tells a middle to half a pixel; whoever picks this near to it knew it better."""
_MOST = 0.5
"""Of the demonstrations: where the maps tell of so many what was carried, they can tell it of all."""


@dataclass(frozen=True)
class Demonstrations:
    """N maps and what was done there. Raises `DataError` where they do not fit each other or the grid."""

    colors: NDArray[np.uint8]
    """`(N, H, W, 3)` RGB; where goals are marked, with the goal painted in."""
    heights: NDArray[np.float32]
    """`(N, H, W)` metres above the grid's lower bound of z."""
    poses: FloatArray
    """`(N, 6)`: commanded pick x, y, yaw and place x, y, yaw; metres and radians, robot base frame, as they appear from
    straight above."""
    symmetry: NDArray[np.int64]
    """`(N,)`: how often a turn what was picked looks the same; 0 for any angle."""
    grid: Grid
    cell: int = 0
    goal_input: GoalInput | None = None
    """How goals are painted into the colours; None for a task that marks none."""
    carried: Sequence[Carried | None] = ()
    """N, what each carried; None where the maps do not tell. None at all unless given."""
    symmetry_origin: Origin = "given"
    """Who said how often things look the same."""

    def __post_init__(self) -> None:
        count = len(self.poses)
        shapes = {
            "colors": (self.colors.shape, (count, *self.grid.shape, 3)),
            "heights": (self.heights.shape, (count, *self.grid.shape)),
            "poses": (self.poses.shape, (count, 6)),
            "symmetry": (self.symmetry.shape, (count,)),
        }
        if self.carried:
            shapes["carried"] = ((len(self.carried),), (count,))
        for name, (came, expected) in shapes.items():
            if came != expected or count == 0:
                raise DataError(f"expected {name} of shape {expected}, at least one, got {came}")
        if (self.symmetry < 0).any():
            raise DataError(
                f"expected symmetries of 0 (any angle), 1 (none), 2, ...; got {self.symmetry.min()}"
            )
        inside = self.grid.contains(self.poses[:, [0, 1, 3, 4]].reshape(-1, 2)).reshape(-1, 2).all(axis=1)
        if not inside.all() or not np.isfinite(self.poses).all():
            number = int(np.argmin(inside & np.isfinite(self.poses).all(axis=1)))
            x, y = self.grid.x, self.grid.y
            raise DataError(
                f"expected picks and places on the map, x {x[0]} to {x[1]} m and y {y[0]} to {y[1]} m, but "
                f"demonstration {number} goes from {self.poses[number, :2].round(4).tolist()} to "
                f"{self.poses[number, 3:5].round(4).tolist()}; leave it out, or fuse over a larger grid"
            )

    def only_carried(self, carried: Sequence[Carried | None]) -> Demonstrations:
        """Keep the demonstrations in which something was carried; where maps tell it of most, the rest went wrong.

        `carried`: N. All of them where the maps tell it of few.
        """
        known = np.array([each is not None for each in carried])
        keep = known if known.mean() > _MOST else np.ones_like(known)
        return replace(
            self,
            colors=self.colors[keep],
            heights=self.heights[keep],
            poses=self.poses[keep],
            symmetry=self.symmetry[keep],
            carried=[each for each, kept in zip(carried, keep, strict=True) if kept],
        )

    @property
    def scale(self) -> Scale:
        """How high things are picked, and how near to their places they land; `UNKNOWN` where the maps do not tell."""
        offs = [
            each.stray_px(places, pose[5] - pose[2])
            for each, places, pose in zip(self.carried, self.places, self.poses, strict=False)
            if each is not None
        ]
        if not offs:
            return UNKNOWN
        tops = [
            float(h[each.stood].max()) for h, each in zip(self.heights, self.carried, strict=True) if each
        ]
        return Scale(max(tops) + _HIGHER_M, max(_LANDS_PX, float(np.percentile(offs, 95)) + 1.0))

    def by_the_thing(self) -> Demonstrations:
        """Move the picks of a suction cup to where it holds each object best, and placed accordingly.

        Where somebody happened to pick says nothing, as a cup holds a thing anywhere where it is level; so what is
        taught is the thing. Fingers, and things with a hole, are picked as they were.
        """
        if self.turned_to_pick or not self.carried:
            return self
        poses = self.poses.copy()
        for number, carried in enumerate(self.carried):
            point = None if carried is None else carried.cup_point(self.heights[number])
            point = _better(point, self.places[number, 0])
            place = place_of(point, self.places[number], poses[number, 5] - poses[number, 2])
            rows, columns = self.grid.shape
            if ((place >= 0) & (place <= [columns - 1, rows - 1])).all():
                poses[number, [0, 1, 3, 4]] = self.grid.to_robot([point, place]).ravel()
        return replace(self, poses=poses)

    @property
    def common_symmetry(self) -> int:
        """How often a turn everything that was picked looks the same: the greatest common divisor; 0 divides by all."""
        return int(np.gcd.reduce(self.symmetry))

    @cached_property
    def places(self) -> FloatArray:
        """`(N, 2, 2)`: pick and place, (u, v) pixels."""
        return self.grid.to_pixels(self.poses[:, [0, 1, 3, 4]].reshape(-1, 2)).reshape(-1, 2, 2)

    @cached_property
    def middles(self) -> FloatArray:
        """`(N, 2)` (u, v) pixels: of what was picked; the pick itself where the maps do not tell, or not better."""
        if not self.carried:
            return self.places[:, 0]
        known = zip(self.carried, self.places[:, 0], strict=True)
        return np.stack([_better(None if each is None else each.middle, pick) for each, pick in known])

    @property
    def turned_to_pick(self) -> bool:
        """Whether the hand was turned to pick, as one with fingers has to be; a suction cup picks at yaw 0."""
        return bool((np.abs(self.poses[:, 2]) > _NOT_TURNED_RAD).any())


def _better(seen: FloatArray | None, pick: FloatArray) -> FloatArray:
    """A point of a thing `(2,)` as a map shows it, or the pick, where that is it as nearly as maps can tell."""
    return pick if seen is None or np.linalg.norm(seen - pick) <= _AS_EXACT_PX else seen


def read_demonstrations(
    dataset: Sequence[Attempt], symmetry: int | None = None, painted: GoalInput | None = None
) -> Demonstrations:
    """Attempts whose picture before is a height map, the commanded poses as labels.

    `symmetry`: of all that is picked; as each attempt says unless given, found in the maps where none does, 1 where
    those do not tell. `painted`: how goals are painted, green patches by default; the task marks one where all
    attempts' objects were found in the picture after, and none where none was. Raises `DataError` where a picture is a
    camera's own, grids differ, or only some attempts have a goal.
    """
    attempts = [dataset[i] for i in range(len(dataset))]
    if not attempts:
        raise DataError("expected at least one attempt to learn from, got none; collect some")
    grid, cell = attempts[0].before.grid, attempts[0].cell
    goals = [shown_goal(attempt) for attempt in attempts]
    without = [attempt.attempt_id for attempt, goal in zip(attempts, goals, strict=True) if goal is None]
    if 0 < len(without) < len(attempts):
        raise DataError(
            f"expected a goal in every attempt or in none, but {len(without)} of {len(attempts)} have none, attempt "
            f"{without[0]} first; leave them out"
        )
    goal_input = None if without else painted or GoalInput("painted")
    colors, heights = [], []
    for attempt, goal in zip(attempts, goals, strict=True):
        before = attempt.before
        if grid is None or before.grid is None or before.height is None:
            raise DataError(
                f"expected pictures from straight above with heights, got a camera's own in attempt "
                f"{attempt.attempt_id}; record height maps, or train another policy"
            )
        if before.grid != grid:
            raise DataError(
                f"expected all height maps over one grid, but attempt {attempt.attempt_id} has another "
                "than the first; fuse all over the same"
            )
        color = before.color
        if goal is not None and goal_input is not None:
            color = goal_input.network_input(color, goal).transpose(1, 2, 0)
        colors.append(color)
        heights.append(before.height)
    assert grid is not None
    poses = np.stack([attempt.commanded.to_array() for attempt in attempts])
    shown = Demonstrations(
        np.stack(colors),
        np.stack(heights).astype(np.float32),
        poses,
        np.array([_symmetry(attempt) if symmetry is None else symmetry for attempt in attempts], np.int64),
        grid,
        cell,
        goal_input,
    )
    carried = [carried_in(attempt) for attempt in attempts]
    if any(carried):
        shown = shown.only_carried(carried)
    said = [attempt.object_symmetry is not None for attempt in attempts]
    origin: Origin = "given" if symmetry is not None else "recorded" if any(said) else "unknown"
    if origin == "unknown" and shown.carried:
        found = found_symmetries(shown.colors, shown.carried)
        return replace(shown, symmetry=found, symmetry_origin="found")
    if shown.carried:
        check_symmetries(shown.symmetry, shown.colors, shown.carried, origin)
    return replace(shown, symmetry_origin=origin)


def carried_in(attempt: Attempt) -> Carried | None:
    """What an attempt carried from the height map before it to that after it; None where they do not tell.

    Nor do two of different grids.
    """
    before, after, action = attempt.before, attempt.after, attempt.commanded
    if before.grid is None or before.height is None or after is None or after.height is None:
        return None
    if after.grid != before.grid:
        return None
    places = before.grid.to_pixels([action.pick.xy, action.place.xy])
    return Carried.between(before.height, after.height, places, action.place.yaw - action.pick.yaw)


def _symmetry(attempt: Attempt) -> int:
    return 1 if attempt.object_symmetry is None else attempt.object_symmetry
