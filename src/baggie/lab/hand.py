"""The simulated hand, as Franka's own controller leads it: towards a width, at a speed, with a force."""

from __future__ import annotations

from baggie.sim.fingers import OPEN_M, Fingers

SLIP_M = 0.02
"""So far a finger gives way when a grasp slips."""
SLIP_S = 0.3


class LabHand:
    """Moves the fingers' command a little at every step of the world."""

    def __init__(self, fingers: Fingers) -> None:
        self._fingers = fingers
        self._slipping_s = 0.0
        self.reset()

    @property
    def width(self) -> float:
        """Metres between the fingers."""
        return self._fingers.width

    @property
    def moving(self) -> bool:
        """Whether the fingers' command is on its way."""
        return self._opening != self._goal or self._slipping_s > 0

    def reset(self) -> None:
        """Take note that the fingers are wide open."""
        self._opening = self._goal = OPEN_M
        self._speed = 0.0

    def aim(self, width_m: float, speed_m_s: float, force_n: float) -> None:
        """Go for a width from now on; each finger moves at `speed_m_s` and presses with at most `force_n`."""
        self._opening = self._fingers.width / 2
        self._goal = min(max(width_m / 2, 0.0), OPEN_M)
        self._speed = speed_m_s
        self._fingers.set_force(force_n)

    def slip(self) -> None:
        """Lose what is held: the fingers give way for a moment, and close again."""
        self._slipping_s = SLIP_S

    def step(self, seconds: float) -> None:
        """What to command for the next `seconds`."""
        way = self._speed * seconds
        self._opening += min(max(self._goal - self._opening, -way), way)
        self._slipping_s -= seconds
        self._fingers.set_opening(self._opening + (SLIP_M if self._slipping_s > 0 else 0.0))
