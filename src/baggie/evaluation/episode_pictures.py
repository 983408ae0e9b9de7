"""The pictures an episode leaves: before with the plan in it, after with where the bag lies, heat maps."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from baggie.evaluation.bench import EvaluationCell
from baggie.evaluation.pictures import Mark, Region, heat_over, marked, save_jpeg
from baggie.geometry import FloatArray, PlanarPose
from baggie.types import Goal, Observation, Plan
from baggie.vision.draw import paint_goal


@dataclass(frozen=True)
class EpisodeScene:
    """Where the bag should end, was when the last plan was made, and did end, in the cell it was in."""

    cell: EvaluationCell
    goal: PlanarPose
    bag: PlanarPose
    final: PlanarPose

    def pixel(self, pose: PlanarPose) -> FloatArray:
        """`(2,)`: where the middle of a bag there appears."""
        return np.asarray(self.cell.goal_corners(pose).mean(axis=0))

    def region(self, size: tuple[int, int]) -> Region:
        """The part of the picture in which bags can lie."""
        area = self.cell.settings.workspace
        corners = [PlanarPose(x, y) for x in (area.x_min, area.x_max) for y in (area.y_min, area.y_max)]
        return Region.around(np.vstack([self.cell.goal_corners(corner) for corner in corners]), size)


def save_pictures(
    stem: Path,
    scene: EpisodeScene,
    *,
    before: tuple[Observation, Goal | None, Plan | None],
    after: Observation,
) -> None:
    """Write `STEM-before.jpg`, `STEM-after.jpg`, and `STEM-heat.jpg` where the plan has heat maps.

    `before` is the picture the last plan was made from, the goal in it, and the plan. After, the outline is that of a
    bag right on the goal, however the goal had been given.
    """
    seen, goal, plan = before
    region = scene.region(after.size)
    shown = seen.color if goal is None else paint_goal(seen.color, goal)
    if plan is not None:
        poses = zip(
            ("pick", "place"), (plan.action.pick, plan.action.place), (scene.bag, scene.goal), strict=True
        )
        marks = [Mark(name, scene.pixel(ours), scene.pixel(true)) for name, ours, true in poses]
        save_jpeg(stem.with_name(stem.name + "-before.jpg"), marked(shown, region, marks))
        if plan.views:
            save_jpeg(stem.with_name(stem.name + "-heat.jpg"), heat_over(seen.color, region, plan.views))
    else:
        save_jpeg(stem.with_name(stem.name + "-before.jpg"), region.cut(shown))
    end = Mark("end", scene.pixel(scene.final), scene.pixel(scene.goal))
    outlined = paint_goal(after.color, Goal(scene.cell.goal_corners(scene.goal), "outline"))
    save_jpeg(stem.with_name(stem.name + "-after.jpg"), marked(outlined, region, [end]))
