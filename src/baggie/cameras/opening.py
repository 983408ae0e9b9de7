"""The camera that settings describe."""

from __future__ import annotations

import importlib
from typing import Protocol

from baggie.cameras.camera import Camera, CameraSettings
from baggie.cameras.live import LiveCamera
from baggie.cameras.opencv import OpenCVStream, VideoFile, is_live
from baggie.errors import CameraError, explained, install_extra

_PACKAGES = {"realsense": "pyrealsense2", "orbbec": "pyorbbecsdk", "k4a": "pyk4a"}
"""What each kind imports; the extra that brings it has the kind's name."""
_BEFORE = {"k4a": "install Microsoft's Azure Kinect Sensor SDK, then: "}
"""What its package is built against."""


class OpenCamera(Camera, Protocol):
    """A camera that somebody has to close."""

    def close(self) -> None:
        """Let go of the camera."""
        ...


def open_camera(settings: CameraSettings) -> OpenCamera:
    """Open a camera. Raises `CameraError` when it is not there, cannot be set so, or its package is not installed."""
    if settings.kind == "opencv":
        source = settings.source or "0"
        if not is_live(source):
            return VideoFile(source, settings)
        return LiveCamera(OpenCVStream, settings)
    package = _PACKAGES[settings.kind]
    try:
        importlib.import_module(package)
    except ImportError as error:
        if missing := explained(error):
            raise CameraError(f"a camera of kind {settings.kind} cannot be opened: {missing}") from None
        raise CameraError(
            f"a camera of kind {settings.kind} needs the package {package}, which cannot be imported "
            f"({' '.join(str(error).split())}); {_BEFORE.get(settings.kind, '')}{install_extra(settings.kind)}"
        ) from None
    stream = importlib.import_module(f"baggie.workcell.cameras.{settings.kind}").open_stream
    return LiveCamera(stream, settings)
