"""`baggie workcell new`: asks a person about their workcell, and writes the file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import tyro
import yaml
from rich.console import Console

from baggie.errors import BaggieError
from baggie.files import write_text
from baggie.workcell.workcell_file import Bag, Bounds, FrankaEntry, read_workcell_file

Answer = TypeVar("Answer")
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
    questions = _Questions(ask or Console(stderr=True).input)
    content = _content(questions)
    header = _NEXT.format(name=options.out)
    text = header + yaml.safe_dump(content, sort_keys=False, default_flow_style=None)
    write_text(options.out, text)
    read_workcell_file(options.out)
    return {"workcell": str(options.out), "next": f"baggie doctor {options.out}"}


def _content(questions: _Questions) -> dict[str, Any]:
    kind = questions.ask("which arm: franka, or sim", "franka", _one_of("franka", "sim"))
    arm: dict[str, Any] = {"kind": kind}
    content: dict[str, Any] = {"arm": arm}
    if kind == "franka":
        arm["host"] = questions.ask("the address of the arm's control box", "172.16.0.2", _word)
        arm["model"] = questions.ask("which model: fr3 or panda", "fr3", _one_of("fr3", "panda"))
        default = FrankaEntry(kind="franka", host="-").speed
        words = "share of full speed; 0.1 until you have watched it work"
        arm["speed"] = questions.ask(words, f"{default:g}", _number(0, 1))
        words = "does this computer have a real-time kernel (uname -a says PREEMPT_RT)? yes or no"
        arm["realtime"] = questions.ask(words, "yes", _one_of("yes", "no")) == "yes"
        words = "the camera: a number, device or address, or realsense, orbbec, k4a"
        content["camera"] = questions.ask(words, "0", _word)
    else:
        content["cell"] = int(questions.ask("number of the simulated cell", "0", _number(0, 1e6)))
    bounds, bag = Bounds(), Bag()
    words = "where bags may lie, in metres from the robot's base: forward, from and to"
    x = questions.ask(words, _pair(bounds.x), _range)
    y = questions.ask("the same to the left (negative is right), from and to", _pair(bounds.y), _range)
    content["workspace"] = {"x": x, "y": y}
    words = "the bag, length and width in metres"
    length, width = questions.ask(words, _pair((bag.length_m, bag.width_m)), _two_numbers)
    color = questions.ask("its colour, red green blue of 255", " ".join(map(str, bag.color)), _color)
    content["bag"] = {"length_m": max(length, width), "width_m": min(length, width), "color": color}
    return content


class _Questions:
    """Asks until an answer will do."""

    def __init__(self, ask: Callable[[str], str]) -> None:
        self._ask = ask

    def ask(self, words: str, default: str, parse: Callable[[str], Answer]) -> Answer:
        """Enter alone takes the default."""
        hint = ""
        while True:
            try:
                answer = self._ask(f"{hint}{words} ({default}): ").strip()
            except EOFError:
                raise BaggieError(f"nobody answers: {words}; run this in a terminal") from None
            try:
                return parse(answer or default)
            except ValueError as error:
                hint = f"{answer!r} will not do ({error}); "


def _word(answer: str) -> str:
    return answer


def _one_of(*choices: str) -> Callable[[str], str]:
    def parse(answer: str) -> str:
        if answer not in choices:
            raise ValueError(f"expected {' or '.join(choices)}")
        return answer

    return parse


def _number(low: float, high: float) -> Callable[[str], float]:
    def parse(answer: str) -> float:
        value = float(answer)
        if not low <= value <= high:
            raise ValueError(f"expected {low:g} to {high:g}")
        return value

    return parse


def _two_numbers(answer: str) -> list[float]:
    low, high = (float(word) for word in answer.replace(",", " ").split())
    return [low, high]


def _range(answer: str) -> list[float]:
    low, high = _two_numbers(answer)
    if not low < high:
        raise ValueError("expected the lower one first")
    return [low, high]


def _color(answer: str) -> list[int]:
    values = [int(word) for word in answer.replace(",", " ").split()]
    if len(values) != 3 or not all(0 <= value <= 255 for value in values):
        raise ValueError("expected three numbers of 0 to 255")
    return values


def _pair(values: tuple[float, float]) -> str:
    return " ".join(f"{value:g}" for value in values)
