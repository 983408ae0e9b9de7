"""The tasks with blocks as Gymnasium environments."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from baggie.envs.step import ObservationDict, action_space, execute
from baggie.grid import Grid

if TYPE_CHECKING:
    from baggie.types import Image
    from baggie.workcell.block_workcell import BlockWorkcell


class BlockEnv(gymnasium.Env[ObservationDict, NDArray[np.float32]]):
    """A task with blocks, for a suction cup.

    Observation: `color` `(320, 160, 3)` uint8 RGB and `height` `(320, 160)` float32 metres, the table from straight
    above (`baggie.grid.Grid()` says which pixel shows which place).
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
        from baggie.workcell.block_workcell import open_block_workcell  # noqa: PLC0415 -- MuJoCo takes its time

        self.render_mode = render_mode
        self._workcell: BlockWorkcell = open_block_workcell(task, cell)
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
