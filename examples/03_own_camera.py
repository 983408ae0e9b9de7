"""A camera of your own: copy this file as `own_camera.py`, and put your camera where the imaginary one is.

Shows the three attributes and the one method of a camera, and the check that it keeps its promises. Guide:
docs/cameras.md. In a workcell file, with the copy beside it:

    arm: {kind: franka, host: 172.16.0.2}
    camera: {kind: python, factory: "own_camera:open_camera", exposure_ms: 8}

Looks twice, and prints what the check found out:

    the camera keeps the contract
"""

from __future__ import annotations

import time

import numpy as np

from baggie.cameras.camera import check_camera
from baggie.errors import CameraError
from baggie.types import Image, Intrinsics, Observation


class ImaginaryCamera:
    """In the place of your camera's library: it takes a picture when it is asked for one."""

    def __init__(self, size: tuple[int, int], exposure_ms: float) -> None:
        self.size = size
        self._light = min(exposure_ms / 10, 1.0)
        self._rng = np.random.default_rng()

    def snap(self) -> Image | None:
        """A grey table, with a sensor's noise; None where nothing came."""
        width, height = self.size
        noisy = self._rng.normal(160 * self._light, 2.0, (height, width, 3))
        return np.clip(noisy, 0, 255).astype(np.uint8)


class OwnCamera:
    """Three attributes and a method of `baggie.cameras.camera.Camera`, and `close`."""

    def __init__(self, camera: ImaginaryCamera) -> None:
        self.name = "imaginary camera"  # calibrations say by it which camera they are of
        self.size = camera.size
        self.intrinsics: Intrinsics | None = None  # the maker's, if it knows them
        self._camera = camera

    def look(self) -> Observation:
        picture = self._camera.snap()  # taken now: yours may have to throw old ones away first
        if picture is None:
            raise CameraError(f"{self.name} gave no picture; plug it in again")
        return Observation(picture, None, self.intrinsics, time.time())

    def close(self) -> None:
        """Let go of the camera; a workcell calls it."""


def open_camera(width: int = 640, height: int = 480, exposure_ms: float = 8.0) -> OwnCamera:
    """The factory that a workcell file names; what stands below `camera` there comes as arguments."""
    return OwnCamera(ImaginaryCamera((width, height), exposure_ms))


if __name__ == "__main__":
    check_camera(open_camera())
    print("the camera keeps the contract")
