"""The simulated arm with its two-finger hand, as a workcell has it."""

from __future__ import annotations

import numpy as np

from baggie.errors import BaggieError
from baggie.sim.arm_world import ArmWorld
from baggie.sim.fingers import MOVE_FORCE_N, Fingers
from baggie.sim.kinematics import CONTROL_PERIOD_S
from baggie.workcell.arm import ArmInfo
from baggie.workcell.arm_motions import ArmMotions

FINGER_SPEED_M_S = 0.05  # each; Franka's data sheet
SQUEEZE_S = 0.4
FINGER_SETTLE_S = 0.1


class SimulatedArm(ArmMotions):
    """The FR3 with its hand. Raises `BaggieError` for a world whose arm carries another tool."""

    def __init__(self, world: ArmWorld) -> None:
        super().__init__(world)
        self.info = ArmInfo("simulated FR3", max_width_m=0.08, max_speed_m_s=1.7, max_force_n=70.0)
        self._fingers = _fingers(world)

    def move_gripper(self, width_m: float) -> float:
        """Fingers to a width at their usual speed."""
        if abs(width_m - self._fingers.width) < 0.001:
            return self._fingers.width
        self._fingers.set_force(MOVE_FORCE_N)
        current = self._fingers.width / 2
        steps = max(round(abs(width_m / 2 - current) / FINGER_SPEED_M_S / CONTROL_PERIOD_S), 1)
        for opening in np.linspace(current, width_m / 2, steps + 1)[1:]:
            self._fingers.set_opening(opening)
            self._world.advance(CONTROL_PERIOD_S)
        self._world.advance(FINGER_SETTLE_S)
        return self._fingers.width

    def grasp(self, force_n: float) -> float:
        """Close, then squeeze with `force_n` a finger; cloth needs a moment to give way."""
        self._fingers.set_force(force_n)
        current = self._fingers.width / 2
        for opening in np.arange(current, 0.0, -FINGER_SPEED_M_S * CONTROL_PERIOD_S):
            self._fingers.set_opening(opening)
            self._world.advance(CONTROL_PERIOD_S)
        self._fingers.set_opening(0.0)
        self._world.advance(SQUEEZE_S)
        return self._fingers.width

    def gripper_width(self) -> float:
        """Metres between the fingers now."""
        return self._fingers.width

    def enter(self, world: ArmWorld) -> None:
        """Work in another world from now on, where the arm is at home."""
        self._fingers = _fingers(world)
        self._world = world
        self.reset()


def _fingers(world: ArmWorld) -> Fingers:
    if world.fingers is None:
        raise BaggieError("expected an arm with a two-finger hand, got one with another tool; use SuctionArm")
    return world.fingers
