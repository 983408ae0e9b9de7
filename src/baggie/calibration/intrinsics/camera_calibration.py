"""A camera's calibration: its matrix and lens, how sure they are, and what they were fitted to.

A picture of where a camera's calibration saw corners, and how far off they are.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from baggie.calibration.files import CameraIdentity, broken, read_calibration, write_calibration
from baggie.calibration.intrinsics.factory import read_factory
from baggie.calibration.intrinsics.lens import PARAMETERS
from baggie.errors import CalibrationError
from baggie.geometry import FloatArray
from baggie.pictures import write_figure
from baggie.types import Intrinsics
from baggie.vision.corners import Sag
from baggie.vision.targets import Target, with_sag

_KIND = "intrinsics"
_SEEN_STDS, _SEEN_M = 3.0, 0.5e-4
"""A smaller sag is not spoken of, though it is counted in."""


def _none() -> FloatArray:
    return np.zeros((0, 2))


@dataclass(frozen=True)
class ViewError:
    """How well one picture is explained."""

    name: str
    rms_px: float
    corners: int
    """How many of its corners took part."""
    pixels: FloatArray = field(default_factory=_none, compare=False)
    """`(N, 2)` (u, v): where they were seen. Not kept in a file."""
    residuals_px: FloatArray = field(default_factory=_none, compare=False)
    """`(N, 2)`: where they should appear, less where they were seen. Not kept in a file."""


@dataclass(frozen=True)
class CameraCalibration:
    """The matrix and the lens of one camera at one resolution."""

    camera: CameraIdentity
    intrinsics: Intrinsics
    covariance: FloatArray | None
    """`(9, 9)` of fx, fy, cx, cy, k1, k2, p1, p2, k3; zero where a term was held; None from the factory."""
    terms: tuple[str, ...]
    """The distortion terms that were fitted; the others are zero."""
    rms_px: float | None
    """Of the corners it was fitted to; None from the factory."""
    held_out_rms_px: float | None
    """Of corners in views it was not fitted to, by cross-validation: what to expect of a new picture."""
    views: tuple[ViewError, ...]
    dropped: tuple[tuple[str, str], ...]
    """Pictures left out, each with the reason why."""
    warnings: tuple[str, ...]
    target: str
    """The board, as `parse_target` reads it; empty from the factory."""
    source: str
    """What it was made from."""
    sag: Sag | None = None
    """How the board is bent; None from the factory, and in files from before it was fitted."""
    sag_std: Sag | None = None
    """One standard deviation of it."""
    corner_noise_px: float | None = None
    """What of `rms_px` goes from corner to corner: how exactly they were found. None where that is not known."""

    def shaped(self, target: Target) -> Target:
        """A target as it is bent, where it is the board that this camera was calibrated with; else as it is."""
        return with_sag(target, self.sag) if self.sag and target.spec == self.target else target

    @property
    def board_shape(self) -> str | None:
        """How the board is bent, in words; None where nobody knows."""
        if self.sag is None or self.sag_std is None:
            return None
        found, std = (np.array([sag.along_m, sag.across_m]) for sag in (self.sag, self.sag_std))
        if (np.abs(found) < np.maximum(_SEEN_STDS * std, _SEEN_M)).all():
            return f"the board is flat (to {1000 * max(_SEEN_M, 2 * std.max()):.1f} mm)"
        return f"the board sags by {self.sag}"

    @property
    def standard_deviations(self) -> dict[str, float]:
        """By parameter: `fx_px`, `fy_px`, `cx_px`, `cy_px`, `k1`, ...; empty from the factory."""
        if self.covariance is None:
            return {}
        names = [f"{name}_px" if name[0] in "fc" else name for name in PARAMETERS]
        return dict(zip(names, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))

    def summary(self) -> dict[str, Any]:
        """What a person or a script wants to know, ready for JSON."""
        return {
            "camera": self.camera.to_yaml(),
            "camera_matrix": self.intrinsics.matrix.tolist(),
            "distortion": self.intrinsics.distortion.tolist(),
            "terms": list(self.terms),
            "rms_px": self.rms_px,
            "held_out_rms_px": self.held_out_rms_px,
            "corner_noise_px": self.corner_noise_px,
            "standard_deviations": self.standard_deviations,
            "board_shape": self.board_shape,
            "views": [{"view": v.name, "rms_px": v.rms_px, "corners": v.corners} for v in self.views],
            "dropped": [{"view": name, "why": why} for name, why in self.dropped],
            "warnings": list(self.warnings),
        }

    def save(self, path: Path) -> None:
        """Write readable YAML; floats keep every digit. Raises `DataError` when it cannot be written."""
        content = {
            "units": "pixels (u, v) with centres at integers; distortion in OpenCV's order",
            **self.summary(),
            "covariance_of": list(PARAMETERS) if self.covariance is not None else None,
            "covariance": self.covariance,
            "board": self.target,
            "sag": None if self.sag is None else asdict(self.sag),
            "sag_std": None if self.sag_std is None else asdict(self.sag_std),
            "source": self.source,
        }
        write_calibration(path, _KIND, content)

    @classmethod
    def load(cls, path: Path, camera: CameraIdentity | None = None) -> CameraCalibration:
        """Read what `save` wrote.

        Raises `DataError` when the file is missing, damaged or of another kind, `CalibrationError` when it is of
        another camera than `camera`, or of another resolution.
        """
        content = read_calibration(path, _KIND)
        try:
            calibration = cls._from_yaml(content)
        except (KeyError, TypeError, ValueError) as error:
            raise broken(path, _KIND, error) from None
        if camera is not None:
            calibration.camera.check(camera, f"the calibration {path}")
        return calibration

    @classmethod
    def _from_yaml(cls, content: Mapping[str, Any]) -> CameraCalibration:
        camera = CameraIdentity.from_yaml(content["camera"])
        matrix = np.array(content["camera_matrix"], float).reshape(3, 3)
        distortion = np.array(content["distortion"], float).reshape(-1)
        covariance = content["covariance"]
        if covariance is not None:
            covariance = np.array(covariance, float).reshape(len(PARAMETERS), len(PARAMETERS))
        if not np.isfinite(matrix).all():
            raise ValueError("camera_matrix is not finite")
        return cls(
            camera=camera,
            intrinsics=Intrinsics(*camera.size, matrix, distortion),
            covariance=covariance,
            terms=tuple(map(str, content["terms"])),
            rms_px=_number(content["rms_px"]),
            held_out_rms_px=_number(content["held_out_rms_px"]),
            views=tuple(
                ViewError(str(v["view"]), float(v["rms_px"]), int(v["corners"])) for v in content["views"]
            ),
            dropped=tuple((str(d["view"]), str(d["why"])) for d in content["dropped"]),
            warnings=tuple(map(str, content["warnings"])),
            target=str(content["board"]),
            source=str(content["source"]),
            corner_noise_px=_number(content.get("corner_noise_px")),
            sag=Sag.from_yaml(content.get("sag")),
            sag_std=Sag.from_yaml(content.get("sag_std")),
        )


def import_intrinsics(path: Path, camera_name: str) -> CameraCalibration:
    """The manufacturer's or another program's calibration, without covariance or errors: nobody says how good it is.

    Reads ROS camera_info (YAML or JSON), RealSense (JSON) and OpenCV's FileStorage (YAML, XML or JSON).
    Raises `DataError` for anything else, `CalibrationError` for lens models that are not supported.
    """
    intrinsics = read_factory(path)
    camera = CameraIdentity(camera_name, intrinsics.width, intrinsics.height)
    warning = f"taken from {path.name} unchecked; how exact it is, is not known"
    return CameraCalibration(
        camera, intrinsics, None, (), None, None, (), (), (warning,), "", f"factory file {path.name}"
    )


def _number(value: Any) -> float | None:
    return None if value is None else float(value)


_ARROW = 0.03
"""Of the picture's width: how long a large residual (the 95th percentile) is about drawn."""


