"""One turn of collecting, as a small state machine: each phase is a function from the turn to the next phase.

    LOOK ──► FIND ──► PLAN ──► MOVE ──► CHECK ──► RECORD
     ▲        │         │        │
     │     RECOVER      │      RETRY  (missed grasp, unreachable: a fresh look, up to three tries)
     │        │         │        │
     ├────────┴─► ASK ◄─┘        │
     │             │             │
     └─────────────┼─────────────┘
                STOPPED  (nobody helped)

MOVE is the workcell's own pick (with its check of the gripper's width), carry and place. What FIND, PLAN and CHECK do
with what is seen is a `Play`'s: `Scatter` takes one object about, `baggie.collect.stacking.Stacking` builds of several.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Protocol

import numpy as np

from baggie.calibration.image_to_robot.map import ImageToRobot
from baggie.errors import BaggieError, LimitError, NobodyError, ReachError
from baggie.geometry import FloatArray, PlanarPose, Rectangle, wrap_angle
from baggie.operator import Operator, errand
from baggie.options.values import Color
from baggie.robot.handling_rules import ROOM_M
from baggie.robot.limits import MARGIN_M
from baggie.seeds import first_fit
from baggie.types import Failure, Observation, Outcome, PickPlace
from baggie.vision.color_mask import Detection, find_bag
from baggie.workcell.workcell import Workcell, WorkcellSettings

MIN_DISTANCE_M = 0.20
FALSE_45_RAD = math.radians(7)
"""Readings this close to 45 degrees are doubted."""


def random_place(
    workspace: Rectangle, last: PlanarPose, rng: np.random.Generator, margin: float = MARGIN_M
) -> PlanarPose:
    """A place uniform over the workspace, at least 20 cm from the last, the gripper square to it (yaw 0).

    `margin`: metres between it and the workspace's edge. Raises `BaggieError` when the workspace is too small for two
    places 20 cm apart.
    """

    def somewhere() -> PlanarPose:
        x, y = workspace.sample(rng, margin)
        return PlanarPose(float(x), float(y), 0.0)

    place = first_fit(somewhere, lambda pose: pose.distance(last) >= MIN_DISTANCE_M)
    if place is None:
        raise BaggieError(
            f"expected a workspace with places {MIN_DISTANCE_M * 100:.0f} cm apart, got {workspace}; "
            "make it larger"
        )
    return place


def false_45(yaw: float) -> bool:
    """Whether a square's angle (radians, modulo a quarter turn) is so near 45 degrees that it may be false.

    The rectangle of least area around a square with soft corners may as well stand on its tip.
    """
    return abs(abs(yaw) - math.pi / 4) < FALSE_45_RAD


def grip_yaw(yaw: float, believed: bool) -> float:
    """The gripper's angle for an object at `yaw` (radians, modulo a quarter turn).

    Along the object, so that putting it down with the gripper at 0 squares it to the workspace. A reading of
    45 degrees is taken for false, and the gripper stays square; but a false one does not survive being moved,
    so the second in a row is `believed`, and so is one after the square gripper has missed.
    """
    return 0.0 if false_45(yaw) and not believed else yaw


def long_place_yaw(pick_yaw: float, rng: np.random.Generator) -> float:
    """The gripper's angle to put a long object down squared up: along x or along y, whichever chance says.

    Along y the way round that turns the wrist less.
    """
    return 0.0 if rng.random() < 0.5 else math.copysign(math.pi / 2, pick_yaw)


def nearest_grip(workspace: Rectangle, x: float, y: float, reach: float) -> tuple[float, float] | None:
    """The point of the workspace nearest to (x, y); None where that is more than `reach` metres away."""
    inside = workspace.nearest(x, y)
    return inside if math.hypot(inside[0] - x, inside[1] - y) <= reach else None


MAX_TRIES = 3
MAX_LOOKS = 3
MAX_RESCUES = 2
UNMOVED_M = 0.02
"""An object said to be carried 20 cm that is still this close to where it was has not been moved."""
LANDING_M = 0.06
"""How far from where it was let go an object may be found and still count as put down there."""
LANDING_DOUBTED_M = 0.09
"""The same when it was gripped across its corners, after a doubtful reading of 45 degrees."""


class Phase(Enum):
    """Where a turn is."""

    LOOK = "look"
    FIND = "find"
    PLAN = "plan"
    MOVE = "move"
    RETRY = "retry"
    RECOVER = "recover"
    ASK = "ask"
    CHECK = "check"
    RECORD = "record"
    STOPPED = "stopped"


class Play(Protocol):
    """What the robot does with what it sees; it may remember that from one turn to the next."""

    def find(self, turn: Turn) -> str:
        """Take note of what the picture before shows; what is amiss there, in one line for a person, or nothing."""
        ...

    def plan(self, turn: Turn) -> str:
        """Choose the turn's action; why there is none, in one line for a person, or nothing."""
        ...

    def judge(self, turn: Turn) -> Failure | None:
        """Take note of what the picture after shows; what went wrong, by that or by the outcome so far."""
        ...


