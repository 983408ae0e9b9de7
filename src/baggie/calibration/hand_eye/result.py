"""The result of a hand-eye calibration, and its file.

A hand-eye calibration as a picture: which views are off by how much, and how the methods compare.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from baggie.calibration.files import CameraIdentity, broken, read_calibration, write_calibration
from baggie.calibration.hand_eye.views import Mount
from baggie.calibration.pose import UncertainTransform
from baggie.geometry import FloatArray
from baggie.pictures import write_figure

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


_FULL = 4.0
"""Bars end at this many times the best method's error; the number beside one says the rest."""


def draw_views(result: HandEye, path: Path) -> None:
    """Save each view's error when left out, with the dropped ones marked, above every method's mean.

    Raises `WriteError`.
    """
    from matplotlib.figure import Figure  # noqa: PLC0415 -- worker processes start without it

    names = [name for name, _ in (*result.views, *result.dropped)]
    errors = [error for _, error in result.views] + [0.0] * len(result.dropped)
    dropped = np.arange(len(names)) >= len(result.views)
    order = sorted(range(len(names)), key=lambda i: _in_order(names[i]))
    places = np.arange(len(names))
    figure = Figure(figsize=(7.5, 6.5), layout="constrained")
    above, below = figure.subplots(2, 1)
    gone = dropped[order]
    above.bar(
        places[~gone], np.array(errors)[order][~gone], color="tab:blue", label="left out, against the others"
    )
    above.axhline(
        result.leave_one_out_mm, color="0.4", linestyle="--", label=f"mean {result.leave_one_out_mm:.2f} mm"
    )
    above.scatter(
        places[gone],
        np.zeros(gone.sum()),
        s=40,
        color="tab:red",
        marker="x",
        clip_on=False,
        label="dropped: take again",
    )
    above.set_xticks(places, [names[i] for i in order], rotation=90, fontsize=7)
    above.set_ylabel("error of the view (mm)")
    above.set_title(f"{len(result.views)} views kept, {len(result.dropped)} dropped, by {result.method}")
    above.legend(frameon=False, fontsize=8)

    methods = sorted(result.methods, key=lambda name: result.methods[name].leave_one_out_mm)
    means = np.array([result.methods[name].leave_one_out_mm for name in methods])
    end = _FULL * max(result.leave_one_out_mm, 1e-6)
    below.barh(
        methods, np.minimum(means, end), color=["tab:green" if m == result.method else "0.7" for m in methods]
    )
    for row, mean in enumerate(means):
        below.text(min(mean, end), row, f" {mean:.2f}", va="center", fontsize=8)
    below.set_xlim(0, 1.1 * end)
    below.invert_yaxis()
    below.set_xlabel("mean error of views left out (mm)")
    write_figure(path, figure)


def _in_order(name: str) -> list[tuple[int, str]]:
    """Sorts "view 9" before "view 10"."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", name)]