def draw_coverage(calibration: CameraCalibration, path: Path) -> None:
    """Save a picture of all corners, a colour for each view, with enlarged arrows to where they should appear.

    Arrows that point all ways are noise; arrows that agree with their neighbours are what the lens model misses.
    Raises `CalibrationError` for a calibration read from a file, which has no corners, and
    `WriteError`.
    """
    from matplotlib.figure import Figure  # noqa: PLC0415 -- worker processes start without it

    views = [view for view in calibration.views if len(view.pixels)]
    if not views:
        raise CalibrationError(
            "a calibration read from a file has no corners to draw; draw it when it is made"
        )
    camera = calibration.camera
    large = float(np.percentile(np.linalg.norm(np.concatenate([v.residuals_px for v in views]), axis=1), 95))
    enlarged = 10 ** math.floor(math.log10(_ARROW * camera.width / max(large, 1e-6)))
    figure = Figure(figsize=(9.0, 1.5 + 8.0 * camera.height / camera.width), layout="constrained")
    axes = figure.subplots()
    for view in views:
        (u, v), (du, dv) = view.pixels.T, view.residuals_px.T
        points = axes.scatter(u, v, s=6)
        arrows = {"angles": "xy", "scale_units": "xy", "scale": 1 / enlarged, "width": 0.0012}
        axes.quiver(u, v, du, dv, color=points.get_facecolor(), **arrows)
    for share in (1 / 3, 2 / 3):
        axes.axvline(share * camera.width - 0.5, color="0.85", linewidth=0.8, zorder=0)
        axes.axhline(share * camera.height - 0.5, color="0.85", linewidth=0.8, zorder=0)
    axes.set(xlim=(-0.5, camera.width - 0.5), ylim=(camera.height - 0.5, -0.5), aspect="equal")
    axes.set(xlabel="u (pixels)", ylabel="v (pixels)")
    axes.set_title(
        f"{camera.name}: {len(views)} views, {calibration.rms_px:.2f} px RMS, {calibration.held_out_rms_px:.2f} px on "
        f"views not fitted to; residuals {enlarged:g} times enlarged",
        fontsize=9,
    )
    write_figure(path, figure)
