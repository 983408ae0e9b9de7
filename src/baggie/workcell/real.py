"""A workcell in the real world: a robot at an address, a camera on this computer, a clock on the wall."""

from __future__ import annotations

import time
from typing import Protocol, runtime_checkable

from baggie.workcell.arm import Arm
from baggie.workcell.cameras.live import LiveCamera
from baggie.workcell.cameras.opening import OpenCamera
from baggie.workcell.watchdog import Watchdog
from baggie.workcell.workcell import Workcell, WorkcellSettings

SILENT_S = 1.5
"""A camera from which nothing has come for so long stops the arm."""


@runtime_checkable
class _Closable(Protocol):
    def close(self) -> None: ...


class RealWorkcell(Workcell):
    """Any arm and any camera. Nobody puts things back here: `rescue` says that it cannot."""

    def __init__(self, arm: Arm, camera: OpenCamera, settings: WorkcellSettings) -> None:
        super().__init__(arm, camera, settings)
        if isinstance(camera, LiveCamera):
            self.arm.watchdog = Watchdog(camera.silent_s, SILENT_S, camera.name)
        self._devices = (arm, camera)
        self._began = time.monotonic()

    def clock(self) -> float:
        """Seconds since it was opened."""
        return time.monotonic() - self._began

    def close(self) -> None:
        """Let go of the camera, and of an arm that has a `close`."""
        for device in self._devices:
            if isinstance(device, _Closable):
                device.close()
