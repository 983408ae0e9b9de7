"""The pages of the documentation, taken apart: blocks of commands, programs and files in their order, and prose.

What is indented by four spaces, or fenced as `sh`, is commands; `python` is a program; `yaml` a workcell file or a part
of one, whose first line may say of which name; `json` and `text` are only shown. A line `<!-- not run: REASON -->`
before a block says that it cannot be run here.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGES = [
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "examples/README.md")),
    *sorted((ROOT / "docs").glob("*.md")),
]
KINDS = ("sh", "python", "yaml", "json", "text")
_MARK = re.compile(r"<!-- not run: (.+) -->")


@dataclass(frozen=True)
class Block:
    """Something on a page that is not prose."""

    page: str
    line: int
    """Where it begins, counted from 1."""
    kind: str
    text: str
    not_run: str | None
    """Why it is not run, where the page says so."""

    def __str__(self) -> str:
        return f"{self.page}:{self.line}"

    def commands(self) -> list[str]:
        """One command each, without comments; what goes on after a backslash is one line."""
        lines = self.text.replace("\\\n", " ").splitlines()
        return [command for line in lines if (command := re.sub(r"(^|\s+)#.*$", "", line).strip())]

    def file(self) -> str | None:
        """The name that the first line of a workcell file gives it."""
        named = re.match(r"# (\S+\.yaml)\n", self.text)
        return named and named[1]


def blocks(page: Path, root: Path = ROOT) -> list[Block]:
    """Everything on a page of a checkout that is not prose, from top to bottom."""
    return [part for part in _parts(page, root) if isinstance(part, Block)]


def prose(page: Path, root: Path = ROOT) -> str:
    """The rest."""
    return "\n".join(part for part in _parts(page, root) if isinstance(part, str))


def _parts(page: Path, root: Path) -> Iterator[Block | str]:
    lines = page.read_text().splitlines()
    at, mark = 0, None
    while at < len(lines):
        line, start = lines[at], at
        at += 1
        fence = re.match(r"( *)```(\w*)$", line)
        if fence:
            at = next(n for n in range(at, len(lines)) if lines[n].strip() == "```") + 1
            inside, kind = lines[start + 1 : at - 1], fence[2]
        elif line.startswith("    ") and (start == 0 or not lines[start - 1].strip()):
            while at < len(lines) and (lines[at].startswith("    ") or not lines[at].strip()):
                at += 1
            inside, kind = lines[start:at], "sh"
        else:
            if mark is not None and line.strip():
                raise AssertionError(f"{page.name}, line {start + 1}: a block was expected after 'not run'")
            mark = _MARK.fullmatch(line.strip()) or mark
            yield line
            continue
        text = "\n".join(text.removeprefix("    " if fence is None else fence[1]) for text in inside).rstrip()
        yield Block(str(page.relative_to(root)), start + 1, kind, text + "\n", mark and mark[1])
        mark = None
