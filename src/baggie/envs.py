"""Gymnasium environments: the bean bag, and the tasks with blocks. One step is one whole pick and place."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from baggie.collect.machine import random_place
from baggie.errors import LimitError, ReachError
from baggie.geometry import Grid, Rectangle
from baggie.registry import TASKS
from baggie.types import Goal, PickPlace
from baggie.workcell.workcell import Workcell

if TYPE_CHECKING:
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
SUCCESS_RADIUS_M = 0.02
GOAL_MARGIN_M = 0.02
"""Between a goal and the workspace's edge."""


def open_environment(task: str, **options: Any) -> GoalEnv | TaskEnv:
    """The environment of a task, with the options of its class. Raises `BaggieError` where there is no such task."""
    return (GoalEnv if TASKS[task].has_goal else TaskEnv)(task, **options)


class GoalEnv(gymnasium.Env[ObservationDict, NDArray[np.float32]]):
    """Move the bag onto the goal: a task whose goal is given in the camera's picture.

    Observation: `color` `(360, 640, 3)` uint8 RGB, the overhead picture with the arm out of the way; `goal` `(4, 2)`
    float32, corners of the goal's outline in it, pixels (u, v).
    Action: `(6,)` float32: pick x, y, yaw, place x, y, yaw; metres and radians, robot base frame.
    Reward: minus the distance from bag to goal in metres. Terminated within 2 cm. An action the arm refuses (outside
    its limits or reach) moves nothing; `info["refused"]` says why. `info`: `distance_m`; `is_success`, whether that is
    within 2 cm; `outcome` where it moved. Truncated after the task's `max_steps`.
    Options of `reset`: none. The same seed gives the same scene.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 2}  # noqa: RUF012 -- Gymnasium's own convention

    def __init__(self, task: str, cell: int = 0, render_mode: str | None = None) -> None:
        from baggie.workcell.simulated import open_simulated  # noqa: PLC0415 -- MuJoCo takes its time

        self.render_mode = render_mode
        self._workcell: SimulatedWorkcell = open_simulated(cell, task)
        width, height = PICTURE_SIZE
        self.action_space = action_space(self._workcell.settings.workspace)
        self.observation_space = spaces.Dict(
            {
                "color": spaces.Box(0, 255, (height, width, 3), np.uint8),
                "goal": spaces.Box(-float(width), 2.0 * width, (4, 2), np.float32),
            }
        )

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[ObservationDict, dict[str, Any]]:
        """A new scene and a goal at least 20 cm from the bag."""
        super().reset(seed=seed)
        self._workcell.reset([int(value) for value in self.np_random.integers(2**31, size=2)])
        self._steps = 0
        bag = self._workcell.truth()
        self._goal = random_place(self._workcell.settings.workspace, bag, self.np_random, GOAL_MARGIN_M)
        return self._observe(), self._info()

    def step(self, action: NDArray[np.float32]) -> tuple[ObservationDict, float, bool, bool, dict[str, Any]]:
        """Execute one pick and place."""
        happened = execute(self._workcell, action)
        observation = self._observe()
        info = happened | self._info()
        self._steps += 1
        truncated = self._steps >= self._workcell.task.max_steps
        return observation, -info["distance_m"], info["is_success"], truncated, info

    def render(self) -> Image | None:
        """The overhead picture with the goal painted in, `(360, 640, 3)`, in mode `rgb_array`."""
        if self.render_mode != "rgb_array":
            return None
        from baggie.vision.draw import paint_goal  # noqa: PLC0415

        return paint_goal(self._color, Goal(self._corners))

    def close(self) -> None:
        """Free the simulator."""
        self._workcell.close()

    def _observe(self) -> ObservationDict:
        observation = self._workcell.look()
        width, height = PICTURE_SIZE
        factors = width / observation.size[0], height / observation.size[1]
        self._corners = Goal(self._workcell.goal_corners(self._goal)).scaled(*factors).corners
        self._color = observation.resized(width, height).color
        return {"color": self._color.copy(), "goal": self._corners.astype(np.float32)}

    def _info(self) -> dict[str, Any]:
        distance = self._workcell.truth().distance(self._goal)
        return {"distance_m": distance, "is_success": distance <= SUCCESS_RADIUS_M}


class TaskEnv(gymnasium.Env[ObservationDict, NDArray[np.float32]]):
    """A task that itself says where things go, seen from straight above.

    Observation: `color` `(320, 160, 3)` uint8 RGB and `height` `(320, 160)` float32 metres, the table from straight
    above (`baggie.geometry.Grid()` says which pixel shows which place).
    Action: `(6,)` float32: pick x, y, yaw, place x, y, yaw; metres and radians, robot base frame.
    Reward: what Ravens gives, 1 in all. Terminated when that is complete, truncated after the task's `max_steps`.
    An action the arm refuses (outside its limits or reach) moves nothing or puts back what it held; `info["refused"]`
    says why. `info`: `partial_credit`, the rewards' sum; `strict_success`, decided when the episode ends and False till
    then (every block upright in a slot of its own, and still so two seconds later); `is_success`, the same by the name
    that others read; `outcome` where it moved.
    Options of `reset`: none. The same seed gives the same scene.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 2}  # noqa: RUF012 -- Gymnasium's own convention

    def __init__(self, task: str, cell: int = 0, render_mode: str | None = None) -> None:
        from baggie.workcell.simulated import open_simulated  # noqa: PLC0415 -- MuJoCo takes its time

        self.render_mode = render_mode
        self._workcell: SimulatedWorkcell = open_simulated(cell, task)
        grid = Grid()
        self.action_space = action_space(self._workcell.settings.workspace)
        self.observation_space = spaces.Dict(
            {
                "color": spaces.Box(0, 255, (*grid.shape, 3), np.uint8),
                "height": spaces.Box(0.0, grid.z[1] - grid.z[0], grid.shape, np.float32),
            }
        )

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[ObservationDict, dict[str, Any]]:
        """A new scene of the task."""
        super().reset(seed=seed)
        self._workcell.reset([int(value) for value in self.np_random.integers(2**31, size=2)])
        self._steps = 0
        return self._observe(), self._info(ended=False)

    def step(self, action: NDArray[np.float32]) -> tuple[ObservationDict, float, bool, bool, dict[str, Any]]:
        """Execute one pick and place."""
        happened = execute(self._workcell, action)
        observation = self._observe()
        reward = self._workcell.count()
        self._steps += 1
        terminated = self._workcell.score.done
        truncated = not terminated and self._steps >= self._workcell.task.max_steps
        return observation, reward, terminated, truncated, happened | self._info(terminated or truncated)

    def render(self) -> Image | None:
        """The table from straight above, `(320, 160, 3)`, in mode `rgb_array`."""
        return self._color.copy() if self.render_mode == "rgb_array" else None

    def close(self) -> None:
        """Free the simulator."""
        self._workcell.close()

    def _observe(self) -> ObservationDict:
        observation = self._workcell.look()
        self._color = observation.color
        return {"color": self._color.copy(), "height": observation.height}

    def _info(self, ended: bool) -> dict[str, Any]:
        success = ended and self._workcell.strict_success()
        credit = self._workcell.score.total
        return {"partial_credit": credit, "strict_success": success, "is_success": success}
