"""`baggie workcell new` asks a person about a workcell and writes its file.

An arm of a kind that is not in `ASKED`, another package's, is asked for what has no default.
"""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml
from pydantic import BaseModel, ValidationError, create_model

from baggie.cameras.camera import CameraSettings
from baggie.cameras.opencv import is_live
from baggie.errors import BaggieError, DataError
from baggie.files import parse_yaml, write_text
from baggie.operator import Answer, Operator, Parse, Question, TerminalOperator, choice
from baggie.options.commissioning import NewWorkcellOptions
from baggie.registry import ARMS, CAMERAS
from baggie.robot.arm import PythonArmEntry
from baggie.robot.franka import FrankaEntry
from baggie.robot.lerobot import LeRobotEntry
from baggie.workcell.workcell_file import BagEntry, Bounds, WorkcellFile, read_workcell_file

_NONE = "-"
_NARROWEST_M, _WIDEST_M = 0.01, 0.3
_SO101 = ("so100_follower", "so101_follower")
_SO101_PARK = (80.0, -40.0, 40.0, 90.0, 0.0)
_SO101_TOOL_RPY = (0.0, 0.0, 90.0)
_SMALL = Bounds(x=(0.15, 0.25), y=(-0.10, 0.10))
"""The workspace of an arm as small as an SO-101, and how it handles: near the table and slowly."""
_SMALL_HANDLING = {
    "travel_z_m": 0.16,
    "approach_z_m": 0.11,
    "fast_m_s": 0.5,
    "carry_m_s": 0.3,
    "feel_m_s": 0.1,
}


@dataclass(frozen=True)
class NewArm:
    """What was answered about an arm."""

    entry: Mapping[str, Any]
    """Of the section `arm`, but for its kind."""
    beside: Mapping[str, Any] = field(default_factory=dict)
    """What else the file has to say because of it."""
    workspace: Bounds = field(default_factory=Bounds)
    """Where bags may lie, unless a person says otherwise."""


def _franka(operator: Operator, _folder: Path) -> NewArm:
    host = operator.ask(Question("the address of the arm's control box", "172.16.0.2", word))
    model = operator.ask(Question("which model: fr3 or panda", "fr3", entry(FrankaEntry, "model")))
    speed = _speed(operator, FrankaEntry.model_fields["speed"].default)
    words = "does this computer have a real-time kernel (uname -a says PREEMPT_RT)? yes or no"
    realtime = operator.ask(choice(words, "yes", ("yes", "no"))) == "yes"
    return NewArm({"host": host, "model": model, "speed": speed, "realtime": realtime})


def _lerobot(operator: Operator, _folder: Path) -> NewArm:
    fields = LeRobotEntry.model_fields
    kind = operator.ask(Question("LeRobot's name for the robot", "so101_follower", word))
    small = kind in _SO101
    arm: dict[str, Any] = {"type": kind}
    for name, words, default in (
        ("port", f"its port, or {_NONE} for none", "/dev/ttyACM0"),
        ("id", f"the name of its calibration, or {_NONE} for none", _NONE),
    ):
        answer = operator.ask(Question(words, default, word))
        arm |= {} if answer == _NONE else {name: answer}
    if small:
        arm["options"] = {"disable_torque_on_disconnect": False}  # or it goes limp at the end
    words = "its MJCF or URDF file, from this file's folder"
    arm["model"] = operator.ask(Question(words, "so101_new_calib.urdf" if small else None, str))
    words = "the site, body or link in it that moves with the hand"
    arm["tool"] = operator.ask(Question(words, fields["tool"].default, word))
    words = "the turn from there to a frame with z along the fingers and y the way they open: roll pitch yaw, degrees"
    turn = spaced(_SO101_TOOL_RPY if small else fields["tool_rpy_deg"].default)
    arm["tool_rpy_deg"] = operator.ask(Question(words, turn, several(number, 3)))
    words = "how high above the table it stands, in metres"
    arm["base_z_m"] = operator.ask(Question(words, "0", entry(LeRobotEntry, "base_z_m")))
    names = tuple(joint.name for joint in fields["joints"].default)
    arm["joints"] = operator.ask(Question("its joints, from base to wrist", spaced(names), several(word)))
    words = "their positions, in degrees or normalized to -100 to 100"
    arm["units"] = operator.ask(Question(words, fields["units"].default, entry(LeRobotEntry, "units")))
    words = "their positions out of the camera's view, the tool pointing down"
    park = spaced(_SO101_PARK) if small and tuple(arm["joints"]) == names else None
    arm["park"] = operator.ask(Question(words, park, several(number, len(arm["joints"]))))
    width_m = _width(operator, 0.07)
    arm["widths"] = [[0.0, 0.0], [100.0, width_m]]
    arm["speed"] = _speed(operator, fields["speed"].default)
    if small:
        return NewArm(arm, {"handling": _SMALL_HANDLING}, workspace=_SMALL)
    return NewArm(arm)


