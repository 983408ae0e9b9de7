"""Where bags are laid: clear of each other and of what stands on the table, with room left for a goal."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from baggie.errors import BaggieError
from baggie.geometry import PlanarPose, Rectangle
from baggie.seeds import first_fit

OBSTACLE_M = 0.16
"""Between the middles of a bag and of what stands there: an open hand is 10 cm to each side, a thing 4."""
BAGS_M = 0.18
"""Between the middles of two bags."""
_EDGE_M = 0.02
"""Between a bag's middle and the workspace's edge."""
_GOAL_M, _GOAL_EDGE_M = 0.20, 0.03
"""How far goals are from the bag and from the workspace's edge."""
_ROOM = 0.1
"""Of the places in the workspace, that a goal may have at least."""


def random_pose(workspace: Rectangle, rng: np.random.Generator) -> PlanarPose:
    """Anywhere in the workspace, at any angle."""
    x, y = workspace.sample(rng, margin=_EDGE_M)
    return PlanarPose(float(x), float(y), float(rng.uniform(-np.pi, np.pi)))


def lay_bags(
    workspace: Rectangle, obstacles: Sequence[PlanarPose], two: bool, rng: np.random.Generator
) -> tuple[PlanarPose, PlanarPose | None]:
    """Poses of a bag and, of `two`, of the second. The first try is taken where nothing is in the way.

    Raises `BaggieError` where there is no room.
    """

    def somewhere() -> tuple[PlanarPose, PlanarPose | None]:
        return random_pose(workspace, rng), random_pose(workspace, rng) if two else None

    def clear(laid: tuple[PlanarPose, PlanarPose | None]) -> bool:
        bag, second = laid
        if second is not None and bag.distance(second) < BAGS_M:
            return False
        bags = [bag] if second is None else [bag, second]
        if any(pose.distance(other) < OBSTACLE_M for pose in bags for other in obstacles):
            return False
        others = [*obstacles, *bags[1:]]
        return not others or _room(workspace, bag, others) >= _ROOM

    laid = first_fit(somewhere, clear)
    if laid is None:
        raise BaggieError(
            f"expected a workspace with room for a bag and its goal beside {len(obstacles)} things that stand there, "
            f"got {workspace}; make it larger"
        )
    return laid


def _room(workspace: Rectangle, bag: PlanarPose, others: Sequence[PlanarPose]) -> float:
    """The share of the workspace that is far enough from the bag and from all others for a goal."""
    x = np.linspace(workspace.x_min + _GOAL_EDGE_M, workspace.x_max - _GOAL_EDGE_M, 9)
    y = np.linspace(workspace.y_min + _GOAL_EDGE_M, workspace.y_max - _GOAL_EDGE_M, 17)
    places = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    free = np.hypot(*(places - bag.xy).T) >= _GOAL_M
    for other in others:
        free &= np.hypot(*(places - other.xy).T) >= OBSTACLE_M
    return float(free.mean())
