"""What can be said about recordings: collecting one, looking into it, making one of somebody else's."""

from __future__ import annotations

import ast
import shlex
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, get_args

import tyro
from annotated_types import Interval
from tyro.conf import Positional

from baggie.errors import UsageError
from baggie.options.values import (
    USUAL_TASK,
    Bounds,
    CollectedScenery,
    CollectedStyle,
    Count,
    NotNegative,
    Options,
    Positive,
    Seed,
    Workers,
)
from baggie.registry import TASKS


def task_help() -> str:
    """What the help of `--task` says: every task's name and instruction."""
    lines = (f"{name}: {_instruction(name)}".removesuffix(": ") for name in TASKS.names())
    return "\n".join(("What is on the table and what counts as done.", *lines))


def _instruction(task: str) -> str:
    """The instruction as it stands in the task's source, as help must come at once; empty where it does not."""
    with suppress(ImportError, SyntaxError):  # somebody else's broken file is told of where it is imported
        for node in ast.walk(ast.parse(TASKS.source_of(task))):
            given = {each.arg: each.value for each in node.keywords} if isinstance(node, ast.Call) else {}
            match given.get("name"), given.get("instruction"):
                case ast.Constant(value=name), ast.Constant(value=str(instruction)) if name == task:
                    return instruction
    return ""


TaskName = Annotated[str, tyro.conf.arg(help=task_help())]


@dataclass(frozen=True)
class CollectOptions(Options):
    """What to collect, and where to."""

    out: Path
    """Folder of the recording. The same command again goes on where it stopped."""
    task: TaskName = USUAL_TASK
    """What is on the table and what counts as done."""
    attempts: Count = 300
    """How many there are to be in the end, failed ones included; where a script demonstrates, whole demonstrations."""
    seed: Seed = 0
    """Of scenes and places; the same seed gives the same attempts, whatever the number of workers."""
    cell: Seed = 0
    """Number of the simulated workcell."""
    scenery: CollectedScenery = "plain"
    """`varied`: every ten attempts another bag, table and light, and other things about; see `baggie.sim.variety`."""
    style: CollectedStyle = "plain"
    """Where a script demonstrates: things are picked by their middles and in a fixed order; or, `varied`, as others
    demonstrate with a cup: anywhere and in any order, and a step is wasted now and then.
    """
    workcell: Path | None = None
    """A workcell file instead; the map from the picture to the robot that it points to is used, if it does."""
    workers: Workers | None = None
    """Processes, each with a workcell of its own; as many as there are cores unless given, or one with a real arm."""
    wait: NotNegative = 0.0
    """On a real arm: how many minutes to wait for help where nobody is at the terminal to be asked for it."""

    def check(self) -> None:
        """Raise `UsageError` for what cannot be collected."""
        if self.task not in TASKS:
            raise UsageError(f"expected a task among {', '.join(TASKS.names())}, got {self.task!r}")
        for name, chosen, known in (
            ("scenery", self.scenery, get_args(CollectedScenery)),
            ("style", self.style, get_args(CollectedStyle)),
        ):
            if chosen not in known:
                raise UsageError(f"expected a {name} among {', '.join(known)}, got {chosen!r}")
        if self.scenery != "plain" and self.workcell is not None:
            raise UsageError(
                f"expected the scenery plain with --workcell, which says what the bag is, got {self.scenery!r}; "
                "leave one of them out"
            )
        if self.demonstrated and (self.scenery != "plain" or self.workcell is not None):
            raise UsageError(
                f"expected neither --scenery nor --workcell with --task {self.task}, which has a cell of its own; "
                "leave them out"
            )

        if not self.demonstrated and self.style != "plain":
            shown = [name for name, each in TASKS.all().items() if not each.has_goal and each.tool == "cup"]
            raise UsageError(
                f"expected no --style with --task {self.task}, which nobody demonstrates, got {self.style}; leave it "
                f"out, or take a task among {', '.join(shown)}"
            )
        if self.style != "plain" and TASKS[self.task].tool != "cup":
            raise UsageError(
                f"expected no --style with --task {self.task}, whose things a hand has to take by their middles, got "
                f"{self.style}; leave it out"
            )

    @property
    def demonstrated(self) -> bool:
        """Whether a script shows it, in several steps."""
        return not TASKS[self.task].has_goal

    @property
    def watched(self) -> bool:
        """Whether bumps are watched for: another table, or another lamp, is none."""
        return self.scenery == "plain"

    def command(self) -> str:
        """The command line that goes on with this collection."""
        words = ["baggie", "collect", "--task", self.task, "--attempts", str(self.attempts)]
        words += ["--seed", str(self.seed), "--cell", str(self.cell), "--out", str(self.out)]
        words += [] if self.scenery == "plain" else ["--scenery", self.scenery]
        words += [] if self.style == "plain" else ["--style", self.style]
        words += [] if self.workcell is None else ["--workcell", str(self.workcell)]
        words += [] if self.workers is None else ["--workers", str(self.workers)]
        words += [] if self.wait == 0 else ["--wait", f"{self.wait:g}"]
        return shlex.join(words)


@dataclass(frozen=True)
class InspectOptions(Options):
    """Which recording, and where to draw."""

    data: Positional[Path]
    """The recording's folder."""
    sheet: Path | None = None
    """Where to draw the pictures before and after every attempt; DATA/contact-sheet.png unless given, if that can be
    written."""
    columns: Annotated[int, Interval(ge=1, le=1000)] = 6
    """Attempts in a row of the contact sheet."""


@dataclass(frozen=True)
class ImportOptions(Options):
    """What to import, and where to."""

    folder: Positional[Path]
    """The folder of a task's demonstrations."""
    out: Path
    """Folder of the recording. The same command again goes on where it stopped."""
    task: str | None = None
    """The instruction in words; the folder's name unless given."""
    x: Bounds = (0.25, 0.75)
    """Bounds of the pictures in the robot's base frame, metres; x becomes the columns."""
    y: Bounds = (-0.5, 0.5)
    """The same; y becomes the rows."""
    z: Bounds = (0.0, 0.28)
    """The same; what is higher is not seen."""
    pixel_m: Positive = 0.003125
    """Size of a pixel, metres."""

    def command(self) -> str:
        """The command line that goes on with this import."""
        words = ["baggie", "import-ravens", str(self.folder), "--out", str(self.out)]
        words += [] if self.task is None else ["--task", self.task]
        for name in ("x", "y", "z"):
            bounds = getattr(self, name)
            words += [] if bounds == getattr(type(self), name) else [f"--{name}", *map(str, bounds)]
        words += [] if self.pixel_m == type(self).pixel_m else ["--pixel-m", str(self.pixel_m)]
        return shlex.join(words)
