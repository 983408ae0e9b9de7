"""Bags that lie somewhere, on each other or not, as a simulator would say it; and a hand that never errs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from baggie.geometry import PlanarPose
from baggie.sim.bag import Bag, pillow
from baggie.tasks.conditions import State
from baggie.types import PickPlace

ON_TABLE_M = 0.009
"""Of a bag's middle."""


def lying(at: Mapping[str, tuple[PlanarPose, float]]) -> State:
    """Bags by name, their middles at poses and heights, metres."""
    points, _ = pillow(Bag())
    return State(
        {name: pose.upright(height) for name, (pose, height) in at.items()},
        {name: pose for name, (pose, _) in at.items()},
        points={name: points + np.array([pose.x, pose.y, height]) for name, (pose, height) in at.items()},
    )


def loose(poses: Mapping[str, PlanarPose]) -> State:
    """Bags by name that lie on the table."""
    return lying({name: (pose, ON_TABLE_M) for name, pose in poses.items()})


def carried(action: PickPlace, state: State) -> State:
    """The nearest bag to the pick, the highest of them, lies at the place, on what the action says is there."""
    name = min(
        state.places,
        key=lambda each: (round(state.places[each].distance(action.pick), 3), -state.poses[each][2, 3]),
    )
    lies = state.places[name]
    # A bag's middle is half its thickness, 16 mm, below its top, and lies on others 22 mm above theirs.
    height = ON_TABLE_M if not action.place_on_m else action.place_on_m + 0.006
    yaw = lies.yaw + action.place.yaw - action.pick.yaw
    moved = {name: (replace(action.place, yaw=yaw), height)}
    others = {each: (pose, float(state.poses[each][2, 3])) for each, pose in state.places.items()}
    return lying(others | moved)
