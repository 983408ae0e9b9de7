"""An arm or a camera of one's own, found by its dotted name; what a workcell file says of either."""

from __future__ import annotations

import importlib
import inspect
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, ClassVar, Literal

from pydantic import ConfigDict, Field

from baggie.cameras.camera import Camera, CameraEntry
from baggie.errors import BaggieError
from baggie.robot.arm import Arm, ArmEntry, ArmInfo

FACTORY = r"^[\w.]+:\w+$"


class PythonArmEntry(ArmEntry):
    """An arm of one's own. Every other entry is an option of its factory."""

    model_config = ConfigDict(extra="allow")

    kind: Literal["python"] = "python"
    about: ClassVar[str] = "one of your own"
    factory: str = Field(pattern=FACTORY)
    """`my_lab.my_arm:open_arm`, a function or class that makes an `Arm`; the module may be in the file's own folder."""

    def open(self, folder: Path) -> Arm:
        """Make the arm. Raises as `open_python_arm` does."""
        return open_python_arm(self.factory, self.model_extra or {}, folder)


class PythonCameraEntry(CameraEntry):
    """A camera of one's own, likewise."""

    model_config = ConfigDict(extra="allow")

    kind: Literal["python"] = "python"
    about: ClassVar[str] = "one of your own"
    factory: str = Field(pattern=FACTORY)
    """`my_lab.my_camera:open_camera`."""

    def open(self, folder: Path) -> Camera:
        """Make the camera. Raises as `open_python_camera` does."""
        return open_python_camera(self.factory, self.model_extra or {}, folder)


def open_python_arm(factory: str, options: Mapping[str, Any], folder: Path) -> Arm:
    """What `factory` makes of `options`: `"my_lab.my_arm:open_arm"`, a function or class in a module.

    The module is looked for where Python looks, then in `folder`. Raises `BaggieError` when it cannot be imported, does
    not take these options, or makes no `Arm`; whatever the factory itself raises is passed on.
    """
    arm = _factory("arm", factory, options, folder)(**options)
    if not isinstance(arm, Arm) or not isinstance(arm.info, ArmInfo):
        wrong = _lacking(arm, Arm) or "has an `info` that is no ArmInfo"
        raise BaggieError(
            f"{factory} made a {type(arm).__name__}, which is no Arm: it {wrong}; see baggie/robot/arm.py"
        )
    return arm


def open_python_camera(factory: str, options: Mapping[str, Any], folder: Path) -> Camera:
    """The same for a camera. Raises `BaggieError` likewise, and for one whose size is no size."""
    camera = _factory("camera", factory, options, folder)(**options)
    if not isinstance(camera, Camera) or not _is_size(camera.size):
        wrong = _lacking(camera, Camera) or "has a `size` that is not (width, height) in pixels"
        raise BaggieError(
            f"{factory} made a {type(camera).__name__}, which is no Camera: it {wrong}; see baggie/cameras/camera.py"
        )
    return camera


def _factory(what: str, factory: str, options: Mapping[str, Any], folder: Path) -> Callable[..., object]:
    """The function or class, which takes these options. Raises `BaggieError` where there is none."""
    module_name, _, name = factory.partition(":")
    if str(folder.resolve()) not in sys.path:
        sys.path.append(str(folder.resolve()))
    try:
        module = importlib.import_module(module_name)
    except Exception as error:
        reason = f"{type(error).__name__}: {' '.join(str(error).split())}"
        raise BaggieError(
            f"the {what}'s factory {factory!r} cannot be imported ({reason}); expected module:function, the "
            f"module installed here or in {folder.resolve()}"
        ) from error
    make = getattr(module, name, None)
    if not callable(make):
        raise BaggieError(
            f"the module {module_name} has no function or class {name!r}; give the {what}'s factory"
        )
    try:
        inspect.signature(make).bind(**options)
    except TypeError as error:
        raise BaggieError(
            f"{factory} takes {inspect.signature(make)}, not {', '.join(options) or 'nothing'} ({error}); "
            f"change the options below `{what}`"
        ) from None
    made: Callable[..., object] = make
    return made


def _lacking(device: object, protocol: type) -> str:
    """What of a protocol it has not, in words; nothing where it has all."""
    names = [*protocol.__annotations__, *(name for name in vars(protocol) if name[0] != "_")]
    lacking = [name for name in names if not hasattr(device, name)]
    return f"lacks {', '.join(lacking)}" if lacking else ""


def _is_size(size: object) -> bool:
    return (
        isinstance(size, tuple)
        and len(size) == 2
        and all(isinstance(side, int) and side > 0 for side in size)
    )
