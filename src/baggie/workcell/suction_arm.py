"""The simulated arm with a suction cup, as a workcell has it."""

from __future__ import annotations

import numpy as np

from baggie.sim.block_world import PERIOD_S, BlockWorld
from baggie.sim.scene import TIMESTEP_S
from baggie.workcell.arm import ArmInfo
from baggie.workcell.arm_motions import ArmMotions
from baggie.workcell.primitives import Handling

SEALED_WIDTH_M = 0.01
"""The "width" of a cup that holds something; one that holds nothing has none."""
SEAL_S = 0.04  # for the vacuum to build up, and to break down
BRAKE_STEPS = 6  # of `feel_period_s`: within what the cup gives way

BLOCK_HANDLING = Handling(
    travel_z_m=0.18,  # a carried block passes over a pyramid of three
    approach_z_m=0.14,
    pick_z_m=0.0,
    touch_force_n=2.5,
    land_force_n=2.5,
    place_z_m=0.0,
    open_width_m=0.0,
    release_width_m=0.0,
    empty_width_m=SEALED_WIDTH_M / 2,
    feel_m_s=0.35,
    carry_m_s=1.0,
)
"""Of blocks of about 4 cm, stacked up to three high, by a suction cup."""


class SuctionArm(ArmMotions):
    """The FR3 with a suction cup: to grasp is to switch it on, to move the gripper is to switch it off."""

    period_s = PERIOD_S  # commands in longer steps would shake the hand, and heavy blocks off it
    feel_period_s = TIMESTEP_S  # a millimetre at feeling speed
    settled_rad = 0.0015

    def __init__(self, world: BlockWorld) -> None:
        super().__init__(world, "cup")
        self.info = ArmInfo(
            "simulated FR3, suction cup",
            max_width_m=0.0,
            max_speed_m_s=1.7,
            max_force_n=70.0,
            tool_symmetry=0,
        )
        self._suction = world.suction

    def _stop_at_contact(self) -> None:
        """Brake evenly while the sprung cup gives way; stopping dead would shake the arm."""
        velocity = self._velocity
        for share in np.linspace(1.0, 0.0, BRAKE_STEPS + 1)[1:]:
            self._command(self._target + self.feel_period_s * share * velocity, share * velocity)
            self._world.advance(self.feel_period_s)

    def move_gripper(self, width_m: float) -> float:
        """Let go, whatever the width."""
        if self._suction.sealed:
            self._suction.off()
            self._world.advance(SEAL_S)
        return self.gripper_width()

    def grasp(self, force_n: float) -> float:
        """Switch on; the vacuum is as it is, whatever the force."""
        self._suction.on()
        if self._suction.sealed:
            self._world.advance(SEAL_S)
        return self.gripper_width()

    def gripper_width(self) -> float:
        """`SEALED_WIDTH_M` while something is held, else 0."""
        return SEALED_WIDTH_M if self._suction.sealed else 0.0

    def enter(self, world: BlockWorld) -> None:
        """Work in another world from now on, where the arm is at home."""
        self._suction = world.suction
        self._world = world
        self.reset()
