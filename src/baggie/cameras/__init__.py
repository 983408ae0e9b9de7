"""Cameras: what one must offer, and those there are, each with what a workcell file says of it.

Their makers' packages are imported when a camera is opened.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, ClassVar, Literal

from pydantic import ConfigDict, Field

from baggie.cameras.camera import Camera, CameraEntry, CameraSettings, OpenCamera
from baggie.cameras.live import LiveCamera, Stream
from baggie.cameras.opencv import OpenCVStream, VideoFile, is_live
from baggie.errors import BaggieError, CameraError, explained, install_extra
from baggie.registry import CAMERAS, lacking, made_by


def open_camera(settings: CameraSettings) -> OpenCamera:
    """Open a camera. Raises `CameraError` when it is not there, cannot be set so, or its package is not installed."""
    return _settings(settings.kind).model_validate(settings.model_dump()).open(Path.cwd())


def settings_of(words: str) -> CameraSettings:
    """`"realsense"` or `"realsense:SERIAL"`, likewise `orbbec` and `k4a`; anything else is a source for OpenCV."""
    kind, _, source = words.partition(":")
    if kind in CAMERAS and kind != "opencv" and issubclass(CAMERAS[kind], CameraSettings):
        return _settings(kind).model_validate({"kind": kind, "source": source or None})
    return OpenCVSettings(source=words)


def _settings(kind: str) -> type[CameraSettings]:
    """The settings of a kind. Raises `CameraError` where it has others, which open in a workcell file alone."""
    model = CAMERAS[kind]
    if not issubclass(model, CameraSettings):
        raise CameraError(
            f"expected a camera with a source, got one of kind {kind}; name it in a workcell file"
        )
    return model


class OpenCVSettings(CameraSettings):
    """Anything that OpenCV opens."""

    kind: Literal["opencv"] = "opencv"
    about: ClassVar[str] = "a USB or network camera or a video file"

    def open(self, folder: Path) -> OpenCamera:
        """Open the camera, or the video file. Raises `CameraError` when it is not there or cannot be set so."""
        source = self.source or "0"
        return LiveCamera(OpenCVStream, self) if is_live(source) else VideoFile(source, self)


class _DepthSettings(CameraSettings):
    """A camera with depth, which speaks through its maker's package."""

    about: ClassVar[str] = "with depth"
    package: ClassVar[str]
    """What is imported; the extra that brings it has the kind's name."""
    before: ClassVar[str] = ""
    """What to do before that can be installed."""

    def open(self, folder: Path) -> OpenCamera:
        """Open the camera. Raises `CameraError` when it is not there, or cannot be set so, or the package is not."""
        try:
            importlib.import_module(self.package)
        except ImportError as error:
            if missing := explained(error):
                raise CameraError(f"a camera of kind {self.kind} cannot be opened: {missing}") from None
            raise CameraError(
                f"a camera of kind {self.kind} needs the package {self.package}, which cannot be imported "
                f"({' '.join(str(error).split())}); {self.before}{install_extra(self.kind)}"
            ) from None
        return LiveCamera(self._open_stream(), self)

    def _open_stream(self) -> Callable[[CameraSettings], Stream]:
        """What opens its stream, imported."""
        raise NotImplementedError


class RealSenseSettings(_DepthSettings):
    """Intel RealSense D400 and relatives, and their recordings."""

    kind: Literal["realsense"] = "realsense"
    package: ClassVar[str] = "pyrealsense2"

    def _open_stream(self) -> Callable[[CameraSettings], Stream]:
        from baggie.cameras.realsense import open_stream  # noqa: PLC0415 -- an extra

        return open_stream


class OrbbecSettings(_DepthSettings):
    """Orbbec Femto Bolt and Femto Mega."""

    kind: Literal["orbbec"] = "orbbec"
    package: ClassVar[str] = "pyorbbecsdk"

    def _open_stream(self) -> Callable[[CameraSettings], Stream]:
        from baggie.cameras.orbbec import open_stream  # noqa: PLC0415 -- an extra

        return open_stream


class AzureKinectSettings(_DepthSettings):
    """Azure Kinect."""

    kind: Literal["k4a"] = "k4a"
    package: ClassVar[str] = "pyk4a"
    before: ClassVar[str] = "install Microsoft's Azure Kinect Sensor SDK, then: "

    def _open_stream(self) -> Callable[[CameraSettings], Stream]:
        from baggie.cameras.k4a import open_stream  # noqa: PLC0415 -- an extra

        return open_stream


class PythonCameraEntry(CameraEntry):
    """A camera of one's own. Every other entry is an option of its factory."""

    model_config = ConfigDict(extra="allow")

    kind: Literal["python"] = "python"
    about: ClassVar[str] = "one of your own"
    factory: str = Field(pattern=r"^[\w.]+:\w+$")
    """`my_lab.my_camera:open_camera`, a function or class that makes a `Camera`; the module may be in the file's own
    folder."""

    def open(self, folder: Path) -> Camera:
        """Make the camera. Raises as `open_python_camera` does."""
        return open_python_camera(self.factory, self.model_extra or {}, folder)


def open_python_camera(factory: str, options: Mapping[str, Any], folder: Path) -> Camera:
    """What `factory` makes of `options`: `"my_lab.my_camera:open_camera"`, a function or class in a module.

    Raises `BaggieError` as `made_by` does, and when it makes no `Camera`, or one whose size is no size.
    """
    camera = made_by(factory, options, folder, "camera")
    if not isinstance(camera, Camera) or not _is_size(camera.size):
        wrong = lacking(camera, Camera) or "has a `size` that is not (width, height) in pixels"
        raise BaggieError(
            f"{factory} made a {type(camera).__name__}, which is no Camera: it {wrong}; see baggie/cameras/camera.py"
        )
    return camera


def _is_size(size: object) -> bool:
    return (
        isinstance(size, tuple)
        and len(size) == 2
        and all(isinstance(side, int) and side > 0 for side in size)
    )
