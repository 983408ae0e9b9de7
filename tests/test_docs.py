"""What pages say is there: links, files, modules, verbs and options, entries of workcell files."""

from __future__ import annotations

import ast
import importlib
import re
import shlex
from collections.abc import Iterator
from contextlib import redirect_stdout, suppress
from functools import cache
from io import StringIO
from pathlib import Path
from unittest.mock import MagicMock

import pytest
import yaml

from baggie.cli import main as cli
from baggie.cli.verbs import BAGGIE, Group
from baggie.options.training import TRAININGS
from baggie.workcell.workcell_file import BagEntry, HandlingEntry, read_workcell_file
from helpers.docs_pages import KINDS, PAGES, ROOT, Block, blocks, prose
from helpers.docs_stand_ins import GIVEN, taken_for_granted

RESULTS = sorted((ROOT / "docs" / "results").glob("*.md"))
BLOCKS = [block for page in PAGES for block in blocks(page)]
COMMANDS = [(block, command) for block in BLOCKS if block.kind == "sh" for command in block.commands()]
PROGRAMS = {
    "accelerate",
    "apt-get",
    "baggie",
    "curl",
    "lerobot-calibrate",
    "make",
    "pip",
    "printf",
    "python",
    "source",
    "sudo",
}
"""What stands at the beginning of a command."""


def of_kind(kind: str) -> list[Block]:
    return [block for block in BLOCKS if block.kind == kind]


@pytest.fixture
def idle(monkeypatch: pytest.MonkeyPatch) -> None:
    """Verbs read their words and do nothing."""
    monkeypatch.setattr(cli, "carry_out", MagicMock())


def understood(command: str) -> bool:
    """Whether `baggie` takes these words."""
    try:
        return cli.main(shlex.split(command)[1:]) == cli.DONE
    except SystemExit as stopped:
        return stopped.code == 0


@pytest.mark.parametrize("block", BLOCKS, ids=str)
def test_every_block_says_what_it_is(block: Block) -> None:
    assert block.kind in KINDS
    if block.kind == "sh":
        assert all(shlex.split(command)[0] in PROGRAMS for command in block.commands()), "shown only: ```text"


