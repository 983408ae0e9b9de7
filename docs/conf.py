"""The documentation as a site: the pages of this folder, the ladder of examples, and the docstrings. `make docs`."""

from __future__ import annotations

import ast
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sphinx.application import Sphinx

ROOT = Path(__file__).parents[1]

project = "Baggie"
html_title = "Baggie"
html_theme = "furo"
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.viewcode"]
html_copy_source = False
smartquotes = False  # quotes in docstrings are often code's

myst_enable_extensions = ["colon_fence"]
myst_heading_anchors = 4
highlight_language = "text"  # of indented blocks, which are commands

# Docstrings put code between single backticks, as Markdown does.
default_role = "code"
add_module_names = False
python_use_unqualified_type_names = True
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
autodoc_type_aliases = {"TaskName": "str"}  # what it says to the command line is no part of the type
autodoc_default_options = {"members": True}
nitpick_ignore_regex = [  # types in signatures: of other packages, or of what has no page
    ("py:class", ".*"),
    ("py:obj", r"typing\..*"),
]


def examples() -> str:
    """Every program of the ladder as a section: what its docstring says, then the program without it."""
    sections = []
    for program in sorted((ROOT / "examples").glob("[0-9][0-9]_*.py")):
        tree = ast.parse(program.read_text())
        title, _, text = (ast.get_docstring(tree) or "").partition("\n")
        sections.append(
            f"({program.stem})=\n## {program.stem[:2]} {title.rstrip('.')}\n{text}\n\n"
            f"```{{literalinclude}} ../examples/{program.name}\n:language: python\n"
            f":lines: {(tree.body[0].end_lineno or 0) + 1}-\n:caption: examples/{program.name}\n```\n"
        )
    return "\n".join(sections)


def on_site(app: Sphinx, page: str, source: list[str]) -> None:
    """What a page of this folder is on the site: links that lead out of it lead to what the site has of that."""
    folder = (ROOT / "docs" / page).parent

    def relinked(link: re.Match[str]) -> str:
        words, target = link[1], (folder / link[2]).resolve()
        if "://" in link[2] or target.is_relative_to(ROOT / "docs"):
            return link[0]
        path = str(target.relative_to(ROOT))
        if module := re.fullmatch(r"src/(baggie/[\w/]+)\.py", path):
            return f"{{py:mod}}`{words.strip('`')} <{module[1].replace('/', '.')}>`"
        if program := re.fullmatch(r"examples/(\d\d_\w+)\.py", path):
            return f"[{words}](#{program[1]})"
        return words  # in the checkout only

    source[0] = re.sub(r"\[([^]]+)\]\(([^)#\s]+)\)", relinked, source[0])
    if page == "examples":
        source[0] += "\n" + examples()


def with_arguments(*event: Any) -> None:
    """Make `Args:` of a docstring a list. Napoleon by itself would take every colon in an attribute's for a type."""
    from sphinx.ext.napoleon import GoogleDocstring  # noqa: PLC0415

    lines: list[str] = event[-1]
    if "Args:" in lines:
        lines[:] = GoogleDocstring(lines).lines()


def setup(app: Sphinx) -> None:
    """Sphinx calls it."""
    import baggie.workcell.config  # noqa: F401, PLC0415 -- autodoc adds to pydantic's classes: ours have to be made before

    app.connect("source-read", on_site)
    app.connect("autodoc-process-docstring", with_arguments)
