"""What `baggie workcell new` asks about an arm: for each kind what it needs, and what goes with it."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from baggie.commissioning.questions import Questions, entry, number, one_of, several, spaced, word
from baggie.errors import DataError
from baggie.text_files import parse_yaml
from baggie.workcell.workcell_file import (
    Bounds,
    FrankaEntry,
    LeRobotEntry,
    PythonEntry,
    WorkcellFile,
)

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
    real: bool = True
    """Whether it needs a camera."""
    workspace: Bounds = field(default_factory=Bounds)
    """Where bags may lie, unless a person says otherwise."""


def _franka(questions: Questions, _folder: Path) -> NewArm:
    host = questions.ask("the address of the arm's control box", "172.16.0.2", word)
    model = questions.ask("which model: fr3 or panda", "fr3", entry(FrankaEntry, "model"))
    speed = _speed(questions, FrankaEntry.model_fields["speed"].default)
    words = "does this computer have a real-time kernel (uname -a says PREEMPT_RT)? yes or no"
    realtime = questions.ask(words, "yes", one_of("yes", "no")) == "yes"
    return NewArm({"host": host, "model": model, "speed": speed, "realtime": realtime})


def _lerobot(questions: Questions, _folder: Path) -> NewArm:
    fields = LeRobotEntry.model_fields
    kind = questions.ask("LeRobot's name for the robot", "so101_follower", word)
    small = kind in _SO101
    arm: dict[str, Any] = {"type": kind}
    for name, words, default in (
        ("port", f"its port, or {_NONE} for none", "/dev/ttyACM0"),
        ("id", f"the name of its calibration, or {_NONE} for none", _NONE),
    ):
        answer = questions.ask(words, default, word)
        arm |= {} if answer == _NONE else {name: answer}
    if small:
        arm["options"] = {"disable_torque_on_disconnect": False}  # or it goes limp at the end
    words = "its MJCF or URDF file, from this file's folder"
    arm["model"] = questions.ask(words, "so101_new_calib.urdf" if small else "", str)
    words = "the site, body or link in it that moves with the hand"
    arm["tool"] = questions.ask(words, fields["tool"].default, word)
    words = "the turn from there to a frame with z along the fingers and y the way they open: roll pitch yaw, degrees"
    turn = spaced(_SO101_TOOL_RPY if small else fields["tool_rpy_deg"].default)
    arm["tool_rpy_deg"] = questions.ask(words, turn, several(number, 3))
    words = "how high above the table it stands, in metres"
    arm["base_z_m"] = questions.ask(words, "0", entry(LeRobotEntry, "base_z_m"))
    names = tuple(joint.name for joint in fields["joints"].default)
    arm["joints"] = questions.ask("its joints, from base to wrist", spaced(names), several(word))
    words = "their positions, in degrees or normalized to -100 to 100"
    arm["units"] = questions.ask(words, fields["units"].default, entry(LeRobotEntry, "units"))
    words = "their positions out of the camera's view, the tool pointing down"
    park = spaced(_SO101_PARK) if small and tuple(arm["joints"]) == names else ""
    arm["park"] = questions.ask(words, park, several(number, len(arm["joints"])))
    width_m = _width(questions, 0.07)
    arm["widths"] = [[0.0, 0.0], [100.0, width_m]]
    arm["speed"] = _speed(questions, fields["speed"].default)
    if small:
        return NewArm(arm, {"handling": _SMALL_HANDLING}, workspace=_SMALL)
    return NewArm(arm)


def _python(questions: Questions, _folder: Path) -> NewArm:
    return NewArm(ask_factory(questions, "arm"))


def ask_factory(questions: Questions, what: str) -> dict[str, Any]:
    """Which function makes an arm, or a camera, of one's own, and what it is given."""
    words = (
        f"what makes the {what}, as module:function; the module is installed, or lies in this file's folder"
    )
    factory = questions.ask(words, f"own_{what}:open_{what}", entry(PythonEntry, "factory"))
    words = f"what it is given, as name=value apart by spaces, or {_NONE} for nothing"
    return {"factory": factory, **questions.ask(words, _NONE, _options)}


def _replay(questions: Questions, folder: Path) -> NewArm:
    def recording(answer: str) -> str:
        if not (folder / answer).is_dir():
            raise ValueError("expected a folder that is there")
        return answer

    words = "the recording's folder, from this file's own"
    return NewArm({"recording": questions.ask(words, "", recording)}, real=False)


def _sim(questions: Questions, _folder: Path) -> NewArm:
    cell = questions.ask("number of the simulated cell", "0", entry(WorkcellFile, "cell"))
    return NewArm({}, {"cell": cell}, real=False)


ARMS: Mapping[str, Callable[[Questions, Path], NewArm]] = {
    "franka": _franka,
    "lerobot": _lerobot,
    "python": _python,
    "replay": _replay,
    "sim": _sim,
}
"""By kind; each is told the folder that the file will be in."""


def _speed(questions: Questions, default: float) -> float:
    words = "share of full speed; 0.1 until you have watched it work"
    speed: float = questions.ask(words, f"{default:g}", entry(FrankaEntry, "speed"))
    return speed


def _width(questions: Questions, default_m: float) -> float:
    def width(answer: str) -> float:
        value = number(answer)
        if not _NARROWEST_M <= value <= _WIDEST_M:
            raise ValueError(f"expected {_NARROWEST_M:g} to {_WIDEST_M:g}")
        return value

    return questions.ask("how far its fingers open, in metres", f"{default_m:g}", width)


def _options(answer: str) -> dict[str, Any]:
    """`name=value ...`, the values as YAML has them."""
    options: dict[str, Any] = {}
    for part in shlex.split(answer) if answer != _NONE else []:
        name, equals, value = part.partition("=")
        if not (equals and name.isidentifier()):
            raise ValueError(f"expected name=value, got {part}")
        if name in PythonEntry.model_fields:
            raise ValueError(f"expected another name than {name}, which is the file's own")
        try:
            options[name] = parse_yaml(value, name)
        except DataError:
            raise ValueError(f"expected a value as YAML has it, got {value}") from None
    return options