def _python(operator: Operator, _folder: Path) -> NewArm:
    return NewArm(ask_factory(operator, "arm"))


def ask_factory(operator: Operator, what: str) -> dict[str, Any]:
    """Which function makes an arm, or a camera, of one's own, and what it is given."""
    words = (
        f"what makes the {what}, as module:function; the module is installed, or lies in this file's folder"
    )
    factory = operator.ask(Question(words, f"own_{what}:open_{what}", entry(PythonArmEntry, "factory")))
    words = f"what it is given, as name=value apart by spaces, or {_NONE} for nothing"
    return {"factory": factory, **operator.ask(Question(words, _NONE, _options))}


def _replay(operator: Operator, folder: Path) -> NewArm:
    def recording(answer: str) -> str:
        if not (folder / answer).is_dir():
            raise ValueError("expected a folder that is there")
        return answer

    words = "the recording's folder, from this file's own"
    return NewArm({"recording": operator.ask(Question(words, None, recording))})


def _sim(operator: Operator, _folder: Path) -> NewArm:
    cell = operator.ask(Question("number of the simulated cell", "0", entry(WorkcellFile, "cell")))
    return NewArm({}, {"cell": cell})


ASKED: Mapping[str, Callable[[Operator, Path], NewArm]] = {
    "franka": _franka,
    "lerobot": _lerobot,
    "python": _python,
    "replay": _replay,
    "sim": _sim,
}
"""By kind; each is told the folder that the file will be in. Of others, what has no default is asked."""


def required(operator: Operator, model: type[BaseModel]) -> dict[str, Any]:
    """Ask for each entry of a section that has to be there."""
    return {
        name: operator.ask(Question(field.description or f"its {name}", None, entry(model, name)))
        for name, field in model.model_fields.items()
        if field.is_required() and name != "kind"
    }


def _speed(operator: Operator, default: float) -> float:
    words = "share of full speed; 0.1 until you have watched it work"
    speed: float = operator.ask(Question(words, f"{default:g}", entry(FrankaEntry, "speed")))
    return speed


def _width(operator: Operator, default_m: float) -> float:
    def width(answer: str) -> float:
        value = number(answer)
        if not _NARROWEST_M <= value <= _WIDEST_M:
            raise ValueError(f"expected {_NARROWEST_M:g} to {_WIDEST_M:g}")
        return value

    return operator.ask(Question("how far its fingers open, in metres", f"{default_m:g}", width))


def _options(answer: str) -> dict[str, Any]:
    """`name=value ...`, the values as YAML has them."""
    options: dict[str, Any] = {}
    for part in shlex.split(answer) if answer != _NONE else []:
        name, equals, value = part.partition("=")
        if not (equals and name.isidentifier()):
            raise ValueError(f"expected name=value, got {part}")
        if name in PythonArmEntry.model_fields:
            raise ValueError(f"expected another name than {name}, which is the file's own")
        try:
            options[name] = parse_yaml(value, name)
        except DataError:
            raise ValueError(f"expected a value as YAML has it, got {value}") from None
    return options


_NEXT = """\
# A workcell. What stands here and what else may: docs/workcell.md.
# Check it, first without moving anything: baggie doctor {name}
"""


def new_workcell(options: NewWorkcellOptions, *, operator: Operator | None = None) -> dict[str, Any]:
    """Ask, write, and read it back. Raises `BaggieError` where there is a file already, or nobody answers.

    The person at the terminal is asked, unless `operator` is given.
    """
    if options.out.exists():
        raise BaggieError(f"{options.out} is there already; edit it, or give another --out")
    content = _content(operator or TerminalOperator(), options.out.parent)
    header = _NEXT.format(name=options.out)
    text = header + yaml.safe_dump(content, sort_keys=False, default_flow_style=None)
    write_text(options.out, text)
    read_workcell_file(options.out)
    return {"workcell": str(options.out), "next": f"baggie doctor {options.out}"}


def _content(operator: Operator, folder: Path) -> dict[str, Any]:
    arms = ARMS.all()
    kind = _kind(operator, "arm", "franka", {name: arms[name].about for name in sorted(arms)})
    arm = ASKED[kind](operator, folder) if kind in ASKED else NewArm(required(operator, arms[kind]))
    content: dict[str, Any] = {"arm": {"kind": kind, **arm.entry}}
    if arms[kind].real:
        content["camera"] = _camera(operator)
    words = "where bags may lie, in metres from the robot's base: forward, from and to"
    x = operator.ask(Question(words, spaced(arm.workspace.x), bounds))
    y = operator.ask(
        Question("the same to the left (negative is right), from and to", spaced(arm.workspace.y), bounds)
    )
    content |= {"workspace": {"x": x, "y": y}, **arm.beside}
    if kind != "replay":  # which shows the bags that it has
        content["bag"] = _bag(operator, arms[kind].real)
    return content


