"""What is commanded a thousand times a second, and how fast it changes: positions, velocities, accelerations."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from baggie.geometry import FloatArray

Difference = Callable[[FloatArray, FloatArray], FloatArray]


class Trail:
    """The last command and its derivatives by finite differences: a client's plans go on from there."""

    def __init__(self, value: FloatArray, difference: Difference = np.subtract) -> None:
        """`difference(after, before)`: what leads from one value to another."""
        self._difference = difference
        self.rest(value)

    def rest(self, value: FloatArray) -> None:
        """Stand still here."""
        self.value = value
        self.velocity = np.zeros_like(self._difference(value, value))
        self.acceleration = self.velocity

    def take(self, value: FloatArray, seconds: float) -> None:
        """Go on to the next value, which comes `seconds` after the last."""
        velocity = self._difference(value, self.value) / seconds
        self.acceleration = (velocity - self.velocity) / seconds
        self.velocity, self.value = velocity, value


def pose_difference(after: FloatArray, before: FloatArray) -> FloatArray:
    """`(6,)`: the shift and the small turn, both along the base frame's axes, between two poses `(4, 4)`."""
    turn = after[:3, :3] @ before[:3, :3].T
    skew = (turn - turn.T) / 2
    return np.array([*(after[:3, 3] - before[:3, 3]), skew[2, 1], skew[0, 2], skew[1, 0]])
