"""A policy as an agent of the Ravens benchmark: its observations in, its actions out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from baggie.errors import BaggieError
from baggie.geometry import FloatArray, Grid, PlanarPose, wrap_angle
from baggie.policies.memory import Planner, remembering
from baggie.ravens.episode import RAVENS_CAMERAS, RavensPose, fused, planar_to_pose
from baggie.types import Observation

RavensActionArrays = dict[str, tuple[FloatArray, FloatArray]]
"""`pose0` (the pick) and `pose1` (the place), each `(3,)` xyz in metres and `(4,)` quaternion x, y, z, w."""


class RavensAgent:
    """What Ravens' environment and its test script call an agent.

    agent = RavensAgent(Policy.from_pretrained("runs/pyramid"))
    observation, reward, done, info = env.step(agent.act(observation, info))

    It remembers what it did in an episode (`baggie.policies.memory`); `begin` begins the next one.
    """

    def __init__(self, policy: Planner, grid: Grid | None = None) -> None:
        """`grid`: of the pictures that the policy has learned from; Ravens' own unless given."""
        self._memory = remembering(policy)
        self._grid = grid or Grid()

    def begin(self) -> None:
        """Forget the episode before; a scene that is another one is noticed without."""
        self._memory.begin()

    def act(self, obs: Mapping[str, Sequence[Any]], info: Any = None, goal: Any = None) -> RavensActionArrays:
        """The next action.

        `obs` is Ravens' own: `color`, 3 x `(480, 640, 3)` uint8 RGB, and `depth`, 3 x `(480, 640)` metres along the
        optical axis. The policy sees them fused, nothing else; `info` and `goal` are there because Ravens hands them
        over, and are not looked at. As in Ravens, the cup is not turned for the pick, the place is turned by as much as
        the object is to turn, and heights are those of the map at pick and place.

        Raises `BaggieError` where the policy cannot tell, plans a pose outside the map, or `obs` is another robot's.
        """
        seen = fused(*_views(obs), self._grid)
        action = self._memory.plan(seen).action
        pick, place = action.pick, action.place
        turned = wrap_angle(place.yaw - pick.yaw)
        poses = {"pose0": PlanarPose(pick.x, pick.y), "pose1": PlanarPose(place.x, place.y, turned)}
        return {name: _arrays(planar_to_pose(pose, _z_at(seen, pose))) for name, pose in poses.items()}


def _views(obs: Mapping[str, Sequence[Any]]) -> tuple[list[Any], list[Any]]:
    """Colours and depths by camera, as arrays, or one line that says what is wrong."""
    color = [np.asarray(picture) for picture in obs.get("color", ())]
    depth = [np.asarray(picture, np.float32) for picture in obs.get("depth", ())]
    size = RAVENS_CAMERAS[0][0].height, RAVENS_CAMERAS[0][0].width
    got = [picture.shape for picture in (*color, *depth)], {picture.dtype.name for picture in color}
    if got != ([(*size, 3)] * len(RAVENS_CAMERAS) + [size] * len(RAVENS_CAMERAS), {"uint8"}):
        raise BaggieError(
            f"expected the observation of Ravens' three cameras, color {(*size, 3)} uint8 and depth {size} each, got "
            f"{got[0]} of {', '.join(sorted(got[1])) or 'nothing'}; take Ravens' own environment and cameras"
        )
    return color, depth


def _z_at(seen: Observation, pose: PlanarPose) -> float:
    """Height of what the map shows at a pose, in the robot's base frame, metres."""
    assert seen.grid is not None
    assert seen.height is not None
    grid = seen.grid
    if not grid.contains(pose.xy)[0]:
        raise BaggieError(
            f"expected a plan inside the map, x {grid.x[0]} to {grid.x[1]} m and y {grid.y[0]} to {grid.y[1]} m, got "
            f"x {pose.x:.3f}, y {pose.y:.3f}; take a policy that was trained over this grid"
        )
    u, v = np.floor(grid.to_pixels(pose.xy)[0] + 0.5).astype(int)
    return float(seen.height[v, u]) + grid.z[0]


def _arrays(pose: RavensPose) -> tuple[FloatArray, FloatArray]:
    return np.array(pose.xyz), np.array(pose.xyzw)
