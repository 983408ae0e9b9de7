"""A workcell in the real world: a robot at an address, a camera on this computer, a clock on the wall."""

from __future__ import annotations

import time
from collections.abc import Sequence

from baggie.errors import BaggieError
from baggie.workcell.cameras.opening import OpenCamera
from baggie.workcell.franka import FrankaArm
from baggie.workcell.workcell import Workcell, WorkcellSettings


class RealWorkcell(Workcell):
    """Nobody puts things back here: `rescue` says that it cannot."""

    repeatable = False

    def __init__(self, arm: FrankaArm, camera: OpenCamera, settings: WorkcellSettings) -> None:
        super().__init__(arm, camera, settings)
        self._devices = (arm, camera)
        self._began = time.monotonic()

    def reset(self, seed: Sequence[int]) -> None:
        """Nobody lays the table anew: the arm parks, and the scene stays as it is, whatever the seed."""
        self.arm.park()

    def truth(self) -> None:
        """Nobody knows where the object really is."""

    def show_paddle(self, shown: bool) -> None:
        """Raises `BaggieError`: a person puts things into this hand, for a calibration that the file points to."""
        if shown:
            raise BaggieError(
                f"expected {self.settings.name} to be calibrated, got no image_to_robot below `calibrations` in its "
                "file; make one with: baggie calibrate image-to-robot --workcell FILE"
            )

    def clock(self) -> float:
        """Seconds since it was opened."""
        return time.monotonic() - self._began

    def close(self) -> None:
        """Let go of arm and camera; the arm holds its position."""
        for device in self._devices:
            device.close()
