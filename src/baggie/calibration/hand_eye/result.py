"""The result of a hand-eye calibration, and its file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from baggie.calibration.files import CameraIdentity, broken, read_calibration, write_calibration
from baggie.calibration.hand_eye.views import Mount
from baggie.calibration.uncertain import UncertainTransform
from baggie.geometry import FloatArray

_KIND = "hand-eye"


@dataclass(frozen=True)
class MethodErrors:
    """How far one method leaves the views apart, millimetres."""

    leave_one_out_mm: float
    """Mean over views, each against the others under a fit to the others: what a new view would be off by."""
    median_mm: float
    """Of the same errors."""
    max_mm: float
    """Of the same errors."""
    disagreement_mm: float
    """Mean distance of all views from their mean, under the fit to all: smaller, and never to be trusted alone."""


@dataclass(frozen=True)
class HandEye:
    """Where the camera is on the hand, or on the base."""

    mount: Mount
    transform: UncertainTransform
    """`T_hand_camera`, or `T_base_camera` for a fixed camera."""
    board: FloatArray
    """`(4, 4)`: `T_base_board`, or `T_hand_board` for a fixed camera."""
    method: str
    """The one of `methods` with the least error of views left out."""
    methods: Mapping[str, MethodErrors]
    views: tuple[tuple[str, float], ...]
    """Name of each kept view and its error when left out, millimetres."""
    dropped: tuple[tuple[str, str], ...]
    """Name and why; these are the views to take again."""
    warnings: tuple[str, ...]
    camera: CameraIdentity | None = None

    @property
    def leave_one_out_mm(self) -> float:
        """Mean over kept views, of the chosen method."""
        return self.methods[self.method].leave_one_out_mm

    def summary(self) -> dict[str, Any]:
        """What a person or a script wants to know, ready for JSON; lengths of matrices in metres."""
        transform, board = _frames(self.mount)
        return {
            "mount": self.mount,
            transform: self.transform.transform.tolist(),
            "leave_one_out_mm": self.leave_one_out_mm,
            "dropped": [{"view": name, "why": why} for name, why in self.dropped],
            "warnings": list(self.warnings),
            board: self.board.tolist(),
            "method": self.method,
            "methods": {name: asdict(errors) for name, errors in self.methods.items()},
            "uncertainty": {"std_mm": self.transform.std_mm, "std_deg": self.transform.std_deg},
            "views": [{"name": name, "leave_one_out_mm": error} for name, error in self.views],
        }

    def save(self, path: Path) -> None:
        """Write readable YAML. Raises `DataError` when it cannot be written."""
        summary = self.summary()
        uncertainty = {**summary.pop("uncertainty"), "covariance": self.transform.covariance}
        camera = self.camera.to_yaml() if self.camera else None
        write_calibration(
            path, _KIND, {"units": "m", **summary, "uncertainty": uncertainty, "camera": camera}
        )

    @classmethod
    def load(cls, path: Path) -> HandEye:
        """What `save` wrote. Raises `DataError` for a file that is missing, damaged or of another kind."""
        content = read_calibration(path, _KIND)
        try:
            transform, board = _frames(content["mount"])
            return cls(
                content["mount"],
                UncertainTransform(
                    _matrix(content[transform], 4), _matrix(content["uncertainty"]["covariance"], 6)
                ),
                _matrix(content[board], 4),
                str(content["method"]),
                {name: MethodErrors(**errors) for name, errors in content["methods"].items()},
                tuple((view["name"], float(view["leave_one_out_mm"])) for view in content["views"]),
                tuple((view["view"], view["why"]) for view in content["dropped"]),
                tuple(content["warnings"]),
                CameraIdentity.from_yaml(content["camera"]) if content["camera"] else None,
            )
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise broken(path, _KIND, error) from None


def _frames(mount: Mount) -> tuple[str, str]:
    names = {"hand": ("T_hand_camera", "T_base_board"), "fixed": ("T_base_camera", "T_hand_board")}
    return names[mount]


def _matrix(rows: Any, size: int) -> FloatArray:
    return np.array(rows, float).reshape(size, size)
