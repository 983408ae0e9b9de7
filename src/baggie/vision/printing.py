"""`baggie print-target`: targets and goal cards on paper, PDF files at true size, drawn as vectors.

Every page says in words what is on it and has a ruler to check the printer with. Coordinates in this file are
millimetres from the page's top left corner, x right and y down.
"""

from __future__ import annotations

from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyArrowPatch, PathPatch
from matplotlib.path import Path as Outline

from baggie.errors import BaggieError, UsageError
from baggie.files import write_bytes
from baggie.geometry import FloatArray
from baggie.options.commissioning import PrintOptions
from baggie.options.values import BOARD, CARD_COLOR, HAND_BOARD, HAND_MARKER, TABLE_MARKER, DrawnStyle
from baggie.vision.pattern import pattern
from baggie.vision.targets import ArucoMarker, Charuco, Chessboard, Target, parse_target

PAPERS = {"A4": (210.0, 297.0), "A3": (297.0, 420.0)}
"""Width and height upright, mm (ISO 216)."""
RULER_MM = 100
# Left free around a drawing: 7 mm that printers may leave white, and 6 mm for axes or cut marks; below it the text.
_MARGIN, _ASIDE, _FOOTER = 7.0, 6.0, 22.0
_LIGHT = "0.6"
_OUTLINE = 0.08  # thickness of an outlined card's line, of its side


@dataclass(frozen=True)
class _Page:
    figure: Figure
    axes: Axes
    corner: FloatArray
    """`(2,)`: top left corner of the drawing."""
    size: FloatArray
    """`(2,)`: its width and height."""


def print_target(target: Target, path: Path, paper: str = "A4") -> None:
    """Write a target as a PDF at true size, upright or lying as it fits.

    Raises `BaggieError` where it does not fit the paper and `WriteError` where the file cannot be written.
    """
    _save(draw_target(target, paper), path, target.spec)


def print_goal_card(
    path: Path,
    size_m: float = 0.13,
    color: tuple[int, int, int] = CARD_COLOR,
    paper: str = "A4",
    style: DrawnStyle = "solid",
) -> None:
    """Write a goal card, a square of one colour (RGB) with cut marks, as a PDF at true size.

    Raises `BaggieError` where it does not fit the paper and `WriteError` where the file cannot be written.
    """
    _save(draw_goal_card(size_m, color, paper, style), path, f"goal card {1000 * size_m:g} mm")


def draw_target(target: Target, paper: str = "A4") -> Figure:
    """The page that `print_target` writes."""
    drawing = pattern(target)
    name = target.spec + (", legacy layout" if isinstance(target, Charuco) and target.legacy else "")
    page = _page(1000 * drawing.size, paper, target.spec, name, _in_words(target))
    black = 1000 * (drawing.black - drawing.bounds[[0, 1, 0, 1]]) + page.corner[[0, 1, 0, 1]]
    page.axes.add_patch(_rectangles(black, "black"))
    _mark_axes(page, page.corner - 1000 * drawing.bounds[:2])
    return page.figure


def draw_goal_card(size_m: float, color: tuple[int, int, int], paper: str, style: DrawnStyle) -> Figure:
    """The page that `print_goal_card` writes."""
    if not 0 < size_m < 1 or any(not 0 <= value <= 255 for value in color):
        raise BaggieError(
            f"expected a goal card of 0..1 m and a colour of three numbers 0..255, got {size_m:g} m and {color}; "
            "sizes are in metres, colours RGB"
        )
    side = 1000 * size_m
    words = f"{style} square, RGB {color[0]} {color[1]} {color[2]}; cut along the marks"
    page = _page(
        np.array([side, side]), paper, f"a goal card of {side:g} mm", f"goal card {side:g} mm", words
    )
    left, top, right, bottom = *page.corner, *(page.corner + side)
    line = _OUTLINE * side
    solid = [[left, top, right, bottom]]
    frame = [
        [left, top, right, top + line],
        [left, bottom - line, right, bottom],
        [left, top + line, left + line, bottom - line],
        [right - line, top + line, right, bottom - line],
    ]
    squares = np.array(solid if style == "solid" else frame)
    page.axes.add_patch(_rectangles(squares, tuple(value / 255 for value in color)))
    near, far = 1.5, _ASIDE
    marks = [
        mark
        for x, out_x in ((left, -1), (right, 1))
        for y, out_y in ((top, -1), (bottom, 1))
        for mark in (
            [(x + out_x * near, y), (x + out_x * far, y)],
            [(x, y + out_y * near), (x, y + out_y * far)],
        )
    ]
    page.axes.add_collection(LineCollection(marks, colors="black", linewidths=0.5))
    return page.figure


def _page(size_mm: FloatArray, paper: str, what: str, name: str, words: str) -> _Page:
    """An empty page on which a drawing of this size will be centred, with everything else already on it."""
    if paper not in PAPERS:
        raise UsageError(f"expected paper {' or '.join(PAPERS)}, got {paper!r}")
    around = np.array([2 * (_MARGIN + _ASIDE), _MARGIN + _ASIDE + _FOOTER])
    sheet = _orientation(size_mm + around, paper)
    if sheet is None:
        larger = [name for name in PAPERS if _orientation(size_mm + around, name)]
        raise BaggieError(
            f"{what} is {size_mm[0]:.0f} x {size_mm[1]:.0f} mm and does not fit {paper} with its margins; "
            + (f"print it on {larger[0]}" if larger else "make it smaller, A3 is the largest paper")
        )
    width, height = sheet
    figure = Figure(figsize=(width / 25.4, height / 25.4))
    axes = figure.add_axes((0, 0, 1, 1), xlim=(0, width), ylim=(height, 0))
    axes.set_axis_off()
    _write_footer(axes, width, height, name, words)
    top = _MARGIN + _ASIDE
    return _Page(
        figure, axes, np.array([(width - size_mm[0]) / 2, (top + height - _FOOTER - size_mm[1]) / 2]), size_mm
    )


