"""A picture of where a camera's calibration saw corners, and how far off they are."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from baggie.calibration.intrinsics.camera_calibration import CameraCalibration
from baggie.errors import CalibrationError
from baggie.vision.picture_files import write_figure

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
