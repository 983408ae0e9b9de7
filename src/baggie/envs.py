"""The Gymnasium environment of every task. One step is one whole pick and place."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from baggie.collect.machine import random_place
from baggie.errors import LimitError, ReachError
from baggie.geometry import Grid, PlanarPose, Rectangle
from baggie.tasks.conditions import Score, strict_success
from baggie.types import Goal, PickPlace
from baggie.workcell.workcell import Workcell

if TYPE_CHECKING:
    from baggie.tasks.task import Task
    from baggie.types import Image
    from baggie.workcell.simulated import SimulatedWorkcell

ObservationDict = dict[str, Any]


def action_space(area: Rectangle) -> gymnasium.Space[NDArray[np.float32]]:
    """`(6,)` float32: pick x, y, yaw, place x, y, yaw; metres and radians, robot base frame."""
    low = np.array([area.x_min, area.y_min, -np.pi] * 2, np.float32)
    high = np.array([area.x_max, area.y_max, np.pi] * 2, np.float32)
    return spaces.Box(low, high, dtype=np.float32)


def execute(workcell: Workcell, action: NDArray[np.float32]) -> dict[str, Any]:
    """Carry out an action `(6,)`: `outcome` where the arm moved, `refused` and why where it would not."""
    try:
        return {"outcome": workcell.execute(PickPlace.from_array(action))}
    except (LimitError, ReachError) as error:
        return {"refused": str(error)}


PICTURE_SIZE = (640, 360)
GOAL_MARGIN_M = 0.02
"""Between a goal and the workspace's edge."""


class TaskEnv(gymnasium.Env[ObservationDict, NDArray[np.float32]]):
    """A task of Baggie's. One step is one whole pick and place.

    Observation: `color` uint8 RGB. Of a task that a camera looks at, `(360, 640, 3)`, the overhead picture with the arm
    out of the way; of one that is seen from straight above, `(320, 160, 3)`, and `height` `(320, 160)` float32 metres
    (`baggie.geometry.Grid()` says which pixel shows which place). Where the goal is given in the picture, `goal`
    `(4, 2)` float32, corners of its outline in it, pixels (u, v).
    Action: `(6,)` float32: pick x, y, yaw, place x, y, yaw; metres and radians, robot base frame. One that the arm
    refuses (outside its limits or reach) moves nothing or puts back what it held; `info["refused"]` says why.
    Reward: with a goal, minus the distance from the object to it in metres; else what Ravens gives, 1 in all.
    Terminated when the object is within 2 cm, or all is done; truncated after the task's `max_steps`.
    `info`: `is_success`; with a goal `distance_m`; else `partial_credit`, the rewards' sum, and `strict_success`, the
    same as `is_success`, decided when the episode ends and False till then (everything as it has to be, and still so
    two seconds later); `outcome` where the arm moved.
    Options of `reset`: none. The same seed gives the same scene.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 2}  # noqa: RUF012 -- Gymnasium's own convention

    def __init__(self, task: str, cell: int = 0, render_mode: str | None = None) -> None:
        from baggie.workcell.simulated import open_simulated  # noqa: PLC0415 -- MuJoCo takes its time

        self.render_mode = render_mode
        self._workcell: SimulatedWorkcell = open_simulated(cell, task)
        self._task = self._workcell.task
        self.action_space = action_space(self._workcell.settings.workspace)
        self.observation_space = spaces.Dict(_observations(self._task))
        self._goal: PlanarPose | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[ObservationDict, dict[str, Any]]:
        """A new scene of the task, and, where it has a goal, one at least 20 cm from the object."""
        super().reset(seed=seed)
        cell = self._workcell
        cell.reset([int(value) for value in self.np_random.integers(2**31, size=2)])
        self._steps = 0
        if self._task.has_goal:
            self._goal = random_place(cell.settings.workspace, cell.truth(), self.np_random, GOAL_MARGIN_M)
            cell.give_goal(self._goal)
        self._score = Score(cell.scene.conditions)
        return self._observe(), self._info(ended=False)

    def step(self, action: NDArray[np.float32]) -> tuple[ObservationDict, float, bool, bool, dict[str, Any]]:
        """Execute one pick and place."""
        happened = execute(self._workcell, action)
        observation = self._observe()
        reward = self._score.count(self._workcell.state())
        self._steps += 1
        terminated = self._score.done
        truncated = not terminated and self._steps >= self._task.max_steps
        info = self._info(terminated or truncated)
        if self._goal is not None:
            reward = -info["distance_m"]
        return observation, reward, terminated, truncated, happened | info

    def render(self) -> Image | None:
        """What is observed, `(H, W, 3)`, with the goal painted in, in mode `rgb_array`."""
        if self.render_mode != "rgb_array":
            return None
        if self._goal is None:
            return self._color.copy()
        from baggie.vision.draw import paint_goal  # noqa: PLC0415

        return paint_goal(self._color, Goal(self._corners))

    def close(self) -> None:
        """Free the simulator."""
        self._workcell.close()

    def _observe(self) -> ObservationDict:
        seen = self._workcell.look()
        if self._task.view == "height-map":
            self._color = seen.color
            return {"color": self._color.copy(), "height": seen.height}
        width, height = PICTURE_SIZE
        self._color = seen.resized(width, height).color
        observed = {"color": self._color.copy()}
        if self._goal is not None:
            factors = width / seen.size[0], height / seen.size[1]
            self._corners = Goal(self._workcell.outline(self._goal)).scaled(*factors).corners
            observed["goal"] = self._corners.astype(np.float32)
        return observed

    def _info(self, ended: bool) -> dict[str, Any]:
        if self._goal is not None:
            distance = self._workcell.truth().distance(self._goal)
            return {"distance_m": distance, "is_success": self._score.done}
        success = ended and strict_success(self._workcell.scene.conditions, self._workcell)
        return {"partial_credit": self._score.total, "strict_success": success, "is_success": success}


def _observations(task: Task) -> dict[str, gymnasium.Space[Any]]:
    """The space of each part of an observation."""
    if task.view == "height-map":
        grid = Grid()
        return {
            "color": spaces.Box(0, 255, (*grid.shape, 3), np.uint8),
            "height": spaces.Box(0.0, grid.z[1] - grid.z[0], grid.shape, np.float32),
        }
    width, height = PICTURE_SIZE
    found: dict[str, gymnasium.Space[Any]] = {"color": spaces.Box(0, 255, (height, width, 3), np.uint8)}
    if task.has_goal:
        found["goal"] = spaces.Box(-float(width), 2.0 * width, (4, 2), np.float32)
    return found
