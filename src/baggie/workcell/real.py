"""A workcell in the real world: a robot at an address, a camera on this computer, a clock on the wall."""

from __future__ import annotations

import time

from baggie.workcell.cameras.opening import OpenCamera
from baggie.workcell.franka import FrankaArm
from baggie.workcell.workcell import Workcell, WorkcellSettings


class RealWorkcell(Workcell):
    """Nobody puts things back here: `rescue` says that it cannot."""

    def __init__(self, arm: FrankaArm, camera: OpenCamera, settings: WorkcellSettings) -> None:
        super().__init__(arm, camera, settings)
        self._devices = (arm, camera)
        self._began = time.monotonic()

    def clock(self) -> float:
        """Seconds since it was opened."""
        return time.monotonic() - self._began

    def close(self) -> None:
        """Let go of arm and camera; the arm holds its position."""
        for device in self._devices:
            device.close()
