"""What can be said about a workcell and its surroundings: its file, its check-up, the virtual lab, printed targets."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from annotated_types import Interval
from tyro.conf import Positional

from baggie.errors import UsageError
from baggie.options.choices import CARD_COLOR
from baggie.options.ranges import Color, NotNegative, Options, Port, Seed


@dataclass(frozen=True)
class NewWorkcellOptions:
    """Write a workcell file."""

    out: Positional[Path] = Path("cell.yaml")
    """Where to; a file that is there already is left as it is."""


@dataclass(frozen=True)
class ShowWorkcellOptions:
    """Show what a workcell file says."""

    file: Positional[Path]
    """The workcell file."""


@dataclass(frozen=True)
class DoctorOptions(Options):
    """Check a workcell."""

    workcell: Positional[str] = "sim"
    """A workcell file, or `sim`."""
    cell: Seed = 0
    """Number of the simulated workcell."""
    move: Literal["ask", "yes", "no"] = "ask"
    """Whether the arm may move, slowly, through the whole workspace: clear the table, and have the stop at hand. With
    `yes` nobody is asked for anything: what needs a person is not tried."""
    lab: str | None = None
    """Address of the virtual lab that the workcell is in, such as http://127.0.0.1:8090: it does what a person would
    have to."""


@dataclass(frozen=True)
class LabOptions(Options):
    """What is in the lab, and where it is reached."""

    cell: Seed = 0
    """Number of the simulated workcell: camera, lens, lights, table."""
    seed: Seed = 0
    """Of the scene: where the bag lies at first."""
    size: str = "1280x720"
    """Of the camera's pictures, pixels: WxH."""
    host: str = "127.0.0.1"
    """Address to listen at. The robot's ports there, 1337 and 1338, are given by its protocol; a second lab on the
    same computer takes another address, such as 127.0.0.2."""
    camera_port: Port = 8090
    """Port of the camera's stream and of the control channel; 0 for any that is free."""
    pace: NotNegative = 1.0
    """How many times as fast as real time it may go at most; 0: as fast as it can while the arm is at work."""
    fault: tuple[str, ...] = ()
    """What goes wrong: NAME, or NAME:AFTER with seconds of the lab's time; see docs/lab.md for the names."""
    out: Path | None = None
    """Where to write the workcell file, which is printed in any case."""

    def check(self) -> None:
        """Raise `UsageError` for what makes no lab."""
        self.faults()
        self.picture_size()

    def picture_size(self) -> tuple[int, int]:
        """`(width, height)` of the camera's pictures, pixels. Raises `UsageError` for what is none."""
        match = re.fullmatch(r"(\d{1,5})x(\d{1,5})", self.size)
        if not match:
            raise UsageError(f"expected --size WIDTHxHEIGHT, in pixels, got {self.size}; try 640x480")
        width, height = match.groups()
        return int(width), int(height)

    def faults(self) -> list[tuple[str, float]]:
        """Names of faults, and when they come. Raises `UsageError` for what is neither."""
        faults = []
        for words in self.fault:
            name, _, after = words.partition(":")
            try:
                after_s = float(after or 0)
            except ValueError:
                after_s = math.nan
            if not 0 <= after_s < math.inf:
                raise UsageError(
                    f"expected --fault NAME or NAME:SECONDS, of the lab's time, got {words}; try {name}:5"
                )
            faults.append((name, after_s))
        return faults


@dataclass(frozen=True)
class PrintOptions(Options):
    """What to print, and on what."""

    target: Positional[str] = "board"
    """board, hand-marker, table-marker, hand-board, goal-card, or a target in full such as
    charuco:7x5:0.030:0.021:DICT_4X4_50, chessboard:9x6:0.025 or aruco:DICT_4X4_50:3:0.10 (metres)."""
    out: Path | None = None
    """The PDF; TARGET.pdf unless given."""
    paper: str | None = None
    """A4 or A3; what the target was made for unless given."""
    size: Annotated[float, Interval(gt=0, le=1)] = 0.13
    """Side of a goal card, metres."""
    color: Color = CARD_COLOR
    """RGB of a goal card."""
