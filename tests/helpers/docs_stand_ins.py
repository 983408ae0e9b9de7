"""What takes the place of something on a page that a test cannot have: a robot, a person, a night. One table of it.

A program of a page may use names that the reader has: a picture, a goal, a policy. `GIVEN` says what they are here.
"""

from __future__ import annotations

import ast
import builtins
import re
from collections.abc import Mapping
from dataclasses import dataclass

MARKER = "--marker color:217,13,191 --marker-in-hand 0.09 0 0"


@dataclass(frozen=True)
class Numbers:
    """How much is done of what a page does."""

    attempts: int
    train: int
    val: int
    steps: int
    episodes: int
    rows: int
    """Of points of a calibration."""


SHORT = Numbers(attempts=12, train=6, val=4, steps=60, episodes=1, rows=2)
"""Goals that lie outside of what so few attempts cover are refused: of four, some lie inside."""
NIGHT = Numbers(attempts=14, train=10, val=3, steps=300, episodes=2, rows=3)


@dataclass(frozen=True)
class StandIn:
    """A regular expression, of a command or of a line of a program, and what becomes of it."""

    of: str
    becomes: str
    page: str = ""
    """A regular expression of the pages it is for; all of them unless given."""


_POST = (
    'python -c "import sys, urllib.request as web; '
    "[web.urlopen(web.Request('http://{lab}/' + path, method='POST')) for path in sys.argv[1:]]\""
)
_HOLD = f'{_POST} paddle?shown=1 "bag?x=0.5&y=0.8"'
_LET_GO = f"{_POST} paddle?shown=0 reset?seed=0"
"""What somebody does with the marker's plate and the bag."""

STAND_INS = (
    # The set-up is what the environment of the test is.
    StandIn(r"^make demo\b.*", "python examples/demo.py --attempts 20 --val 4 --steps 80 --episodes 1"),
    StandIn(r"^make test\b.*", "true"),
    StandIn(r"^source \.venv/bin/activate$", "true"),
    # The lab: as fast as it can, at an address that no other test has.
    StandIn(r"^baggie lab\b", "baggie lab --host {host} --pace 0"),
    StandIn(r"\b127\.0\.0\.1:8090\b", "{lab}"),
    StandIn(r'source="0"', 'source="http://{lab}/camera.mjpg"', "cameras|own-arm"),
    # The marker in the hand is the lab's paddle; nobody has to be waited for.
    StandIn(
        r"^(baggie calibrate image-to-robot .*--workcell cell\.yaml.*)",
        rf"{_HOLD} && \1 {MARKER} && {_LET_GO}",
        "first-night|collecting",
    ),
    # Smaller numbers: what is said twice counts as said last.
    StandIn(r"(baggie calibrate image-to-robot [^&]*)", r"\1 --rows {rows} "),
    StandIn(r"^(baggie calibrate check .*--touches 0.*)", r"\1 --points 2"),
    StandIn(r"^(baggie collect .*--task (?!bag-place).*)", r"\1 --attempts 2"),
    StandIn(r"^(baggie collect (?!.*--task (?!bag-place)).*)", r"\1 --attempts {attempts}"),
    StandIn(r"^(baggie train .*pyramid.*)", r"\1 --train 1 --val 1 --steps 10"),
    StandIn(r"^(baggie train (?!.*pyramid).*)", r"\1 --train {train} --val {val} --steps {steps}"),
    StandIn(r"^(baggie evaluate .*)", r"\1 --episodes {episodes}"),
    StandIn(r"\b(attempts|episodes)=\d+", r"\1=1"),
    # A recorded picture is half as large as one that is just being taken.
    StandIn(
        r"^corners = \[\[.*",
        "from baggie.data.summary import goal_of; "
        "corners = 2 * goal_of(baggie.open_dataset('recordings/bags')[0]).corners",
        "README",
    ),
    # What somebody else has: a recording, a trained policy.
    StandIn(r"--from recording\b", "--from hand-eye"),
    StandIn(r'"RUN"', '"runs/pyramid"'),
)

ANSWERS: Mapping[str, tuple[str, ...]] = {
    "baggie workcell new": (
        "franka",
        "{host}",
        "fr3",
        "1",  # of full speed: nothing here can be hurt
        "no",  # real-time kernel
        "opencv",
        "http://{lab}/camera.mjpg",
        *("", ""),  # the workspace
        *("", "", ""),  # the bag's sides and height, and that it is soft
        "{color}",
    ),
    "baggie doctor": ("y", "", "", ""),  # nobody lays or holds anything
    "baggie calibrate image-to-robot": ("", ""),
}
"""What somebody types at the prompts of a command; Enter alone is empty."""

_RECORDED = "import baggie; from baggie.data.summary import goal_of; "
_RECORDED += "recorded = baggie.open_dataset('recordings/bags')[0]; "
GIVEN: Mapping[str, str] = {
    "picture": _RECORDED + "picture = recorded.before.color",
    "corners": _RECORDED + "corners = goal_of(recorded).corners",
    "observation": _RECORDED + "observation = recorded.before",
    "goal": _RECORDED + "goal = goal_of(recorded)",
    "policy": "import baggie; policy = baggie.load_policy('runs/keypoint')",
    "open_arm": "from my_lab.my_arm import open_arm",
    "obs": "import sys; sys.path.append('tests'); from helpers import ravens_scene; obs = ravens_scene.observation(0)",
    "info": "info = {}",
}
"""What the reader of a program has, and the lines that make it."""


def stand_in(text: str, page: str, facts: Mapping[str, object]) -> str:
    """A command, or a line of a program, as it is run here."""
    for row in STAND_INS:
        if re.search(row.page, page) and re.search(row.of, text):
            text = re.sub(row.of, row.becomes, text)
    return filled(text, facts)


def filled(text: str, facts: Mapping[str, object]) -> str:
    """With `{host}` and the like as they are here."""
    for name, value in facts.items():
        text = text.replace("{" + name + "}", str(value))
    return text


def answers(command: str, facts: Mapping[str, object]) -> str:
    """What somebody types, line by line."""
    typed = (line for start, lines in ANSWERS.items() if command.startswith(start) for line in lines)
    return "".join(f"{filled(line, facts)}\n" for line in typed)


def taken_for_granted(program: str) -> set[str]:
    """Names that a program uses and does not make."""
    names = [node for node in ast.walk(ast.parse(program)) if isinstance(node, ast.Name)]
    used = {name.id for name in names if isinstance(name.ctx, ast.Load)}
    made = {name.id for name in names if isinstance(name.ctx, ast.Store)}
    for node in ast.walk(ast.parse(program)):
        if isinstance(node, ast.Import | ast.ImportFrom):
            made |= {name.asname or name.name.split(".")[0] for name in node.names}
        elif isinstance(node, ast.FunctionDef | ast.ClassDef):
            made.add(node.name)
        elif isinstance(node, ast.arg):
            made.add(node.arg)
    return used - made - set(vars(builtins))
