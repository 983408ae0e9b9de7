"""A hand-eye calibration as a picture: which views are off by how much, and how the methods compare."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from baggie.calibration.hand_eye.result import HandEye
from baggie.vision.picture_files import write_figure

_FULL = 4.0
"""Bars end at this many times the best method's error; the number beside one says the rest."""


def draw_views(result: HandEye, path: Path) -> None:
    """Save each view's error when left out, with the dropped ones marked, above every method's mean.

    Raises `WriteError`.
    """
    from matplotlib.figure import Figure  # noqa: PLC0415 -- worker processes start without it

    names = [name for name, _ in (*result.views, *result.dropped)]
    errors = [error for _, error in result.views] + [0.0] * len(result.dropped)
    dropped = np.arange(len(names)) >= len(result.views)
    order = sorted(range(len(names)), key=lambda i: _in_order(names[i]))
    places = np.arange(len(names))
    figure = Figure(figsize=(7.5, 6.5), layout="constrained")
    above, below = figure.subplots(2, 1)
    gone = dropped[order]
    above.bar(
        places[~gone], np.array(errors)[order][~gone], color="tab:blue", label="left out, against the others"
    )
    above.axhline(
        result.leave_one_out_mm, color="0.4", linestyle="--", label=f"mean {result.leave_one_out_mm:.2f} mm"
    )
    above.scatter(
        places[gone],
        np.zeros(gone.sum()),
        s=40,
        color="tab:red",
        marker="x",
        clip_on=False,
        label="dropped: take again",
    )
    above.set_xticks(places, [names[i] for i in order], rotation=90, fontsize=7)
    above.set_ylabel("error of the view (mm)")
    above.set_title(f"{len(result.views)} views kept, {len(result.dropped)} dropped, by {result.method}")
    above.legend(frameon=False, fontsize=8)

    methods = sorted(result.methods, key=lambda name: result.methods[name].leave_one_out_mm)
    means = np.array([result.methods[name].leave_one_out_mm for name in methods])
    end = _FULL * max(result.leave_one_out_mm, 1e-6)
    below.barh(
        methods, np.minimum(means, end), color=["tab:green" if m == result.method else "0.7" for m in methods]
    )
    for row, mean in enumerate(means):
        below.text(min(mean, end), row, f" {mean:.2f}", va="center", fontsize=8)
    below.set_xlim(0, 1.1 * end)
    below.invert_yaxis()
    below.set_xlabel("mean error of views left out (mm)")
    write_figure(path, figure)


def _in_order(name: str) -> list[tuple[int, str]]:
    """Sorts "view 9" before "view 10"."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", name)]
