"""`baggie print-target`: targets and goal cards on paper, PDF files at true size, drawn as vectors.

Every page says in words what is on it and has a ruler to check the printer with. Coordinates in this file are
millimetres from the page's top left corner, x right and y down.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from reportlab.lib.units import mm
from reportlab.pdfgen.canvas import Canvas

from baggie.errors import BaggieError, UsageError
from baggie.files import write_bytes
from baggie.geometry import FloatArray
from baggie.options.commissioning import PrintOptions
from baggie.options.values import BOARD, CARD_COLOR, HAND_BOARD, HAND_MARKER, TABLE_MARKER, DrawnStyle
from baggie.vision.targets import ArucoMarker, Charuco, Chessboard, Target, parse_target, pattern

PAPERS = {"A4": (210.0, 297.0), "A3": (297.0, 420.0)}
"""Width and height upright, mm (ISO 216)."""
RULER_MM = 100
# Left free around a drawing: 7 mm that printers may leave white, and 6 mm for axes or cut marks; below it the text.
_MARGIN, _ASIDE, _FOOTER = 7.0, 6.0, 22.0
_LIGHT = 0.6
_POINT = 1 / mm  # in millimetres: thicknesses of lines and sizes of letters are usually told in points
_LETTERS = 7 * _POINT
_OUTLINE = 0.08  # thickness of an outlined card's line, of its side


def print_target(target: Target, path: Path, paper: str = "A4") -> None:
    """Write a target as a PDF at true size, upright or lying as it fits.

    Raises `BaggieError` where it does not fit the paper and `WriteError` where the file cannot be written.
    """
    write_bytes(path, draw_target(target, paper))


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
    write_bytes(path, draw_goal_card(size_m, color, paper, style))


def draw_target(target: Target, paper: str = "A4") -> bytes:
    """The PDF that `print_target` writes."""
    drawing = pattern(target)
    name = target.spec + (", legacy layout" if isinstance(target, Charuco) and target.legacy else "")
    page, corner = _page(1000 * drawing.size, paper, target.spec, name, _in_words(target))
    _fill(page, 1000 * (drawing.black - drawing.bounds[[0, 1, 0, 1]]) + corner[[0, 1, 0, 1]])
    _mark_axes(page, corner, corner - 1000 * drawing.bounds[:2])
    content: bytes = page.getpdfdata()
    return content


def draw_goal_card(size_m: float, color: tuple[int, int, int], paper: str, style: DrawnStyle) -> bytes:
    """The PDF that `print_goal_card` writes."""
    if not 0 < size_m < 1 or any(not 0 <= value <= 255 for value in color):
        raise BaggieError(
            f"expected a goal card of 0..1 m and a colour of three numbers 0..255, got {size_m:g} m and {color}; "
            "sizes are in metres, colours RGB"
        )
    side = 1000 * size_m
    words = f"{style} square, RGB {color[0]} {color[1]} {color[2]}; cut along the marks"
    page, corner = _page(
        np.array([side, side]), paper, f"a goal card of {side:g} mm", f"goal card {side:g} mm", words
    )
    left, top, right, bottom = *corner, *(corner + side)
    line = _OUTLINE * side
    solid = [[left, top, right, bottom]]
    frame = [
        [left, top, right, top + line],
        [left, bottom - line, right, bottom],
        [left, top + line, left + line, bottom - line],
        [right - line, top + line, right, bottom - line],
    ]
    page.setFillColorRGB(*(value / 255 for value in color))
    _fill(page, np.array(solid if style == "solid" else frame))
    near, far = 1.5, _ASIDE
    page.setLineWidth(0.5 * _POINT)
    for x, out_x in ((left, -1), (right, 1)):
        for y, out_y in ((top, -1), (bottom, 1)):
            page.line(x + out_x * near, y, x + out_x * far, y)
            page.line(x, y + out_y * near, x, y + out_y * far)
    content: bytes = page.getpdfdata()
    return content


def _page(size_mm: FloatArray, paper: str, what: str, name: str, words: str) -> tuple[Canvas, FloatArray]:
    """A page with everything on it but the drawing, and where that is centred: `(2,)` its top left corner."""
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
    # Invariant: without a date, the same target is the same file.
    page = Canvas("", pagesize=(width * mm, height * mm), bottomup=0, invariant=1)
    page.setTitle(name)
    page.scale(mm, mm)
    _write_footer(page, width, height, name, words)
    top = _MARGIN + _ASIDE
    return page, np.array([(width - size_mm[0]) / 2, (top + height - _FOOTER - size_mm[1]) / 2])


def _orientation(needed_mm: FloatArray, paper: str) -> tuple[float, float] | None:
    """Width and height of the paper as it is to lie; None where neither way is large enough."""
    upright = PAPERS[paper]
    lying = upright[::-1]
    ways = (lying, upright) if needed_mm[0] > needed_mm[1] else (upright, lying)
    return next((way for way in ways if (needed_mm <= np.array(way) + 1e-6).all()), None)


def _write_footer(page: Canvas, width: float, height: float, name: str, words: str) -> None:
    left, right, top = _MARGIN + _ASIDE, width - _MARGIN - _ASIDE, height - _FOOTER + 7.0
    _write(page, left, top, name, font="Courier-Bold")
    _write(page, left, top + 4.0, words)
    page.setFillGray(0.35)
    _write(page, left, top + 8.0, "Print at 100 %, then measure the ruler.")
    page.setFillGray(0)
    page.setLineWidth(0.4 * _POINT)
    start = right - RULER_MM
    page.line(start, top, right, top)
    for k in range(RULER_MM + 1):
        x = start + k
        page.line(x, top, x, top + (3.5 if k % 10 == 0 else 2.5 if k % 5 == 0 else 1.5))
        if k % 10 == 0:
            _write(page, x, top + 5.5, f"{k} mm" if k == RULER_MM else f"{k}", centred=True)


def _mark_axes(page: Canvas, corner: FloatArray, origin: FloatArray) -> None:
    """Where the target's frame is: beside the pattern, light, from the level of its origin in the way of its axes."""
    above, beside = corner - (_ASIDE - 2.0)
    page.setFillGray(_LIGHT)
    page.setStrokeGray(_LIGHT)
    page.setLineWidth(0.6 * _POINT)
    for label, (x, y), (right, down) in (
        ("x", (origin[0], beside), (1, 0)),
        ("y", (above, origin[1]), (0, 1)),
    ):
        page.circle(x, y, 0.6, stroke=0, fill=1)
        page.line(x, y, x + 14.5 * right, y + 14.5 * down)
        head = page.beginPath()
        head.moveTo(x + 15 * right, y + 15 * down)
        for aside in (-0.4, 0.4):
            head.lineTo(x + 14.2 * right + aside * down, y + 14.2 * down + aside * right)
        page.drawPath(head, stroke=0, fill=1)
        _write(page, x + 17.1 * right, y + 17.1 * down, label, centred=True)


def _write(
    page: Canvas, x: float, y: float, words: str, *, font: str = "Helvetica", centred: bool = False
) -> None:
    """Write words from x on, or about it, with the middle of their capitals at y."""
    page.setFont(font, _LETTERS)
    draw = page.drawCentredString if centred else page.drawString
    draw(x, y + 0.36 * _LETTERS, words)


def _fill(page: Canvas, corners: FloatArray) -> None:
    """Fill rectangles `(N, 4)` as one path: drawn one by one, viewers show hairlines where they meet."""
    path = page.beginPath()
    for left, top, right, bottom in corners:
        path.rect(left, top, right - left, bottom - top)
    page.drawPath(path, stroke=0, fill=1)


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
