"""What a collection came to: counts, and its coverage of the workspace as a picture."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from baggie.data import Dataset
from baggie.geometry import FloatArray, Rectangle
from baggie.pictures import write_figure

_CELL_M = 0.05


def summarize(dataset: Dataset, area: Rectangle) -> dict[str, Any]:
    """Counts by cause, and how much of `area` was reached, ready for JSON.

    `coverage` is the fraction of squares of 5 cm in which the object was successfully picked up or put down.
    """
    numbers = dataset.numbers()
    succeeded = numbers["success"]
    failed = Counter(failure for failure in dataset.failures if failure is not None)
    executed = numbers["executed"][succeeded]
    return {
        "attempts": len(dataset),
        "succeeded": int(succeeded.sum()),
        "failed": dict(failed.most_common()),
        "grasped_at_first_try": int((succeeded & (numbers["tries"] == 1)).sum()),
        "coverage": coverage(np.concatenate([executed[:, 0:2], executed[:, 3:5]]), area),
    }


def coverage(points: FloatArray, area: Rectangle) -> float:
    """The fraction of 5 cm squares of `area` with at least one of `points` `(N, 2)` in it."""
    shape = (
        max(round((area.x_max - area.x_min) / _CELL_M), 1),
        max(round((area.y_max - area.y_min) / _CELL_M), 1),
    )
    span = [(area.x_min, area.x_max), (area.y_min, area.y_max)]
    counts, _, _ = np.histogram2d(points[:, 0], points[:, 1], bins=shape, range=span)
    return float((counts > 0).mean())


def draw_coverage(dataset: Dataset, area: Rectangle, path: Path) -> None:
    """Save a picture of all picks and places over the workspace, seen from above, the robot at the bottom.

    Raises `WriteError`.
    """
    from matplotlib.figure import Figure  # noqa: PLC0415 -- worker processes start without it
    from matplotlib.patches import Rectangle as Patch  # noqa: PLC0415

    numbers = dataset.numbers()
    executed, succeeded = numbers["executed"], numbers["success"]
    figure = Figure(figsize=(7.5, 5.0), layout="constrained")
    axes = figure.subplots()
    size = (area.y_max - area.y_min, area.x_max - area.x_min)
    axes.add_patch(Patch((area.y_min, area.x_min), *size, fill=False, color="0.4", linestyle="--"))
    good, bad = executed[succeeded], executed[~succeeded]
    axes.scatter(good[:, 1], good[:, 0], s=14, color="tab:blue", label="picked up")
    axes.scatter(good[:, 4], good[:, 3], s=14, color="tab:green", marker="s", label="put down")
    axes.scatter(
        bad[:, 1], bad[:, 0], s=40, color="tab:red", marker="x", label="failed (where it was gripped)"
    )
    axes.invert_xaxis()  # y points left when x points away
    axes.set(aspect="equal", xlabel="y, left of the robot (m)", ylabel="x, in front of the robot (m)")
    axes.set_title(f"{len(dataset)} attempts, {int(succeeded.sum())} succeeded")
    figure.legend(loc="outside lower center", ncols=3, frameon=False)
    write_figure(path, figure)