def test_a_page_is_taken_apart_as_it_reads(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(
        "words\n\n    baggie lab   # a comment\n    pip install \\\n        this\n\nmore\n\n"
        "<!-- not run: it is elsewhere -->\n\n```python\nx = 1\n```\n\n```yaml\n# cell.yaml\narm: sim\n```\n"
    )
    commands, program, file = blocks(page, tmp_path)
    assert commands.commands() == ["baggie lab", "pip install      this"]
    assert (program.kind, program.text, program.not_run, program.line) == (
        "python",
        "x = 1\n",
        "it is elsewhere",
        11,
    )
    assert (file.file(), file.not_run) == ("cell.yaml", None)
    assert prose(page, tmp_path).split() == [
        "words",
        "more",
        "<!--",
        "not",
        "run:",
        "it",
        "is",
        "elsewhere",
        "-->",
    ]
    page.write_text("<!-- not run: why -->\n\nwords\n\n    baggie lab\n")
    with pytest.raises(AssertionError, match="line 3"):
        blocks(page, tmp_path)


@pytest.mark.usefixtures("idle")
@pytest.mark.parametrize(
    ("block", "command"),
    [(block, command) for block, command in COMMANDS if command.startswith("baggie ")],
    ids=str,
)
def test_commands_are_understood(block: Block, command: str) -> None:
    assert understood(command), f"{block}: {command}"


@pytest.mark.usefixtures("idle")
def test_what_is_no_command_is_not_understood() -> None:
    assert understood("baggie inspect data")
    assert not understood("baggie inspect data --colums 3")
    assert not understood("baggie dance")


@cache
def help_of(verb: str) -> str:
    """Of a verb, and of what it consists of."""
    said = StringIO()
    with redirect_stdout(said), suppress(SystemExit):
        cli.main([*verb.split(), "--help"])
    told = BAGGIE.verbs.get(verb)
    parts = [f"{verb} {name}" for name in told.verbs] if isinstance(told, Group) else []
    parts += [f"train --policy {name}" for name in TRAININGS.names()] if verb == "train" else []
    return said.getvalue() + "".join(help_of(part) for part in parts)


def inline(page: Path) -> Iterator[str]:
    """What stands between backticks in the prose, line breaks as spaces."""
    for paragraph in re.split(r"\n\s*\n", prose(page)):
        yield from (" ".join(code.split()) for code in re.findall(r"`([^`]+)`", paragraph))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_verbs_and_options_in_the_text_are_there(page: Path) -> None:
    known = set(re.findall(r"--[a-z][a-z-]*", "".join(help_of(verb) for verb in BAGGIE.verbs)))
    for code in inline(page):
        words = code.split()
        if words[0] == "baggie" and len(words) > 1 and re.fullmatch(r"[a-z-]+", words[1]):
            assert words[1] in BAGGIE.verbs, code
            options = {word for word in words if word.startswith("--")}
            assert options <= set(re.findall(r"--[a-z][a-z-]*", help_of(words[1]))), code
        elif words[0].startswith("--"):
            assert words[0] in known, code


@pytest.mark.parametrize("page", [*PAGES, *RESULTS], ids=lambda page: page.name)
def test_links_lead_somewhere(page: Path) -> None:
    text = prose(page) if page in PAGES else page.read_text()
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if "://" in target:
            continue
        name, _, anchor = target.partition("#")
        linked = (page.parent / name).resolve() if name else page
        assert linked.exists(), target
        if anchor:
            assert anchor in headings(linked), target


def headings(page: Path) -> set[str]:
    """The anchors of a page, as GitHub names them."""
    titles = re.findall(r"^#+ (.+)$", page.read_text(), re.M)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_files_named_in_the_text_are_there(page: Path) -> None:
    roots = (ROOT, ROOT / "src" / "baggie", ROOT / "src", page.parent)
    for code in inline(page):
        if re.fullmatch(r"[\w.-]+(/[\w.-]+)*/[\w-]+\.(py|md)", code):
            assert any((root / code).exists() for root in roots), code


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_tests_named_in_the_text_are_there(page: Path) -> None:
    for code in inline(page):
        if re.fullmatch(r"test_\w+\.py::\w+", code):
            file, _, test = code.partition("::")
            assert f"def {test}(" in (ROOT / "tests" / file).read_text(), code


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_python_names_in_the_text_are_there(page: Path) -> None:
    for code in inline(page):
        if re.fullmatch(r"baggie(\.\w+)+", code):
            assert find(code) is not None, code


def find(dotted: str) -> object:
    """A module, or what is in one. Raises `ImportError` or `AttributeError`."""
    try:
        return importlib.import_module(dotted)
    except ModuleNotFoundError:
        module, _, name = dotted.rpartition(".")
        return getattr(find(module), name)


@pytest.mark.parametrize("block", of_kind("python"), ids=str)
def test_programs_import_what_is_there_and_take_little_for_granted(block: Block) -> None:
    tree = ast.parse(block.text)
    for node in tree.body:
        if isinstance(node, ast.ImportFrom) and str(node.module).startswith("baggie"):
            for name in node.names:
                assert find(f"{node.module}.{name.name}") is not None
    assert taken_for_granted(block.text) <= set(GIVEN)


@pytest.mark.parametrize("block", of_kind("yaml"), ids=str)
def test_workcell_files_are_read(block: Block, tmp_path: Path) -> None:
    """Alone, or where only a part is shown, of a simulated or a Franka's workcell."""
    content = yaml.safe_load(block.text)
    camera = "camera" in content
    arm = {"arm": {"kind": "franka", "host": "robot"}, "camera": 0} if camera else {"arm": "sim"}
    path = tmp_path / "cell.yaml"
    path.write_text(yaml.safe_dump(arm | content))
    read_workcell_file(path)


def test_every_entry_of_handling_is_explained() -> None:
    page = (ROOT / "docs" / "handling.md").read_text()
    for entry in (*HandlingEntry.model_fields, *BagEntry.model_fields):
        assert re.search(rf"^\| [^|]*`{entry}`[^|]*\| \S", page, re.M), entry
