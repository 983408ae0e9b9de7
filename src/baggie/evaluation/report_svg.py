"""Charts as inline SVG that takes its colours from the page, readable in light and dark."""

from __future__ import annotations

import io
import re
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

# Colours that stand for the page's variables; none of them is ever seen.
INK, MUTED, GRID = "#010101", "#020202", "#030303"
SERIES = ("#0a0101", "#0a0202", "#0a0303", "#0a0404", "#0a0505")
_VARIABLES = {INK: "ink", MUTED: "muted", GRID: "grid"} | {
    color: f"series-{number}" for number, color in enumerate(SERIES, start=1)
}
_STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "baggie",
    "font.family": "sans-serif",
    "font.size": 10,
    "text.color": INK,
    "axes.edgecolor": GRID,
    "axes.labelcolor": MUTED,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": GRID,
    "grid.linewidth": 0.8,
    "xtick.color": MUTED,
    "ytick.color": MUTED,
    "xtick.major.size": 0,
    "ytick.major.size": 0,
    "lines.linewidth": 2,
    "lines.solid_capstyle": "round",
    "legend.frameon": False,
}


def canvas(width: float = 5.4, height: float = 3.4) -> tuple[Figure, Axes]:
    """A figure with one set of axes; inches, of which the page makes what fits."""
    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=(width, height), layout="constrained")
        FigureCanvasSVG(figure)
        return figure, figure.add_subplot()


def svg(figure: Figure, axes: Axes, *, legend: bool = True) -> str:
    """The `<svg>` element alone, its colours replaced by the page's variables and its addresses taken out."""
    with mpl.rc_context(_STYLE):
        if legend and axes.get_legend_handles_labels()[0]:
            figure.legend(loc="outside upper left", ncols=3, handlelength=1.2, columnspacing=1.4)
        text = io.StringIO()
        # Without these keys matplotlib writes the date and its home page into the file.
        figure.savefig(text, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    element = text.getvalue()
    element = element[element.index("<svg") :]
    element = re.sub(r"<(metadata|style)\b.*?</\1>", "", element, flags=re.DOTALL)
    element = re.sub(r'\s(xmlns(:\w+)?)="[^"]*"', "", element).replace("xlink:href", "href")
    element = re.sub(r'<svg[^>]*?viewBox="([^"]*)"[^>]*>', r'<svg viewBox="\1" role="img">', element, count=1)
    element = re.sub(r"font-family: [^;\"]*;? ?", "", element)
    for color, variable in _VARIABLES.items():
        element = element.replace(color, f"var(--{variable})")
    return element