def _kind(operator: Operator, what: str, usual: str, about: Mapping[str, str]) -> str:
    """One of these kinds, each with what it is."""
    each = [f"{kind}, {words}" if words else kind for kind, words in about.items()]
    return operator.ask(choice(f"which {what}: {'; '.join(each)}", usual, tuple(about)))


def _camera(operator: Operator) -> dict[str, Any]:
    cameras = {kind: model for kind, model in CAMERAS.all().items() if model.real}
    kind = _kind(operator, "camera", "opencv", {name: model.about for name, model in cameras.items()})
    if kind == "python":
        return {"kind": kind, **ask_factory(operator, "camera")}
    if kind == "opencv":
        words = "its number, device or address, or the video file"
        return {"kind": kind, "source": operator.ask(Question(words, "0", _source))}
    if not issubclass(cameras[kind], CameraSettings):
        return {"kind": kind, **required(operator, cameras[kind])}
    recording = " or the file of a recording" if kind == "realsense" else ""
    source = operator.ask(
        Question(f"its serial number{recording}, or any for the only one plugged in", "any", str)
    )
    return {"kind": kind} if source == "any" else {"kind": kind, "source": source}


def _source(answer: str) -> str:
    if not (is_live(answer) or Path(answer).is_file()):
        raise ValueError(
            "expected a number, a device such as /dev/video0, an address, or a file that is there"
        )
    return answer


def _bag(operator: Operator, real: bool) -> dict[str, Any]:
    bag = BagEntry()
    words = "the bag, or what lies there in its place, length and width in metres"
    sides = operator.ask(
        Question(words, spaced((bag.length_m, bag.width_m)), _real_sides if real else _simulated_sides)
    )
    content: dict[str, Any] = {"length_m": max(sides), "width_m": min(sides)}
    if real:
        words = "how high it is where it lies, in metres"
        content["height_m"] = operator.ask(Question(words, f"{bag.height_m:g}", entry(BagEntry, "height_m")))
        words = "is it hard, so that the hand has to go over it? yes or no"
        content["hard"] = operator.ask(choice(words, "no", ("yes", "no"))) == "yes"
    content["color"] = operator.ask(Question("its colour, red green blue of 255", spaced(bag.color), color))
    return content


def _real_sides(answer: str) -> list[float]:
    return several(entry(BagEntry, "length_m"), 2)(answer)


def _simulated_sides(answer: str) -> list[float]:
    sides = _real_sides(answer)
    BagEntry(length_m=max(sides), width_m=min(sides)).check_simulated()
    return sides


def entry(model: type[BaseModel], name: str) -> Parse[Any]:
    """What this entry of a file may be, by the rules of its reader."""
    field = model.model_fields[name]
    assert field.annotation is not None
    alone: type[BaseModel] = create_model("Alone", answer=(field.annotation, field))

    def parse(answer: str) -> Any:
        try:
            return alone.model_validate({"answer": answer}).model_dump(mode="json")["answer"]
        except ValidationError as error:
            raise _in_words(error) from None

    return parse


def _in_words(error: ValidationError) -> ValueError:
    return ValueError(error.errors()[0]["msg"].removeprefix("Value error, "))


def word(answer: str) -> str:
    """Anything without spaces."""
    if len(answer.split()) != 1:
        raise ValueError("expected one word")
    return answer


def number(answer: str) -> float:
    """A finite number."""
    value = float(answer)
    if not math.isfinite(value):
        raise ValueError("expected a finite number")
    return value


def several(parse: Parse[Answer], count: int | None = None) -> Parse[list[Answer]]:
    """So many, or any number of them, apart by spaces or commas."""

    def parse_all(answer: str) -> list[Answer]:
        words = answer.replace(",", " ").split()
        if count is not None and len(words) != count:
            raise ValueError(f"expected {count} of them, apart by spaces")
        return [parse(one) for one in words]

    return parse_all


def bounds(answer: str) -> list[float]:
    """Two numbers, the lower one first: what a workspace's bounds may be."""
    low, high = several(number, 2)(answer)
    try:
        return list(Bounds(x=(low, high)).x)
    except ValidationError as error:
        raise _in_words(error) from None


def color(answer: str) -> list[int]:
    """Red, green, blue of 255."""
    values = several(int, 3)(answer)
    if not all(0 <= value <= 255 for value in values):
        raise ValueError("expected three numbers of 0 to 255")
    return values


def spaced(values: tuple[Any, ...]) -> str:
    """A default of several, as a person would type it."""
    return " ".join(f"{value:g}" if isinstance(value, float) else str(value) for value in values)
