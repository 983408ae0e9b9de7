"""Recordings of one camera as `transporter` learns from them: rectified through the map that the collector fitted."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from baggie.calibration.files import MAP_FILE
from baggie.calibration.image_to_robot.map import ImageToRobot
from baggie.calibration.image_to_robot.rectify import Rectifier
from baggie.data.annotation import goal_of
from baggie.data.appearance import object_mask, without_object
from baggie.data.layout import CALIBRATION_FOLDER
from baggie.data.shape import as_it_is, turned, with_shape
from baggie.errors import DataError
from baggie.geometry import PlanarPose, rotation
from baggie.grid import Grid
from baggie.learning.labels import directions
from baggie.types import Attempt, PickPlace

_PIXEL_M = 0.003125
"""As in Ravens, and about what a picture of 640 pixels shows of a table 1.6 m wide."""
_MARGIN_M = 0.01
"""Beyond all boxes, turned as they may be: other goals lie a little further out."""


def from_camera(attempts: Sequence[Attempt]) -> bool:
    """Whether the pictures are a camera's own, rather than height maps."""
    return len(attempts) > 0 and attempts[0].before.grid is None


def rectifier_for(attempts: Sequence[Attempt], recording: Path) -> Rectifier:
    """To a grid over all that was picked and placed in pictures of one size, by the recording's own map.

    Raises `DataError` where the recording has none.
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
    handled = [(action.pick.xy, action.place.xy) for action in (each.outcome.executed for each in attempts)]
    places = np.concatenate([middles[np.isfinite(middles).all(axis=1)], *handled])
    low = np.floor((places.min(axis=0) - reach) / _PIXEL_M)
    high = np.ceil((places.max(axis=0) + reach) / _PIXEL_M)
    (x_low, x_high), (y_low, y_high) = (np.c_[low, high] * _PIXEL_M).tolist()
    return Rectifier.of(to_robot, Grid((x_low, x_high), (y_low, y_high), pixel_m=_PIXEL_M))


def rectified(attempt: Attempt, rectifier: Rectifier) -> Attempt:
    """The attempt with the picture before, and the boxes, from straight above."""
    return replace(
        attempt,
        before=rectifier.observation(attempt.before.color),
        box_before=rectifier.to_grid(attempt.box_before),
        box_after=rectifier.to_grid(attempt.box_after),
    )


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
    if np.isfinite(attempt.box_before).all():
        about = grid.to_pixels(pick.xy)[0]
        shape = turned(rng, as_it_is(pick.yaw), grid.pixel_m * np.eye(2))
        mask = object_mask(before.color, attempt.box_before)
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
