"""The site that `make docs` makes: it has every page, the reference has what programs import, nothing is fetched."""

from __future__ import annotations

import ast
import os
import re
import runpy
import subprocess
import sys
from html.parser import HTMLParser
from importlib.util import find_spec
from pathlib import Path

import pytest

import baggie
from helpers.docs_pages import PAGES, ROOT, blocks

DOCS = ROOT / "docs"
CONF = runpy.run_path(str(DOCS / "conf.py"))
LADDER = sorted((ROOT / "examples").glob("[0-9][0-9]_*.py"))
DOCUMENTED = {
    name
    for page in (DOCS / "reference").glob("*.rst")
    for name in re.findall(r":: (baggie\S*)", page.read_text())
}


def listed(page: Path) -> set[Path]:
    """The pages in its tables of contents, without what they end in."""
    text = page.read_text()
    trees = re.findall(r"^:::\{toctree\}\n(.*?)^:::$|^\.\. toctree::\n(.*)", text, re.M | re.S)
    lines = [line.strip() for tree in trees for part in tree for line in part.splitlines()]
    names = [name for name in lines if name and not name.startswith(":")]
    return {
        path.with_suffix("")
        for name in names
        for path in page.parent.glob(f"{name}.*")
        if path.suffix != ".json"
    }


def test_every_page_is_in_a_table_of_contents() -> None:
    reached = {DOCS / "index"}
    for page in (DOCS / "index.md", DOCS / "reference" / "index.rst", DOCS / "results" / "index.rst"):
        reached |= listed(page)
    pages = [path for kind in ("md", "rst") for path in DOCS.rglob(f"*.{kind}")]
    assert {page.with_suffix("") for page in pages} <= reached


def test_the_reference_has_what_programs_import() -> None:
    texts = [program.read_text() for program in LADDER]
    texts += [block.text for page in PAGES for block in blocks(page) if block.kind == "python"]
    for text in texts:
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.ImportFrom) and str(node.module).startswith("baggie."):
                there = any(name == node.module or name.startswith(f"{node.module}.") for name in DOCUMENTED)
                assert there, f"{node.module}: add it to a page of docs/reference"


@pytest.mark.parametrize("module", sorted(DOCUMENTED))
def test_the_reference_is_of_modules_that_are_there(module: str) -> None:
    assert find_spec(module) is not None


def test_examples_are_sections_without_their_docstrings() -> None:
    text = CONF["examples"]()
    for program in LADDER:
        _, _, after = text.partition(f"({program.stem})=\n## {program.stem[:2]} ")
        first = re.search(r":lines: (\d+)-", after)
        assert first, program
        shown = program.read_text().splitlines()[int(first[1]) - 1 :]
        assert "\n".join(shown).strip().startswith("from __future__ import annotations")


def test_links_out_of_the_folder_lead_to_what_the_site_has_of_it() -> None:
    source = [
        "[`arm`](../src/baggie/robot/arm.py) [it](../examples/04_own_arm.py) [gone](../tests/helpers/synthetic.py) "
        "[page](cameras.md#here) [other](https://example.org/x.py)"
    ]
    CONF["on_site"](None, "own-arm", source)
    assert source == [
        "{py:mod}`arm <baggie.robot.arm>` [it](#04_own_arm) gone [page](cameras.md#here) "
        "[other](https://example.org/x.py)"
    ]


class Fetched(HTMLParser):
    """What a browser gets from elsewhere when it opens a page; a link is only followed by a person."""

    def __init__(self) -> None:
        super().__init__()
        self.addresses: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag != "a":
            self.addresses += [
                value
                for name, value in attrs
                if name in {"src", "srcset", "href", "data", "poster"}
                and value is not None
                and re.match(r"(https?:)?//", value)
            ]


@pytest.mark.slow
def test_the_site_is_built_without_a_warning_and_fetches_nothing(tmp_path: Path) -> None:
    pytest.importorskip("sphinx", reason="the site needs Sphinx: pip install --editable '.[docs]'")
    env = {**os.environ, "PYTHONPATH": str(Path(baggie.__file__).parents[1])}
    options = ["-b", "html", "-n", "-W", "--keep-going", "-d", str(tmp_path / "doctrees")]
    command = [sys.executable, "-m", "sphinx", *options, str(DOCS), str(tmp_path / "site")]
    done = subprocess.run(command, env=env, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-4000:]
    pages = list((tmp_path / "site").rglob("*.html"))
    assert len(pages) > len(list(DOCS.rglob("*.md")))
    for page in pages:
        fetched = Fetched()
        fetched.feed(page.read_text())
        assert not fetched.addresses, page
    for path in (tmp_path / "site").rglob("*.css"):
        assert not re.findall(r"(?:url\(|@import)[\"'\s]*(?:https?:)?//", path.read_text()), path
