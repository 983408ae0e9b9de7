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
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path

import pytest
import yaml

from helpers.docs_pages import PAGES, ROOT, Block, blocks
from helpers.docs_stand_ins import GIVEN, NIGHT, SHORT, Numbers, answers, stand_in, taken_for_granted

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


@dataclass(frozen=True)
class Given:
    """What somebody has who opens a page."""

    after: tuple[str, ...] = ()
    """Pages that were followed in the same folder."""
    cell: bool = False
    """A workcell file, of the lab."""
    lab: bool = False
    """A lab that runs."""
    files: Mapping[str, str] = field(default_factory=dict)
    """Others' files, by name."""
    recording: bool = False
    """Demonstrations of the Ravens benchmark."""


_MY_ARM = """\
import importlib
import sys

sys.path.append("examples")


def open_arm(port=""):
    return importlib.import_module("04_own_arm").open_arm()
"""
PAGE: Mapping[str, Given] = {
    "docs/collecting.md": Given(after=("README.md",), cell=True),
    "docs/policies.md": Given(after=("README.md",)),
    "docs/evaluating.md": Given(after=("docs/collecting.md", "docs/policies.md"), lab=True),
    "docs/deploying.md": Given(after=("README.md",)),
    "docs/cameras.md": Given(after=("README.md",), lab=True),
    "docs/own-arm.md": Given(lab=True, files={"my_lab/my_arm.py": _MY_ARM}),
    "docs/first-night.md": Given(lab=True),
    "docs/franka.md": Given(cell=True),
    "docs/workcell.md": Given(cell=True),
    "docs/ravens.md": Given(recording=True),
}
"""Of the other pages: nothing."""
TOGETHER = ("README.md", *(page for page, given in PAGE.items() if given.after))
ALONE = tuple(
    page
    for path in PAGES
    if (page := str(path.relative_to(ROOT))) not in {*TOGETHER, "docs/first-night.md"}
    and any(block.kind in {"sh", "python"} and block.not_run is None for block in blocks(path))
)
_RAVENS = """\
import sys
from pathlib import Path

from baggie.ravens.format import write_episode

sys.path.append("tests")
from helpers import ravens_scene

for number in range(3):
    write_episode(Path("stack-block-pyramid-train"), ravens_scene.episode(number, 9000 + 2 * number))
"""


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
        given = PAGE.get(page, Given())
        for earlier in given.after:
            if earlier not in self.followed:
                self.follow(earlier)
        self.followed.add(page)
        try:
            self._prepare(given)
            for block in blocks(self.folder / page, self.folder):
                if block.not_run is None:
                    self._do(block)
        finally:
            self.leave_lab()

    def _prepare(self, given: Given) -> None:
        if given.lab or given.cell:
            self.open_lab("baggie lab --out lab.yaml")
        if given.cell:
            shutil.copy(self.folder / "lab.yaml", self.folder / "cell.yaml")
        for name, text in given.files.items():
            (self.folder / name).parent.mkdir(exist_ok=True)
            (self.folder / name).write_text(text)
        if given.recording:
            self._call([str(self.python), "-c", _RAVENS], "")

    def _do(self, block: Block) -> None:
        if block.kind == "sh":
            self._type(block)
        elif block.kind == "python":
            self._run_program(block)
        elif block.kind == "yaml":
            self._write(block)

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


@pytest.mark.parametrize("page", TOGETHER)
def test_pages_that_go_on_from_each_other(reader: Reader, page: str) -> None:
    if page not in reader.followed:
        reader.follow(page)


@pytest.mark.parametrize("page", ALONE)
def test_pages_that_stand_alone(tmp_path: Path, python: Path, host: str, page: str) -> None:
    if page == "docs/lab.md" and shutil.which("curl") is None:
        pytest.skip("its commands need curl: apt-get install curl")
    Reader(tmp_path / "baggie", python, host, NIGHT).follow(page)
