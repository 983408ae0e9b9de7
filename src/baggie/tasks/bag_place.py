"""A bean bag goes where somebody points: the task of the published system."""

from __future__ import annotations

import numpy as np

from baggie.sim.bag import Bag
from baggie.sim.variety import draw_variety, lay_bags
from baggie.tasks.task import Scene, Setting, Task

BAG = Bag()


def _draw(rng: np.random.Generator, setting: Setting) -> Scene:
    (usual,) = (thing for thing in setting.things if isinstance(thing, Bag))
    variety = draw_variety(setting.scenery, setting.cell, usual, setting.workspace, setting.seed)
    obstacles = [thing.pose for thing in variety.distractors if thing.standing]
    bags = (variety.bag,) if variety.second is None else (variety.bag, variety.second)
    laid = lay_bags(setting.workspace, obstacles, variety.second is not None, rng)
    poses = {bag.name: pose for bag, pose in zip(bags, laid, strict=False) if pose is not None}
    return Scene(bags, poses, variety=variety)


BAG_PLACE = Task(
    name="bag-place",
    instruction="put the bean bag on the goal",
    tool="hand",
    view="camera",
    things=(BAG,),
    draw_scene=_draw,
    max_steps=3,
    object_symmetry=BAG.symmetry,
    has_goal=True,
)
