"""`baggie report`: one page, complete in itself, that shows how good a policy is and how it was measured."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro
from jinja2 import Environment, PackageLoader, StrictUndefined

from baggie.evaluation.report_data import gather
from baggie.evaluation.report_sections import content
from baggie.files import write_text


@dataclass(frozen=True)
class ReportOptions:
    """Put everything that is known about some runs on one self-contained page.

    Example: baggie report runs/keypoint runs/color-mask --out report.html
    """

    runs: tyro.conf.Positional[tuple[Path, ...]]
    """Folders that train, validate or evaluate wrote, or folders of such."""
    out: Path = Path("report.html")
    """The page."""
    title: str | None = None
    """Its heading; by default what it is about."""


def report(options: ReportOptions) -> Path:
    """Write the page and return its path.

    Raises `BaggieError` when the folders hold no results, `DataError` when results are broken.
    """
    loader = PackageLoader("baggie.evaluation", ".")
    page = Environment(loader=loader, autoescape=True, undefined=StrictUndefined).get_template(
        "report.html.j2"
    )
    variables = content(gather(options.runs))
    if options.title is not None:
        variables["title"] = options.title
    write_text(options.out, page.render(variables))
    return options.out
