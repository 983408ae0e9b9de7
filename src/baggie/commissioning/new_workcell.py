"""`baggie workcell new`: asks a person about their workcell, and writes the file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import tyro
import yaml

from baggie.commissioning.new_arm import ARMS, NewArm, ask_factory
from baggie.commissioning.questions import Questions, bounds, color, entry, one_of, several, spaced
from baggie.errors import BaggieError
from baggie.files import write_text
from baggie.workcell.bag_entry import Bag
from baggie.workcell.cameras.opencv import is_live
from baggie.workcell.cameras.settings import Kind
from baggie.workcell.workcell_file import read_workcell_file

_NEXT = """\
# A workcell. What stands here and what else may: docs/workcell.md.
# Check it, first without moving anything: baggie doctor {name}
"""


@dataclass(frozen=True)
class NewWorkcellOptions:
    """Write a workcell file."""

    out: tyro.conf.Positional[Path] = Path("cell.yaml")
    """Where to; a file that is there already is left as it is."""


def new_workcell(options: NewWorkcellOptions, ask: Callable[[str], str] | None = None) -> dict[str, Any]:
    """Ask, write, and read it back. Raises `BaggieError` where there is a file already, or nobody answers.

    `ask` prints a prompt and returns the answer; the terminal unless given.
    """
    if options.out.exists():
        raise BaggieError(f"{options.out} is there already; edit it, or give another --out")
    content = _content(Questions(ask), options.out.parent)
    header = _NEXT.format(name=options.out)
    text = header + yaml.safe_dump(content, sort_keys=False, default_flow_style=None)
    write_text(options.out, text)
    read_workcell_file(options.out)
    return {"workcell": str(options.out), "next": f"baggie doctor {options.out}"}


def _content(questions: Questions, folder: Path) -> dict[str, Any]:
    words = "which arm: franka; lerobot, a robot that LeRobot drives; python, one of your own; replay, a recording; sim"
    kind = questions.ask(words, "franka", one_of(*ARMS))
    arm: NewArm = ARMS[kind](questions, folder)
    content: dict[str, Any] = {"arm": {"kind": kind, **arm.entry}}
    if arm.real:
        content["camera"] = _camera(questions)
    words = "where bags may lie, in metres from the robot's base: forward, from and to"
    x = questions.ask(words, spaced(arm.workspace.x), bounds)
    y = questions.ask(
        "the same to the left (negative is right), from and to", spaced(arm.workspace.y), bounds
    )
    content |= {"workspace": {"x": x, "y": y}, **arm.beside}
    if kind != "replay":  # which shows the bags that it has
        content["bag"] = _bag(questions, arm.real)
    return content


def _camera(questions: Questions) -> dict[str, Any]:
    words = (
        "which camera: opencv, a USB or network camera or a video file; realsense, orbbec or k4a, with depth; python, "
        "one of your own"
    )
    kind = questions.ask(words, "opencv", one_of(*get_args(Kind), "python"))
    if kind == "python":
        return {"kind": kind, **ask_factory(questions, "camera")}
    if kind == "opencv":
        words = "its number, device or address, or the video file"
        return {"kind": kind, "source": questions.ask(words, "0", _source)}
    recording = " or the file of a recording" if kind == "realsense" else ""
    source = questions.ask(f"its serial number{recording}, or any for the only one plugged in", "any", str)
    return {"kind": kind} if source == "any" else {"kind": kind, "source": source}


def _source(answer: str) -> str:
    if not (is_live(answer) or Path(answer).is_file()):
        raise ValueError(
            "expected a number, a device such as /dev/video0, an address, or a file that is there"
        )
    return answer


def _bag(questions: Questions, real: bool) -> dict[str, Any]:
    bag = Bag()
    words = "the bag, or what lies there in its place, length and width in metres"
    sides = questions.ask(
        words, spaced((bag.length_m, bag.width_m)), _real_sides if real else _simulated_sides
    )
    content: dict[str, Any] = {"length_m": max(sides), "width_m": min(sides)}
    if real:
        words = "how high it is where it lies, in metres"
        content["height_m"] = questions.ask(words, f"{bag.height_m:g}", entry(Bag, "height_m"))
        words = "is it hard, so that the hand has to go over it? yes or no"
        content["hard"] = questions.ask(words, "no", one_of("yes", "no")) == "yes"
    content["color"] = questions.ask("its colour, red green blue of 255", spaced(bag.color), color)
    return content


def _real_sides(answer: str) -> list[float]:
    return several(entry(Bag, "length_m"), 2)(answer)


def _simulated_sides(answer: str) -> list[float]:
    sides = _real_sides(answer)
    Bag(length_m=max(sides), width_m=min(sides)).check_simulated()
    return sides