@dataclass
class Turn:
    """What one turn knows; every phase reads and adds to it."""

    cell: Workcell
    image_to_robot: ImageToRobot
    rng: np.random.Generator
    operator: Operator
    play: Play = field(default_factory=lambda: Scatter())  # noqa: PLW0108 -- it is defined below
    doubted_before: bool = False
    """Whether the turn before read 45 degrees and did not believe it."""
    seen: Observation | None = None
    """What was seen just before this turn; the cell is as it was."""
    color: Color | None = None
    """RGB of the object that was chosen, where several lie about."""
    before: Observation | None = None
    found: Detection | None = None
    pose: PlanarPose | None = None
    """The object as detected, robot base frame."""
    doubted: bool = False
    action: PickPlace | None = None
    outcome: Outcome | None = None
    after: Observation | None = None
    found_after: Detection | None = None
    layers: tuple[int, int] | None = None
    """How many bags lie below the pick and below the place, where anybody counts."""
    under: tuple[PlanarPose, ...] = ()
    """Where those lie that it is placed on."""
    truth_before: PlanarPose | None = None
    """The truth, where somebody knows it: it is recorded, and never looked at."""
    tries: int = 0
    looks: int = 0
    rescues: int = 0
    trouble: str = ""
    """What a person is told, when asked or when everything stops."""

    def truth(self) -> PlanarPose | None:
        """Where the object that was chosen is now, where somebody knows it."""
        return self.cell.truth(self.color)

    def detect(self, observation: Observation) -> tuple[Detection, PlanarPose] | tuple[None, None]:
        """The object in a picture, in pixels and in the robot's base frame."""
        return detect(observation, self.image_to_robot, self.cell.settings) or (None, None)


def look(turn: Turn) -> Phase:
    """Take a picture with the arm out of the way, unless the one after the turn before still shows all."""
    turn.before, turn.seen = turn.seen or turn.cell.look(), None
    turn.looks += 1
    return Phase.FIND


def find(turn: Turn) -> Phase:
    """Find what there is by its colour."""
    if trouble := turn.play.find(turn):
        turn.trouble = trouble
        return Phase.RECOVER
    return Phase.PLAN


def plan(turn: Turn) -> Phase:
    """Choose what to take where."""
    if trouble := turn.play.plan(turn):
        turn.trouble = trouble
        return Phase.ASK
    turn.truth_before = turn.truth()
    return Phase.MOVE


def move(turn: Turn) -> Phase:
    """Pick, carry, place."""
    assert turn.action is not None
    turn.tries += 1
    try:
        turn.outcome = turn.cell.execute(turn.action)
    except (LimitError, ReachError) as error:
        turn.outcome = Outcome(turn.action, failure="unreachable")
        turn.trouble = f"the arm did not get there ({error}): put the object into the middle of the workspace"
    return Phase.RETRY if turn.outcome.failure in ("missed-grasp", "unreachable") else Phase.CHECK


def retry(turn: Turn) -> Phase:
    """Try again after a fresh look, a limited number of times."""
    if turn.tries >= MAX_TRIES:
        return Phase.CHECK
    turn.looks = 0
    return Phase.LOOK


def recover(turn: Turn) -> Phase:
    """Look again: a soft thing may still have been rolling, a shadow may have passed."""
    return Phase.LOOK if turn.looks < MAX_LOOKS else Phase.ASK


def ask(turn: Turn) -> Phase:
    """Have the cell help itself, a limited number of times; then ask a person, for as long as anybody answers."""
    turn.looks = 0
    turn.rescues += 1
    rescued = turn.rescues <= MAX_RESCUES and turn.cell.rescue()
    return Phase.LOOK if rescued or helped(turn.operator, turn.trouble) else Phase.STOPPED


def check(turn: Turn) -> Phase:
    """Look again: is the object where it was let go?"""
    assert turn.outcome is not None
    turn.after = turn.cell.look()
    turn.outcome = replace(turn.outcome, failure=turn.play.judge(turn), tries=turn.tries)
    return Phase.RECORD


