"""A workcell in the real world: a robot at an address, a camera on this computer, a clock on the wall."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Protocol, runtime_checkable

from baggie.errors import BaggieError
from baggie.workcell.arm import Arm
from baggie.workcell.camera import Camera
from baggie.workcell.cameras.live import LiveCamera
from baggie.workcell.watchdog import Watchdog
from baggie.workcell.workcell import Workcell, WorkcellSettings


@runtime_checkable
class _Closable(Protocol):
    def close(self) -> None: ...


class RealWorkcell(Workcell):
    """Any arm and any camera. Nobody puts things back here but the hand, what it still holds."""

    repeatable = False

    def __init__(self, arm: Arm, camera: Camera, settings: WorkcellSettings) -> None:
        super().__init__(arm, camera, settings)
        if isinstance(camera, LiveCamera):
            self.arm.watchdog = Watchdog(camera.silent_s, camera.frame_timeout_s, camera.name)
        self._devices = (arm, camera)
        self._epoch = time.time() - time.monotonic()

    def reset(self, seed: Sequence[int]) -> None:
        """Nobody lays the table anew: what the hand still holds is put down, the arm parks, the rest stays as it is."""
        self.put_down()
        self.arm.park()

    def rescue(self) -> bool:
        """Put down what the hand still holds; whether that was where the object was."""
        return self.put_down()

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
        """Seconds of the wall clock, as its pictures have them; never set back while the workcell is open."""
        return self._epoch + time.monotonic()

    def close(self) -> None:
        """Let go of arm and camera, each if it has a `close`."""
        let_go(*self._devices)


def let_go(*devices: object) -> None:
    """Close those that have a `close`."""
    for device in devices:
        if isinstance(device, _Closable):
            device.close()
