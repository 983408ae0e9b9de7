"""The report's charts.

Charts as inline SVG that takes its colours from the page, readable in light and dark.
"""

from __future__ import annotations

import io
import re
from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.ticker import FormatStrFormatter, LogLocator, MaxNLocator, NullLocator
from numpy.typing import NDArray

from baggie.geometry import FloatArray
from baggie.metrics import Rate, success_rate

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


Colors = Mapping[str, str]
"""One of `SERIES` for each policy, the same in every chart."""


def success_curves(distances_cm: Mapping[str, Sequence[float]], colors: Colors, radius_cm: float) -> str:
    """The share of objects within each distance of their goal, by policy, with its 95% band."""
    figure, axes = canvas(5.2, 4.2)
    reach = max(5.0, 1.5 * radius_cm)
    radii = np.linspace(0, reach, 201)
    for name, values in distances_cm.items():
        color = colors[name]
        rates = [success_rate(int(np.sum(np.asarray(values) <= radius)), len(values)) for radius in radii]
        low, high = ([100 * rate[bound] for rate in rates] for bound in ("low", "high"))
        axes.fill_between(radii, low, high, color=color, alpha=0.14, linewidth=0)
        axes.plot(radii, [100 * rate["rate"] for rate in rates], color=color, label=name)
    axes.axvline(radius_cm, color=MUTED, linewidth=1, linestyle=(0, (4, 3)))
    axes.set(xlabel="distance from the goal (cm)", ylabel="things within (%)", xlim=(0, reach), ylim=(0, 103))
    return svg(figure, axes)


def landings(offsets_cm: Mapping[str, FloatArray], colors: Colors, radius_cm: float) -> str:
    """Where objects came to lie around their goals, by policy: arrays `(N, 2)` of x and y, centimetres."""
    figure, axes = canvas(5.2, 4.2)
    reach = max(3.5, 1.6 * radius_cm)
    angle = np.linspace(0, 2 * np.pi, 181)
    for ring in (1.0, 2.0, 3.0):
        chosen = ring == radius_cm
        axes.plot(
            ring * np.cos(angle),
            ring * np.sin(angle),
            color=MUTED if chosen else GRID,
            linewidth=1.4 if chosen else 1,
            linestyle=(0, (4, 3)) if chosen else "-",
        )
        axes.annotate(f"{ring:g} cm", (0, ring), color=MUTED, ha="center", va="bottom", fontsize=8)
    for name, offsets in offsets_cm.items():
        # Robot frame seen from above as the robot sees it: x up, y to the left.
        outside = np.abs(offsets).max(axis=1) > reach
        label = f"{name} ({outside.sum()} outside)" if outside.any() else name
        axes.scatter(
            -offsets[~outside, 1],
            offsets[~outside, 0],
            s=26,
            color=colors[name],
            alpha=0.75,
            linewidth=0,
            label=label,
        )
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach), xticks=[], yticks=[], aspect="equal")
    axes.spines[:].set_visible(False)
    axes.grid(False)
    return svg(figure, axes)


def error_vectors(true: FloatArray, predicted: FloatArray, color: str, magnify: float) -> str:
    """Arrows from each true place to where it was predicted, `(N, 2)` metres each, `magnify` times longer."""
    figure, axes = canvas(4.6, 3.2)
    start, delta = 100 * true[:, ::-1], 100 * magnify * (predicted - true)[:, ::-1]
    axes.quiver(
        *start.T, *delta.T, color=color, angles="xy", scale_units="xy", scale=1, width=0.006, headwidth=4
    )
    axes.scatter(start[:, 0], start[:, 1], s=9, color=INK, linewidth=0, zorder=3)
    ends = np.vstack([start, start + delta])
    low, high = ends.min(axis=0) - 2, ends.max(axis=0) + 2
    axes.set(xlabel="y (cm), to the left", ylabel="x (cm), forward", aspect="equal")
    axes.set(xlim=(high[0], low[0]), ylim=(low[1], high[1]))
    return svg(figure, axes, legend=False)


def error_distribution(errors_cm: Mapping[str, Sequence[float]], colors: Colors) -> str:
    """The share of attempts with at most each error, by policy; the axis is logarithmic."""
    figure, axes = canvas()
    floor = 0.01
    top = max(max(values) for values in errors_cm.values())
    for name, values in errors_cm.items():
        x = np.sort(np.maximum(values, floor))
        share = 100 * np.arange(1, len(x) + 1) / len(x)
        axes.step(np.r_[x[0], x], np.r_[0, share], where="post", color=colors[name], label=name)
    axes.set(xscale="log", xlabel="error (cm)", ylabel="attempts within (%)", ylim=(0, 103))
    axes.set_xlim(right=1.15 * max(top, 2 * floor))
    _plain_decades(axes.xaxis)
    return svg(figure, axes)


def curves(lines: Mapping[str, tuple[NDArray[np.float64], NDArray[np.float64]]]) -> str:
    """Training curves: steps and values `(N,)` by name; logarithmic where all values are positive."""
    figure, axes = canvas()
    for color, (name, (steps, values)) in zip(cycle(SERIES), lines.items(), strict=False):
        axes.plot(steps, values, color=color, label=name, linewidth=1.6)
    positive = all((values > 0).all() for _, values in lines.values())
    axes.set(xlabel="step", yscale="log" if positive else "linear")
    if positive:
        _plain_decades(axes.yaxis)
    return svg(figure, axes)


def _plain_decades(axis: Axis) -> None:
    """Ticks at 1, 2 and 5 times powers of ten, written as people write them."""
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FormatStrFormatter("%g"))
    axis.set_minor_locator(NullLocator())


def success_bars(rates: Mapping[str, Sequence[Rate]], names: Sequence[str], colors: Colors) -> str:
    """Success by policy, a bar for each of the `names` of what counts, with 95% intervals; paler from bar to bar."""
    figure, axes = canvas()
    width = 0.8 / len(names)
    for place, (policy, found) in enumerate(rates.items()):
        for number, rate in enumerate(found):
            x = place + (number - (len(names) - 1) / 2) * width
            done, low, high = (100 * rate[bound] for bound in ("rate", "low", "high"))
            axes.bar(x, done, 0.92 * width, color=colors[policy], alpha=1 / (1 + number), linewidth=0)
            axes.vlines(x, low, high, color=INK, linewidth=1.2)
            axes.annotate(names[number], (x, 1.5), color=INK, ha="center", va="bottom", fontsize=8)
    axes.set(ylabel="episodes (%)", ylim=(0, 103), xlim=(-0.6, len(rates) - 0.4))
    axes.set_xticks(range(len(rates)), list(rates))
    return svg(figure, axes)


def credit_histogram(credits_: Mapping[str, Sequence[float]], colors: Colors) -> str:
    """How many episodes got how much of their task done, by policy, in tenths."""
    figure, axes = canvas()
    edges = np.linspace(0, 100, 11).tolist()
    axes.hist(
        [100 * np.asarray(values) for values in credits_.values()],
        edges,
        color=[colors[name] for name in credits_],
        label=list(credits_),
        rwidth=0.9,
    )
    axes.set(xlabel="partial credit (%)", ylabel="episodes", xlim=(0, 100))
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    return svg(figure, axes)