class Scatter:
    """Takes the one object that there is to random places, squared up."""

    def find(self, turn: Turn) -> str:
        """Find the object by its colour."""
        assert turn.before is not None
        turn.found, turn.pose = turn.detect(turn.before)
        return "the object is not in sight: put it back into the workspace" if turn.found is None else ""

    def plan(self, turn: Turn) -> str:
        """Grip it where it lies, or where it can still be reached; put it down elsewhere, squared up."""
        assert turn.pose is not None
        settings, pose = turn.cell.settings, turn.pose
        grip = within_reach(settings, pose)
        if grip is None:
            return out_of_reach(settings, pose)
        long = settings.object_symmetry == LONG
        # What was not grasped one way is tried the other: no hand that stays square takes a hard square at 45 degrees.
        believed = turn.doubted_before != (turn.tries % 2 == 1)
        turn.doubted = not long and false_45(pose.yaw) and not believed
        pick = PlanarPose(*grip, pose.yaw if long else grip_yaw(pose.yaw, believed))
        place = random_place(settings.workspace, pick, turn.rng)
        turn.action = PickPlace(
            pick, replace(place, yaw=long_place_yaw(pick.yaw, turn.rng)) if long else place
        )
        return ""

    def judge(self, turn: Turn) -> Failure | None:
        """See whether it lies where it was let go."""
        assert turn.after is not None
        assert turn.outcome is not None
        assert turn.pose is not None
        turn.found_after, landed = turn.detect(turn.after)
        released = turn.outcome.executed.place
        failure = turn.outcome.failure or _landing(turn.pose, released, landed, turn.doubted)
        if failure is None and landed is not None and turn.cell.watch is not None:
            turn.cell.watch.landed(released, landed)
        return failure


def within_reach(settings: WorkcellSettings, pose: PlanarPose) -> tuple[float, float] | None:
    """The nearest point to an object's middle where the hand may still grip it, metres; None where there is none."""
    reach = ROOM_M if settings.object_hard else min(settings.object_size_m[:2]) / 3
    return nearest_grip(settings.limits.workspace, pose.x, pose.y, reach)


def out_of_reach(settings: WorkcellSettings, pose: PlanarPose) -> str:
    """What a person is told of an object that lies there."""
    return (
        f"the object at x {pose.x:.2f} m, y {pose.y:.2f} m is out of reach: "
        f"put it back into the workspace, {settings.workspace}"
    )


def _landing(
    start: PlanarPose, released: PlanarPose, landed: PlanarPose | None, doubted: bool
) -> Failure | None:
    if landed is None:
        return "lost-bag"
    if landed.distance(start) < UNMOVED_M:
        return "stalled"
    return "dropped" if landed.distance(released) > (LANDING_DOUBTED_M if doubted else LANDING_M) else None


PHASES: dict[Phase, Callable[[Turn], Phase]] = {
    Phase.LOOK: look,
    Phase.FIND: find,
    Phase.PLAN: plan,
    Phase.MOVE: move,
    Phase.RETRY: retry,
    Phase.RECOVER: recover,
    Phase.ASK: ask,
    Phase.CHECK: check,
}


def helped(operator: Operator, trouble: str) -> bool:
    """Ask for help with some trouble, said in one line; whether another look is worth it."""
    try:
        operator.ask(errand(trouble))
    except NobodyError:
        return False
    return True


class Stopped(BaggieError):
    """The collector cannot go on without a person."""


def stopped(trouble: str) -> Stopped:
    """In one line, for the person who comes."""
    return Stopped(f"collecting stopped: {trouble}; what was recorded is safe, and the same command goes on")


def run_turn(turn: Turn) -> Turn:
    """Run a turn from LOOK to RECORD. Raises `Stopped` when it ends in STOPPED."""
    phase = Phase.LOOK
    while phase is not Phase.RECORD:
        if phase is Phase.STOPPED:
            raise stopped(turn.trouble)
        phase = PHASES[phase](turn)
    return turn


LONG = 2
"""The symmetry of an object that is longer than wide."""


def detect(
    observation: Observation, image_to_robot: ImageToRobot, settings: WorkcellSettings
) -> tuple[Detection, PlanarPose] | None:
    """The object of a workcell's settings, in pixels and in the robot's base frame; None where none is in sight.

    `image_to_robot` is for pictures of this size. The yaw is modulo a quarter turn, a long object's modulo half a turn.
    """
    found = find_bag(observation.color, settings.object_color)
    if found is None:
        return None
    x, y = image_to_robot.to_robot(found.center)[0]
    yaw = image_to_robot.yaw_to_robot(found.center, found.yaw)
    if settings.object_symmetry == LONG:
        yaw = long_yaw(image_to_robot, found.corners, yaw)
    return found, PlanarPose(float(x), float(y), yaw)


def long_yaw(image_to_robot: ImageToRobot, corners: FloatArray, yaw: float) -> float:
    """The angle of a long object's long side; radians in [-pi/2, pi/2).

    `corners` `(4, 2)`, pixels, in turn around it, tell which side is the long one; `yaw`, modulo a quarter turn, its
    angle. A gripper at this angle closes across the narrow side: at yaw 0 fingers open along y.
    """
    sides = np.roll(on_table := image_to_robot.to_robot(corners), -1, axis=0) - on_table
    x, y = sides[int(np.argmax(np.linalg.norm(sides[:2] - sides[2:], axis=1)))]
    quarters = round((math.atan2(y, x) - yaw) / (math.pi / 2))
    return wrap_angle(yaw + quarters * math.pi / 2, math.pi)