def _orientation(needed_mm: FloatArray, paper: str) -> tuple[float, float] | None:
    """Width and height of the paper as it is to lie; None where neither way is large enough."""
    upright = PAPERS[paper]
    lying = upright[::-1]
    ways = (lying, upright) if needed_mm[0] > needed_mm[1] else (upright, lying)
    return next((way for way in ways if (needed_mm <= np.array(way) + 1e-6).all()), None)


def _write_footer(axes: Axes, width: float, height: float, name: str, words: str) -> None:
    left, right, top = _MARGIN + _ASIDE, width - _MARGIN - _ASIDE, height - _FOOTER + 7.0
    axes.text(left, top, name, family="DejaVu Sans Mono", size=7, weight="bold", va="center")
    axes.text(left, top + 4.0, words, size=6.5, va="center")
    axes.text(left, top + 8.0, "Print at 100 %, then measure the ruler.", size=6.5, va="center", color="0.35")
    start = right - RULER_MM
    ticks = np.arange(RULER_MM + 1)
    lengths = np.where(ticks % 10 == 0, 3.5, np.where(ticks % 5 == 0, 2.5, 1.5))
    lines = [[(start + k, top), (start + k, top + length)] for k, length in zip(ticks, lengths, strict=True)]
    axes.add_collection(
        LineCollection([*lines, [(start, top), (right, top)]], colors="black", linewidths=0.4)
    )
    for k in range(0, RULER_MM + 1, 10):
        axes.text(
            start + k, top + 5.5, f"{k} mm" if k == RULER_MM else f"{k}", size=6, ha="center", va="center"
        )


def _mark_axes(page: _Page, origin: FloatArray) -> None:
    """Where the target's frame is: beside the pattern, light, from the level of its origin in the way of its axes."""
    gap, length = _ASIDE - 2.0, 15.0
    above, beside = page.corner - gap
    for start, end, label in (
        ((origin[0], beside), (origin[0] + length, beside), "x"),
        ((above, origin[1]), (above, origin[1] + length), "y"),
    ):
        arrow = FancyArrowPatch(
            start, end, arrowstyle="-|>", mutation_scale=5, linewidth=0.6, color=_LIGHT, shrinkA=0, shrinkB=0
        )
        page.axes.add_patch(arrow)
        page.axes.add_patch(Circle(start, 0.6, facecolor=_LIGHT, edgecolor="none"))
        shift = (2.0, 0.0) if label == "x" else (0.0, 2.2)
        page.axes.text(
            end[0] + shift[0], end[1] + shift[1], label, size=7, ha="center", va="center", color=_LIGHT
        )


def _rectangles(corners: FloatArray, color: str | tuple[float, ...]) -> PathPatch:
    """Rectangles `(N, 4)` as one path: drawn one by one, viewers show hairlines where they meet."""
    left, top, right, bottom = corners.T
    points = np.stack(
        [left, top, right, top, right, bottom, left, bottom, left, top], axis=1
    )  # (N, 5 points x 2)
    codes = [Outline.MOVETO, Outline.LINETO, Outline.LINETO, Outline.LINETO, Outline.CLOSEPOLY] * len(corners)
    return PathPatch(
        Outline(points.reshape(-1, 2), codes), facecolor=color, edgecolor="none", linewidth=0, snap=False
    )


def _in_words(target: Target) -> str:
    match target:
        case Charuco():
            return (
                f"{target.columns} x {target.rows} squares of {1000 * target.square_m:g} mm, "
                f"markers of {1000 * target.marker_m:g} mm"
            )
        case Chessboard():
            return f"{target.columns} x {target.rows} inner corners, squares of {1000 * target.square_m:g} mm"
        case ArucoMarker():
            return f"black square of {1000 * target.size_m:g} mm, marker {target.number}"
    return target.spec


def _save(figure: Figure, path: Path, title: str) -> None:
    content = BytesIO()
    with rc_context({"pdf.fonttype": 42}):
        # Without a date, the same target is the same file.
        figure.savefig(content, format="pdf", metadata={"Title": title, "CreationDate": None})
    write_bytes(path, content.getvalue())


NAMED = {
    "hand-marker": (HAND_MARKER, "A4"),
    "table-marker": (TABLE_MARKER, "A4"),
    "board": (BOARD, "A3"),
    "hand-board": (HAND_BOARD, "A4"),
}
"""The targets that the calibrations use unless told otherwise, and the paper that each fits."""
GOAL_CARD = "goal-card"


def print_to_pdf(options: PrintOptions) -> dict[str, Any]:
    """Write the PDF; where it is, and what to do with it.

    Raises `UsageError` for what is no target, paper or PDF, `BaggieError` for what fits no paper.
    """
    out = options.out or Path(f"{options.target.replace(':', '-')}.pdf")
    if out.suffix.lower() != ".pdf":
        raise UsageError(f"expected a file that ends in .pdf, got {out}")
    spec, paper = NAMED.get(options.target, (options.target, "A4"))
    paper = options.paper or paper
    if options.target == GOAL_CARD:
        spec = f"a square of {options.size * 1000:.0f} mm"
        print_goal_card(out, options.size, options.color, paper)
    else:
        print_target(_target(spec), out, paper)
    return {
        "pdf": str(out),
        "target": spec,
        "paper": paper,
        "next": "print at 100%, not fitted to the page; measure the ruler; glue it to something flat",
    }


def _target(spec: str) -> Target:
    try:
        return parse_target(spec)
    except BaggieError as error:
        raise UsageError(str(error)) from None
