"""`baggie print-target`: the targets the calibrations use unless told otherwise, as PDFs at true size.

The world's frame, as a person sees it on a target that lies on the table.

Its origin is the lowest left point of the print, x runs right along the print, y up it, z out of the paper.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from baggie.errors import BaggieError, UsageError
from baggie.geometry import FloatArray, rigid, transform_points
from baggie.options.commissioning import PrintOptions
from baggie.options.values import BOARD, HAND_BOARD, HAND_MARKER, TABLE_MARKER
from baggie.vision.printing import print_goal_card, print_target
from baggie.vision.targets import Target, parse_target

NAMED = {
    "hand-marker": (HAND_MARKER, "A4"),
    "table-marker": (TABLE_MARKER, "A4"),
    "board": (BOARD, "A3"),
    "hand-board": (HAND_BOARD, "A4"),
}
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


def T_world_target(target: Target) -> FloatArray:
    """`(4, 4)`: the target's own frame (y down the print, z into the paper) in the world's."""
    rotation = np.diag([1.0, -1.0, -1.0])
    low_left = np.array([target.points[:, 0].min(), target.points[:, 1].max(), 0.0])
    return rigid(rotation, -rotation @ low_left)


def points_to_touch(target: Target, axes_only: bool) -> list[tuple[str, FloatArray]]:
    """Points of a target worth touching, with words for where each is: `(3,)` metres, world frame.

    The origin, the far ends of the x axis and of the y axis; unless `axes_only`, the opposite corner and, of a board,
    the middle of each side as well: then a wrong touch shows, and the others make up for one another. Of a board that
    sags, these are not in the plane of the corners.
    """
    points = transform_points(T_world_target(target), target.points)
    width, height = points[:, 0].max(), points[:, 1].max()
    corner = "corner of the black square" if len(points) == 4 else "inner corner"
    wanted = [
        (f"the world's origin: the lower left {corner}", (0.0, 0.0, 0.0)),
        (f"a point on the x axis: the lower right {corner}", (width, 0.0, 0.0)),
        (f"a point on the y axis: the upper left {corner}", (0.0, height, 0.0)),
    ]
    if not axes_only:
        wanted.append((f"the upper right {corner}", (width, height, 0.0)))
    if not axes_only and len(points) > 4:
        middles = {
            "lower": (width / 2, 0.0),
            "right": (width, height / 2),
            "upper": (width / 2, height),
            "left": (0.0, height / 2),
        }
        for side, middle in middles.items():
            x, y, z = points[np.argmin(np.linalg.norm(points[:, :2] - middle, axis=1))]
            wanted.append(
                (f"the {corner} on the {side} side at {1000 * x:.0f}, {1000 * y:.0f} mm", (x, y, z))
            )
    return [(words, np.array(point)) for words, point in wanted]
