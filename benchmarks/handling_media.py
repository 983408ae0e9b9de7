"""The drawings of docs/handling.md: heights and widths of pick and place, as they follow from two things.

    python benchmarks/handling_media.py

Writes docs/media/handling-heights.jpg and handling-widths.jpg.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch, Rectangle

from baggie.evaluation.marked_pictures import save_jpeg
from baggie.robot.arm import ArmInfo
from baggie.robot.handling_rules import Thing, handled
from baggie.robot.primitives import Handling
from baggie.types import Image
from baggie.workcell.workcell import WorkcellSettings

MM = 1000.0
FINGER_MM, PALM_MM = 45.0, 25.0
"""How long fingers are drawn, and how high the palm above them."""
SQUEEZED_M = 0.008
"""Between the fingers that pinch a soft bag, as drawn."""
THINGS = {
    "a soft bag, 12 x 12 x 3 cm": Thing((0.12, 0.12, 0.03)),
    "a hard cube of 6.5 cm": Thing((0.065, 0.065, 0.065), hard=True),
}
HAND = ArmInfo("a hand that opens to 8 cm", max_width_m=0.08, max_speed_m_s=1.7, max_force_n=70.0)
RED, GREY, LINE = "#c4282c", "#6b7280", "#2563eb"


@dataclass(frozen=True)
class Options:
    """Where to."""

    out: Path = Path("docs/media")
    """Where the pictures go."""


def main(options: Options) -> None:
    """Draw and save."""
    for name, draw, tall in (("heights", _heights, 3.3), ("widths", _widths, 2.4)):
        figure = Figure(figsize=(12, tall), layout="constrained", dpi=90)
        for axes, (title, thing) in zip(figure.subplots(1, 2), THINGS.items(), strict=True):
            axes.set_title(title)
            axes.set_axis_off()
            draw(axes, thing, handled(thing, WorkcellSettings().limits, HAND).handling)
        save_jpeg(options.out / f"handling-{name}.jpg", _picture(figure))
        print(options.out / f"handling-{name}.jpg")


def _heights(axes: Axes, thing: Thing, h: Handling) -> None:
    """The hand at four places, from the side, and how high its fingertips are there."""
    axes.axhspan(-14, 0, color="#d6c7ae")
    stations = (
        ("approach_z_m", h.approach_z_m, h.open_width_m, 0.0),
        ("pick_z_m", h.pick_z_m, _between(thing), 0.0),
        ("travel_z_m", h.travel_z_m, _between(thing), MM * h.travel_z_m - MM * h.pick_z_m),
        ("place_z_m", h.place_z_m, h.release_width_m, 0.0),
    )
    for number, (name, z, width, lifted) in enumerate(stations):
        x = 190.0 * number
        _object(axes, thing, x, lifted, name == "travel_z_m")
        _hand(axes, x, MM * z, MM * width)
        axes.plot([x - 75, x + 75], [MM * z, MM * z], color=LINE, lw=1, ls="--")
        axes.annotate(
            f"{name}\n{MM * z:g} mm",
            (x, -20),
            ha="center",
            va="top",
            color=LINE,
            fontsize=10,
            annotation_clip=False,
        )
    side, middle = MM * thing.size_m[0] / 2, MM * thing.size_m[2] / 2
    axes.plot([-side, side + 6], [middle, middle], color="black", lw=1, ls=":")
    axes.annotate(f"seen at\n{middle:g} mm", (side + 8, middle), va="center", fontsize=9)
    axes.set(xlim=(-95, 665), ylim=(-55, 285), aspect="equal")


def _widths(axes: Axes, thing: Thing, h: Handling) -> None:
    """The fingers and the object from above, and how far apart they are."""
    stations = (
        ("open_width_m", h.open_width_m, "comes down"),
        ("", _between(thing), "holds it"),
        ("release_width_m", h.release_width_m, "lets go"),
        ("empty_width_m", h.empty_width_m, "closed further: nothing held"),
    )
    for number, (name, width, words) in enumerate(stations):
        x, half = 190.0 * number, MM * width / 2
        if name != "empty_width_m":
            length, across = MM * thing.size_m[0], MM * thing.size_m[1]
            axes.add_patch(
                FancyBboxPatch(
                    (x - length / 2 + 4, -across / 2 + 4),
                    length - 8,
                    across - 8,
                    boxstyle=f"round,pad=4,rounding_size={2 if thing.hard else 14}",
                    fc=RED,
                    ec="none",
                    alpha=0.75,
                )
            )
        for side in (-1, 1):
            low = half if side > 0 else -half - 14
            axes.add_patch(Rectangle((x - 10, low), 20, 14, fc=GREY, ec="black", lw=0.6))
        axes.annotate(
            "",
            (x + 22, -half),
            (x + 22, half),
            arrowprops={"arrowstyle": "<->", "color": LINE, "shrinkA": 0, "shrinkB": 0},
        )
        label = f"{name}\n{MM * width:g} mm" if name else "grasp_force_n\n" + f"{h.grasp_force_n:g} N"
        axes.annotate(label, (x, -72), ha="center", va="top", color=LINE, fontsize=10, annotation_clip=False)
        axes.annotate(
            words, (x, 72), ha="center", va="bottom", color=GREY, fontsize=10, annotation_clip=False
        )
    axes.set(xlim=(-95, 665), ylim=(-115, 100), aspect="equal")


def _between(thing: Thing) -> float:
    """What the fingers are apart with it between them, metres."""
    return thing.gripped_m if thing.hard else SQUEEZED_M


def _object(axes: Axes, thing: Thing, x: float, lifted: float, hangs: bool) -> None:
    width, height = MM * thing.size_m[0], MM * thing.size_m[2]
    if not thing.hard and hangs:
        # Pinched in its middle a bag folds over the hand, its ends down.
        u = np.linspace(-1, 1, 60)
        lower = lifted - 55 * np.abs(u) ** 1.4
        axes.fill_between(x + 26 * u, lower, lower + 24 + 8 * (1 - u**2), color=RED, alpha=0.75, lw=0)
        return
    axes.add_patch(
        FancyBboxPatch(
            (x - width / 2 + 3, lifted + 3),
            width - 6,
            height - 6,
            boxstyle=f"round,pad=3,rounding_size={2 if thing.hard else 12}",
            fc=RED,
            ec="none",
            alpha=0.75,
        )
    )


def _hand(axes: Axes, x: float, z: float, width: float) -> None:
    for side in (-1, 1):
        inner = x + side * width / 2
        axes.add_patch(
            Rectangle((min(inner, inner + side * 10), z), 10, FINGER_MM, fc=GREY, ec="black", lw=0.6)
        )
    axes.add_patch(Rectangle((x - 55, z + FINGER_MM), 110, PALM_MM, fc="#9ca3af", ec="black", lw=0.6))


def _picture(figure: Figure) -> Image:
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.ascontiguousarray(np.asarray(canvas.buffer_rgba())[..., :3])


if __name__ == "__main__":
    main(tyro.cli(Options))
