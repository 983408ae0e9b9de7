"""Residuals of a map from the picture to the robot, and its differences from another map: numbers and drawings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from baggie.errors import CalibrationError
from baggie.geometry import FloatArray, Rectangle
from baggie.pictures import write_figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from baggie.calibration.image_to_robot.map import ImageToRobot

_COLUMNS = ("x_m", "y_m", "z_m", "dx_mm", "dy_mm", "left_out_dx_mm", "left_out_dy_mm", "kept")


@dataclass(frozen=True)
class Residuals:
    """One row a point, those that were dropped included, which take no part in the figures."""

    points: FloatArray
    """`(N, 3)` metres, robot base frame."""
    error_mm: FloatArray
    """`(N, 2)`: where the point's pixel is mapped at the point's height, less where it was."""
    left_out_mm: FloatArray
    """`(N, 2)`: the same, mapped by a fit to the other points: what to expect of a new point."""
    kept: NDArray[np.bool_]
    """`(N,)`; False for a point that is more than four standard deviations off, and was left out of the fit."""

    @property
    def rms_mm(self) -> float:
        """Root mean square distance."""
        return _rms(self.error_mm[self.kept])

    @property
    def max_mm(self) -> float:
        """The greatest distance."""
        return float(np.linalg.norm(self.error_mm[self.kept], axis=1).max())

    @property
    def leave_one_out_mm(self) -> float:
        """Root mean square distance of left-out points."""
        return _rms(self.left_out_mm[self.kept])

    @property
    def leave_one_out_max_mm(self) -> float:
        """The greatest distance of a left-out point."""
        return float(np.linalg.norm(self.left_out_mm[self.kept], axis=1).max())

    def to_yaml(self) -> dict[str, Any]:
        """Give the content of a file in plain YAML types."""
        numbers = np.hstack([self.points, self.error_mm, self.left_out_mm]).tolist()
        rows = [[*row, bool(kept)] for row, kept in zip(numbers, self.kept, strict=True)]
        return {"columns": list(_COLUMNS), "rows": rows}

    @classmethod
    def from_yaml(cls, content: Mapping[str, Any]) -> Residuals:
        """The inverse of `to_yaml`."""
        rows = content["rows"]
        numbers = np.array([row[:7] for row in rows], float).reshape(-1, 7)
        return cls(
            numbers[:, :3], numbers[:, 3:5], numbers[:, 5:], np.array([bool(row[7]) for row in rows], bool)
        )


def _rms(vectors: FloatArray) -> float:
    """Root mean square of the lengths of `(N, 2)`."""
    return float(np.sqrt((vectors**2).sum(axis=1).mean()))


@dataclass(frozen=True)
class MapComparison:
    """Where map `b` places what map `a` sees at each point of a grid, less where `a` places it."""

    area: Rectangle
    height_m: float
    points: FloatArray
    """`(N, 2)` metres, robot base frame, spread evenly over the area."""
    difference_mm: FloatArray
    """`(N, 2)`; NaN where b does not reach the plane."""

    @property
    def rms_mm(self) -> float:
        """Root mean square distance."""
        return float(np.sqrt((self.difference_mm**2).sum(axis=1).mean()))

    @property
    def max_mm(self) -> float:
        """The greatest distance."""
        return float(np.linalg.norm(self.difference_mm, axis=1).max())

    @property
    def shift_mm(self) -> FloatArray:
        """`(2,)`: the mean difference, x and y; a camera or robot that was moved shows here."""
        return np.asarray(self.difference_mm.mean(axis=0))

    def summary(self) -> dict[str, Any]:
        """Ready for JSON."""
        return {
            "height_m": self.height_m,
            "rms_mm": self.rms_mm,
            "max_mm": self.max_mm,
            "shift_mm": self.shift_mm.tolist(),
        }


def lattice(area: Rectangle, rows: int, columns: int) -> FloatArray:
    """Points spread evenly over an area, edges included, x slowest: `(rows * columns, 2)` metres."""
    x = np.linspace(area.x_min, area.x_max, rows)
    y = np.linspace(area.y_min, area.y_max, columns)
    return np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)


def shared_area(a: Rectangle, b: Rectangle) -> Rectangle:
    """What both areas cover. Raises `CalibrationError` where they do not meet."""
    x_min, x_max = max(a.x_min, b.x_min), min(a.x_max, b.x_max)
    y_min, y_max = max(a.y_min, b.y_min), min(a.y_max, b.y_max)
    if x_min >= x_max or y_min >= y_max:
        raise CalibrationError(
            f"expected maps of one area, got {a} and {b}; compare maps of the same workspace"
        )
    return Rectangle(x_min, x_max, y_min, y_max)


_MARGIN_M = 0.04
_LONGEST_M = 0.07
"""Length in the picture of the longest arrow, at most."""
_ASIDE_M = 0.012
"""Points over each other at several heights are drawn this far to the left of one another."""
_COLORS = ("tab:blue", "tab:orange", "tab:green", "tab:purple")


def draw_residuals(image_to_robot: ImageToRobot, path: Path) -> None:
    """Save a PNG: what each point would be mapped to by a fit to the others, less where it was, enlarged.

    The robot is at the bottom, y points left. Shading is the map's own uncertainty at its height, crosses are points
    that were dropped. Raises `WriteError` when it cannot be written.
    """
    r = image_to_robot.residuals
    figure, axes = _figure()
    area = _wider(image_to_robot.area)
    shade = lattice(area, 41, 61)
    _shade(figure, axes, area, image_to_robot.std_mm_at(shade).reshape(41, 61), "uncertainty (mm, 1 std)")
    factor = _factor(r.left_out_mm[r.kept], _LONGEST_M)
    levels = np.array(image_to_robot.heights_m)
    level = np.abs(r.points[:, 2, None] - levels).argmin(axis=1)
    places = r.points[:, :2].copy()
    if len(levels) <= len(_COLORS):
        places[:, 1] += _ASIDE_M * (level - (len(levels) - 1) / 2)
        groups = [(level == i, _COLORS[i], f"at z = {z:.3f} m") for i, z in enumerate(levels)]
    else:
        groups = [(level >= 0, _COLORS[0], f"at z = {levels[0]:.3f} to {levels[-1]:.3f} m")]
    for group, color, label in groups:
        mine = group & r.kept
        _arrows(axes, places[mine], r.left_out_mm[mine], factor, color)
        axes.scatter(*_seen(places[mine]), s=16, color=color, zorder=4, label=label)
    dropped = places[~r.kept]
    if len(dropped):
        axes.scatter(
            *_seen(dropped), s=70, color="tab:red", marker="x", zorder=5, label=f"dropped ({len(dropped)})"
        )
    _explain(figure, axes, area, factor)
    axes.set_title(
        f"{image_to_robot.camera.name}: {int(r.kept.sum())} points, each left out {r.leave_one_out_mm:.2f} mm "
        f"RMS\nuncertainty {image_to_robot.std_mm:.2f} mm at z = {image_to_robot.height_m:.3f} m, "
        f"lens {image_to_robot.lens_origin}",
        fontsize=10,
    )
    write_figure(path, figure)


def draw_comparison(comparison: MapComparison, path: Path) -> None:
    """Save a PNG of the same kind: how far, and which way, the second map places things from where the first does.

    Raises `WriteError` when it cannot be written.
    """
    figure, axes = _figure()
    difference, area = comparison.difference_mm, _wider(comparison.area)
    x = np.unique(comparison.points[:, 0])
    _shade(
        figure,
        axes,
        comparison.area,
        np.linalg.norm(difference, axis=1).reshape(len(x), -1),
        "difference (mm)",
    )
    factor = _factor(difference, 1.5 * float(x[1] - x[0]))
    _arrows(axes, comparison.points, difference, factor, "0.1")
    axes.scatter(
        *_seen(comparison.points),
        s=5,
        color="0.1",
        zorder=4,
        label="in the first map, with arrows to where it is in the second",
    )
    _explain(figure, axes, area, factor)
    x, y = comparison.shift_mm
    axes.set_title(
        f"difference at z = {comparison.height_m:.3f} m: {comparison.rms_mm:.2f} mm RMS, at most "
        f"{comparison.max_mm:.2f} mm\nmean shift x {x:+.2f} mm, y {y:+.2f} mm",
        fontsize=10,
    )
    write_figure(path, figure)


def _figure() -> tuple[Figure, Axes]:
    from matplotlib.figure import Figure  # noqa: PLC0415 -- worker processes start without it

    figure = Figure(figsize=(8.0, 5.4), layout="constrained")
    axes = figure.subplots()
    axes.invert_xaxis()  # y points left when x points away
    axes.set(aspect="equal", xlabel="y, left of the robot (m)", ylabel="x, in front of the robot (m)")
    return figure, axes


def _seen(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """`(N, 2)` x, y -> two times `(N,)` as drawn: across, up."""
    return points[:, 1], points[:, 0]


def _wider(area: Rectangle) -> Rectangle:
    m = _MARGIN_M
    return Rectangle(area.x_min - m, area.x_max + m, area.y_min - m, area.y_max + m)


def _shade(figure: Figure, axes: Axes, area: Rectangle, values: FloatArray, label: str) -> None:
    """`values` `(rows, columns)` over the area, x along the rows."""
    extent = (area.y_min, area.y_max, area.x_min, area.x_max)
    image = axes.imshow(
        values, origin="lower", extent=extent, cmap="YlGnBu", alpha=0.5, vmin=0.0, interpolation="bilinear"
    )
    figure.colorbar(image, ax=axes, label=label, shrink=0.8)


def _factor(vectors_mm: FloatArray, longest_m: float) -> float:
    """How many times to enlarge, so that no arrow is longer than this: 1, 2 or 5 times a power of ten."""
    longest = max(float(np.nanmax(np.linalg.norm(vectors_mm, axis=1))) / 1000, 1e-9)
    return _round_down(longest_m / longest)


def _round_down(value: float) -> float:
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(step for step in (1, 2, 5) if step * power <= value * (1 + 1e-9)) * power)


def _arrows(axes: Axes, points: FloatArray, vectors_mm: FloatArray, factor: float, color: str) -> None:
    enlarged = vectors_mm / 1000 * factor
    axes.quiver(
        *_seen(points),
        *_seen(enlarged),
        color=color,
        angles="xy",
        scale_units="xy",
        scale=1.0,
        width=0.004,
        zorder=3,
    )


def _explain(figure: Figure, axes: Axes, area: Rectangle, factor: float) -> None:
    """Below the area an arrow of a round length and what it stands for, below that the legend."""
    axes.set_xlim(area.y_max, area.y_min)
    axes.set_ylim(area.x_min - 0.045, area.x_max)
    length_mm = _round_down(_LONGEST_M / factor * 1000)
    tail = np.array([[area.x_min - 0.022, area.y_max - 0.02]])
    _arrows(axes, tail, np.array([[0.0, -length_mm]]), factor, "black")
    beside = float(tail[0, 1]) - length_mm / 1000 * factor - 0.012
    words = f"{length_mm:g} mm (arrows {factor:g} times enlarged)"
    axes.text(beside, float(tail[0, 0]), words, va="center", fontsize=9)
    figure.legend(loc="outside lower center", fontsize=9, ncols=4, frameon=False)
