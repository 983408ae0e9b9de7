"""Pictures of a validation: a recorded attempt with the plan and what was right marked in it, and its heat maps."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from baggie.calibration.files import CameraIdentity
from baggie.calibration.image_to_robot.map import ImageToRobot
from baggie.data import Dataset
from baggie.data.annotation import shown_goal
from baggie.errors import BaggieError
from baggie.evaluation.map_pictures import backdrop
from baggie.evaluation.pictures import Mark, Region, heat_over, marked, save_jpeg
from baggie.evaluation.predictions import Prediction
from baggie.geometry import FloatArray, PlanarPose
from baggie.grid import Grid
from baggie.policies import Policy
from baggie.types import Attempt
from baggie.vision.draw import paint_goal

_ROUGH_MM = 20.0
"""A map that is this far off still shows which way a plan is off."""


@dataclass(frozen=True)
class Scene:
    """What the pictures of a recording show, for drawing only."""

    region: Region
    """The part of the picture in which bags were seen."""
    to_robot: ImageToRobot | None
    """Fitted to where bags were seen when they were handled; None where those are too few to tell."""
    grid: Grid | None = None
    """Of pictures from straight above, which need no such map."""

    @classmethod
    def of(cls, dataset: Dataset) -> Scene:
        """From the numbers of all attempts that succeeded."""
        if dataset.grid is not None:
            return cls(Region(0, 0, *dataset.settings.picture_size), None, dataset.grid)
        numbers, size = dataset.successful().numbers(), dataset.settings.picture_size
        boxes = np.concatenate([numbers["box_before"], numbers["box_after"]])  # (2N, 4, 2)
        places = np.concatenate([numbers["executed"][:, 0:2], numbers["executed"][:, 3:5]])
        seen = np.isfinite(boxes).all(axis=(1, 2))
        region = Region.around(boxes.reshape(-1, 2), size)
        centers, on_table = boxes[seen].mean(axis=1), np.column_stack([places[seen], np.zeros(seen.sum())])
        camera = CameraIdentity("recorded", *size)
        try:
            return cls(region, ImageToRobot.fit(centers, on_table, camera, limit_mm=_ROUGH_MM))
        except BaggieError:
            return cls(region, None)

    def mark(self, name: str, box: FloatArray, planned: PlanarPose, right: PlanarPose) -> Mark:
        """A plan beside the middle of `box` `(4, 2)`, where the bag was seen when it was at `right`."""
        if self.grid is not None:
            return Mark(name, *self.grid.to_pixels([planned.xy, right.xy]))
        center = np.asarray(box.mean(axis=0))
        if self.to_robot is None:
            return Mark(name, center, center)
        # The map is rough, but the difference of two points close together is not.
        a, b = self.to_robot.to_pixels([planned.xy, right.xy])
        return Mark(name, center + a - b, center)


def save_pictures(
    out: Path, scene: Scene, attempt: Attempt, prediction: Prediction, policy: Policy
) -> dict[str, Any]:
    """The picture before with goal and marks, and the heat maps over it: their paths relative to `out`."""
    goal = shown_goal(attempt)
    picture = attempt.before.color if goal is None else paint_goal(attempt.before.color, goal)
    name = f"pictures/attempt-{attempt.attempt_id:06d}"
    record = {"attempt_id": attempt.attempt_id, "picture": f"{name}.jpg", "errors": prediction.errors()}
    if prediction.action is None:
        save_jpeg(out / f"{name}.jpg", scene.region.cut(picture))
        return record
    action, right = prediction.action, prediction.best_reference
    marks = [
        scene.mark("pick", attempt.box_before, action.pick, right.pick),
        scene.mark("place", attempt.box_after, action.place, right.place),
    ]
    save_jpeg(out / f"{name}.jpg", marked(picture, scene.region, marks))
    views = policy.plan(attempt.before, goal).views
    if views:
        save_jpeg(out / f"{name}-heat.jpg", heat_over(backdrop(attempt.before), scene.region, views))
        record["heat"] = f"{name}-heat.jpg"
    return record
