"""The pages are run as they stand, from top to bottom, by a reader who has Baggie from its wheel and no robot.

What cannot be had here is in the table of `docs_stand_ins.py`. What cannot be run says so on its page.
"""

from __future__ import annotations

import os
import pty
import re
import shutil
import signal
import subprocess
import sys
import sysconfig
import venv
from dataclasses import asdict
from pathlib import Path

import pytest
import yaml

from docs_pages import PAGES, ROOT, Block, blocks
from docs_stand_ins import GIVEN, NIGHT, SHORT, Numbers, answers, stand_in, taken_for_granted

pytestmark = pytest.mark.slow
pytest.importorskip(
    "franky", reason="a real arm's pages need franky-control: pip install 'franky-control>=2,<3'"
)

MINUTES = 20
"""No command of a page may take longer."""
CHECKOUT = (
    "benchmarks",
    "constraints.txt",
    "docs",
    "examples",
    "LICENSE",
    "pyproject.toml",
    "README.md",
    "src",
    "tests",
)
AFTER = {
    "docs/collecting.md": "README.md",
    "docs/policies.md": "README.md",
    "docs/evaluating.md": "docs/policies.md docs/collecting.md",
    "docs/deploying.md": "README.md",
    "docs/cameras.md": "README.md",
    "docs/own-arm.md": "README.md",
}
"""What has to be followed first, in the same folder; other pages begin from nothing."""
HAS_CELL = {"docs/collecting.md", "docs/franka.md", "docs/workcell.md"}
"""Pages whose reader has a workcell file."""


