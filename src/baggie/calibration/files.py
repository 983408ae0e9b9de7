"""Calibrations on disk: readable YAML that says what it is, of which camera, and when it was made."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
import yaml

from baggie.errors import CalibrationError, DataError
from baggie.files import read_json, read_yaml, write_text

VIEWS_FILE = "views.json"
MAP_FILE = "image-to-robot.yaml"
"""In the folder of a cell's calibration: the map from its camera's pictures to its robot."""
REFERENCE_FILE = "reference.png"
"""In the same folder: what the camera saw with the arm parked when the map was made."""


@dataclass(frozen=True)
class CameraIdentity:
    """Which camera pictures come from, and at what size: a calibration is good for no other."""

    name: str
    width: int
    height: int

    @property
    def size(self) -> tuple[int, int]:
        """`(width, height)`, pixels."""
        return self.width, self.height

    def check(self, other: CameraIdentity, what: str) -> None:
        """Raise `CalibrationError` unless `other` is this camera at this resolution. `what` names the calibration."""
        if self != other:
            raise CalibrationError(
                f"{what} is of camera {self.name!r} at {self.width} x {self.height} pixels, not of {other.name!r} at "
                f"{other.width} x {other.height}; calibrate this camera at this resolution, or name the right file"
            )

    def to_yaml(self) -> dict[str, Any]:
        """Give the content of a file in plain YAML types."""
        return {"name": self.name, "width": self.width, "height": self.height}

    @classmethod
    def from_yaml(cls, content: Mapping[str, Any]) -> CameraIdentity:
        """The inverse of `to_yaml`."""
        return cls(str(content["name"]), int(content["width"]), int(content["height"]))


class Calibration(ABC):
    """A calibration: what it came to, and its file."""

    KIND: ClassVar[str]
    """As `baggie calibrate KIND` has it."""

    @abstractmethod
    def summary(self) -> dict[str, Any]:
        """What a person or a script wants to know, ready for JSON."""

    @abstractmethod
    def to_yaml(self) -> dict[str, Any]:
        """Give the content of a file, the summary in it; arrays and numbers of NumPy's may be among it."""

    @classmethod
    @abstractmethod
    def from_yaml(cls, content: Mapping[str, Any]) -> Self:
        """The inverse of `to_yaml`. Raises for what is missing or wrong."""

    def save(self, path: Path) -> None:
        """Write readable YAML, whole or not at all; floats keep every digit, so `load` gives the same to the bit.

        Raises `WriteError` when it cannot be written.
        """
        content = {"kind": self.KIND, "made_on": date.today().isoformat(), **_plain(self.to_yaml())}
        write_text(path, yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=110))

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read what `save` wrote. Raises `DataError` for a file that is missing, damaged or of another kind."""
        content = read_calibration(path, cls.KIND)
        try:
            return cls.from_yaml(content)
        except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
            raise DataError(
                f"the {cls.KIND} calibration in {path} is damaged ({error!r}); calibrate again"
            ) from None


@dataclass(frozen=True)
class CameraCalibrated(Calibration):
    """A calibration that is of one camera, and good for no other."""

    camera: CameraIdentity

    @classmethod
    def load(cls, path: Path, camera: CameraIdentity | None = None) -> Self:
        """Read what `save` wrote; with `camera`, only a calibration of that one.

        Raises `DataError` for a file that is missing, damaged or of another kind, `CalibrationError` for another camera
        or resolution.
        """
        found = super().load(path)
        if camera is not None:
            found.camera.check(camera, f"the {cls.KIND} calibration in {path}")
        return found


def read_calibration(path: Path, kind: str) -> dict[str, Any]:
    """The content of a calibration's file. Raises `DataError` where it is missing or of another kind."""
    try:
        content = read_yaml(path)
    except OSError as error:
        raise DataError(
            f"no {kind} calibration at {path} ({error.strerror}); make one: baggie calibrate {kind}"
        ) from None
    found = content.get("kind") if isinstance(content, dict) else None
    if found != kind:
        raise DataError(
            f"expected a {kind} calibration in {path}, got {found or 'something else'!r}; name the right file"
        )
    return dict(content)


def read_views_file(folder: Path) -> dict[str, Any]:
    """The content of `views.json`, which lists what was seen in a recording, `"views": [{...}, ...]`, and how.

    Raises `DataError` when it is not there or is something else.
    """
    path = folder / VIEWS_FILE
    try:
        content = read_json(path)
    except OSError as error:
        raise DataError(
            f"cannot read {path} ({error.strerror}); name the folder with {VIEWS_FILE} in it"
        ) from None
    views = content.get("views") if isinstance(content, dict) else None
    if not isinstance(views, list) or not all(isinstance(view, dict) for view in views):
        raise DataError(f'expected a list "views" of {{...}} in {path}, got something else; write it again')
    return dict(content)


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    return value