@pytest.fixture(scope="module")
def python(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An environment that has everything this one has, but Baggie from its wheel."""
    folder = tmp_path_factory.mktemp("installed")
    checkout(folder / "checkout")
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", str(folder)]
    subprocess.run([*command, str(folder / "checkout")], check=True, env=clean())
    (wheel,) = folder.glob("baggie-*.whl")
    venv.create(folder / "venv", with_pip=False)
    python = folder / "venv" / "bin" / "python"
    packages = folder / "packages"
    packages.mkdir()
    for path in Path(sysconfig.get_path("purelib")).iterdir():
        if not re.match(r"(__editable__.*)?baggie\b|__pycache__", path.name):
            (packages / path.name).symlink_to(path)
    own = subprocess.run(
        [python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"],
        capture_output=True,
        text=True,
        check=True,
    )
    Path(own.stdout.strip(), "packages.pth").write_text(f"import site; site.addsitedir({str(packages)!r})\n")
    pip = python.with_name("pip")
    pip.write_text(f'#!/bin/sh\nexec {python} -m pip "$@"\n')
    pip.chmod(0o755)
    subprocess.run([pip, "install", "--quiet", "--no-deps", wheel], check=True, env=clean())
    return python


def checkout(folder: Path) -> None:
    """A copy of what is in the checkout, and nothing that was built there."""
    folder.mkdir()
    for name in CHECKOUT:
        path = ROOT / name
        if path.is_dir():
            shutil.copytree(path, folder / name, ignore=shutil.ignore_patterns("__pycache__", "*.egg-info"))
        else:
            shutil.copy(path, folder / name)


def clean(**more: str) -> dict[str, str]:
    """The environment variables without those that would bring the checkout's own sources back."""
    return {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")} | more


class Reader:
    """Follows pages in one folder, a copy of the checkout."""

    def __init__(self, folder: Path, python: Path, host: str, numbers: Numbers) -> None:
        self.folder, self.python = folder, python
        self.facts = {**asdict(numbers), "host": host, "lab": f"{host}:8090"}
        self.followed: set[str] = set()
        self._lab: subprocess.Popen[str] | None = None
        path = os.pathsep.join([str(python.parent), sysconfig.get_path("scripts"), os.environ["PATH"]])
        self._environment = clean(PATH=path, VIRTUAL_ENV=str(python.parents[1]))
        checkout(folder)

    def follow(self, page: str) -> None:
        """Everything on it that can be run, and before that what it takes for granted."""
        for earlier in AFTER.get(page, "").split():
            if earlier not in self.followed:
                self.follow(earlier)
        self.followed.add(page)
        self.prepare(page)
        try:
            for block in blocks(ROOT / page):
                if block.not_run is None:
                    {"sh": self._type, "python": self._run_program, "yaml": self._write}.get(
                        block.kind, lambda block: None
                    )(block)
        finally:
            self.leave_lab()

    def prepare(self, page: str) -> None:
        """What somebody who opens the page has."""
        if page in HAS_CELL | {
            "docs/first-night.md",
            "docs/cameras.md",
            "docs/own-arm.md",
            "docs/evaluating.md",
        }:
            self.open_lab("baggie lab --out lab.yaml")
        if page in HAS_CELL:
            shutil.copy(self.folder / "lab.yaml", self.folder / "cell.yaml")
        if page == "docs/own-arm.md":
            (self.folder / "my_lab").mkdir()
            arm = (self.folder / "examples" / "own_arm.py").read_text()
            (self.folder / "my_lab" / "my_arm.py").write_text(
                arm.replace("reach_m: float = 0.85", 'port: str = ""').replace("reach_m)", "0.85)")
            )
        if page == "docs/ravens.md":
            make = (
                "import sys; sys.path.append('tests'); import ravens_scene; from pathlib import Path; "
                "from baggie.data.ravens import write_episode\n"
                "for n in range(3): write_episode(Path('stack-block-pyramid-train'), ravens_scene.episode(n, 9000 + n))"
            )
            self._call([str(self.python), "-c", make], "")

    def open_lab(self, command: str) -> None:
        """In another terminal, until the page ends."""
        self.leave_lab()
        words = stand_in(command, "", self.facts).split()
        self._lab = subprocess.Popen(
            words, cwd=self.folder, env=self._environment, stdout=subprocess.PIPE, text=True
        )
        assert self._lab.stdout is not None
        assert self._lab.stdout.readline().startswith("# The virtual lab")
        color = yaml.safe_load((self.folder / "lab.yaml").read_text())["bag"]["color"]
        self.facts["color"] = " ".join(str(value) for value in color)

    def leave_lab(self) -> None:
        if self._lab is not None:
            self._lab.send_signal(signal.SIGINT)
            self._lab.wait(60)
            self._lab = None

    def _type(self, block: Block) -> None:
        """The commands of a block, one after the other in one shell; a lab in another."""
        script, typed = [], ""
        for command in block.commands():
            if command.startswith("baggie lab"):
                self.open_lab(command)
                continue
            script.append(stand_in(command, block.page, self.facts))
            typed += answers(command, self.facts)
        self._call(["bash", "-euxo", "pipefail", "-c", "\n".join(script)], typed, block)

    def _run_program(self, block: Block) -> None:
        """With what it takes for granted, and what it defines as tests called."""
        given = [GIVEN[name] for name in sorted(taken_for_granted(block.text))]
        lines = [stand_in(line, block.page, self.facts) for line in block.text.splitlines()]
        tests = [f"{name}()" for name in re.findall(r"^def (test_\w+)\(\)", block.text, re.M)]
        program = self.folder / "program.py"
        program.write_text("\n".join([*given, *lines, *tests]))
        self._call([str(self.python), str(program)], "", block)

    def _write(self, block: Block) -> None:
        """Into the file that it names, below what stands there; a part that names none is only read."""
        name = block.file()
        if name is not None:
            with (self.folder / name).open("a") as file:
                file.write(block.text)

    def _call(self, command: list[str], typed: str, block: Block | None = None) -> None:
        """Run it at a terminal, where this is typed."""
        terminal, keyboard = pty.openpty()
        os.write(terminal, typed.encode())
        try:
            done = subprocess.run(
                command,
                cwd=self.folder,
                env=self._environment,
                stdin=keyboard,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                timeout=60 * MINUTES,
                check=False,
            )
        finally:
            os.close(terminal)
            os.close(keyboard)
        print(done.stdout)
        assert done.returncode == 0, f"{block}: {command[-1]}\n{done.stdout[-4000:]}"


@pytest.fixture(scope="module")
def host() -> str:
    return f"127.2.{os.getpid() % 250}.{os.getpid() // 250 % 250 + 1}"


@pytest.fixture(scope="module")
def reader(tmp_path_factory: pytest.TempPathFactory, python: Path, host: str) -> Reader:
    """Who goes on from page to page."""
    return Reader(tmp_path_factory.mktemp("reader") / "baggie", python, host, NIGHT)


@pytest.mark.parametrize("numbers", [pytest.param(SHORT, id="short"), pytest.param(NIGHT, id="night")])
def test_the_first_night(tmp_path: Path, python: Path, host: str, numbers: Numbers) -> None:
    reader = Reader(tmp_path / "baggie", python, host, numbers)
    reader.follow("docs/first-night.md")
    assert (reader.folder / "report.html").stat().st_size > 100_000


TOGETHER = ["README.md", *AFTER]


@pytest.mark.parametrize("page", TOGETHER)
def test_pages_that_go_on_from_each_other(reader: Reader, page: str) -> None:
    if page not in reader.followed:
        reader.follow(page)


@pytest.mark.parametrize(
    "page",
    [
        page
        for path in PAGES
        if (page := str(path.relative_to(ROOT))) not in {*TOGETHER, "docs/first-night.md"}
        and any(block.kind in {"sh", "python"} for block in blocks(path))
    ],
)
def test_pages_that_stand_alone(tmp_path: Path, python: Path, host: str, page: str) -> None:
    Reader(tmp_path / "baggie", python, host, NIGHT).follow(page)
