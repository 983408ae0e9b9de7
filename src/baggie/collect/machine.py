"""One turn of collecting, as a small state machine: each state is a function from the turn to the next state.

    LOOK ──► FIND ──► PLAN ──► MOVE ──► CHECK ──► RECORD
     ▲        │         │        │
     │     RECOVER      │      RETRY  (missed grasp, unreachable: a fresh look, up to three tries)
     │        │         │        │
     ├────────┴─► ASK ◄─┘        │
     │             │             │
     └─────────────┼─────────────┘
                STOPPED  (nobody helped)

MOVE is the workcell's own pick (with its check of the gripper's width), carry and place.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from baggie.calibration.image_to_robot.map import ImageToRobot
from baggie.collect.cell import Ask, CollectorCell
from baggie.collect.detect import LONG, detect
from baggie.collect.places import (
    false_45,
    grip_yaw,
    long_place_yaw,
    nearest_grip,
    random_place,
)
from baggie.errors import BaggieError, LimitError, ReachError
from baggie.geometry import PlanarPose
from baggie.types import Failure, Observation, Outcome, PickPlace
from baggie.vision.color_mask import Detection
from baggie.workcell.handling_rules import ROOM_M

MAX_TRIES = 3
MAX_LOOKS = 3
MAX_RESCUES = 2
UNMOVED_M = 0.02
"""An object said to be carried 20 cm that is still this close to where it was has not been moved."""
LANDING_M = 0.06
"""How far from where it was let go an object may be found and still count as put down there."""
LANDING_DOUBTED_M = 0.09
"""The same when it was gripped across its corners, after a doubtful reading of 45 degrees."""


class State(Enum):
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


@dataclass
class Turn:
    """What one turn knows; every state reads and adds to it."""

    cell: CollectorCell
    image_to_robot: ImageToRobot
    rng: np.random.Generator
    ask: Ask
    doubted_before: bool = False
    """Whether the turn before read 45 degrees and did not believe it."""
    before: Observation | None = None
    found: Detection | None = None
    pose: PlanarPose | None = None
    """The object as detected, robot base frame."""
    doubted: bool = False
    action: PickPlace | None = None
    outcome: Outcome | None = None
    after: Observation | None = None
    found_after: Detection | None = None
    truth_before: PlanarPose | None = None
    tries: int = 0
    looks: int = 0
    rescues: int = 0
    trouble: str = ""
    """What a person is told, when asked or when everything stops."""

    def detect(self, observation: Observation) -> tuple[Detection, PlanarPose] | tuple[None, None]:
        """The object in a picture, in pixels and in the robot's base frame."""
        return detect(observation, self.image_to_robot, self.cell.settings) or (None, None)


def look(turn: Turn) -> State:
    """Take a picture with the arm out of the way."""
    turn.before = turn.cell.look()
    turn.truth_before = turn.cell.truth()
    turn.looks += 1
    return State.FIND


def find(turn: Turn) -> State:
    """Find the object by its colour."""
    assert turn.before is not None
    turn.found, turn.pose = turn.detect(turn.before)
    if turn.found is None:
        turn.trouble = "the object is not in sight: put it back into the workspace"
        return State.RECOVER
    return State.PLAN


def plan(turn: Turn) -> State:
    """Grip it where it lies, or where it can still be reached; put it down elsewhere, squared up."""
    assert turn.pose is not None
    settings, pose = turn.cell.settings, turn.pose
    reach = ROOM_M if settings.object_hard else min(settings.object_size_m[:2]) / 3
    grip = nearest_grip(settings.limits.workspace, pose.x, pose.y, reach)
    if grip is None:
        turn.trouble = (
            f"the object at x {pose.x:.2f} m, y {pose.y:.2f} m is out of reach: "
            f"put it back into the workspace, {settings.workspace}"
        )
        return State.ASK
    long = settings.object_symmetry == LONG
    # What was not grasped one way is tried the other: a hard square at 45 degrees goes into no hand that stays square.
    believed = turn.doubted_before != (turn.tries % 2 == 1)
    turn.doubted = not long and false_45(pose.yaw) and not believed
    pick = PlanarPose(*grip, pose.yaw if long else grip_yaw(pose.yaw, believed))
    place = random_place(settings.workspace, pick, turn.rng)
    turn.action = PickPlace(pick, replace(place, yaw=long_place_yaw(pick.yaw, turn.rng)) if long else place)
    return State.MOVE


def move(turn: Turn) -> State:
    """Pick, carry, place."""
    assert turn.action is not None
    turn.tries += 1
    try:
        turn.outcome = turn.cell.execute(turn.action)
    except (LimitError, ReachError) as error:
        turn.outcome = Outcome(turn.action, failure="unreachable")
        turn.trouble = f"the arm did not get there ({error}): put the object into the middle of the workspace"
    return State.RETRY if turn.outcome.failure in ("missed-grasp", "unreachable") else State.CHECK


def retry(turn: Turn) -> State:
    """Try again after a fresh look, a limited number of times."""
    if turn.tries >= MAX_TRIES:
        return State.CHECK
    turn.looks = 0
    return State.LOOK


def recover(turn: Turn) -> State:
    """Look again: a soft thing may still have been rolling, a shadow may have passed."""
    return State.LOOK if turn.looks < MAX_LOOKS else State.ASK


def ask(turn: Turn) -> State:
    """Have the cell help itself, a limited number of times; then ask a person, for as long as anybody answers."""
    turn.looks = 0
    turn.rescues += 1
    rescued = turn.rescues <= MAX_RESCUES and turn.cell.rescue()
    return State.LOOK if rescued or turn.ask(turn.trouble) else State.STOPPED


def check(turn: Turn) -> State:
    """Look again: is the object where it was let go?"""
    assert turn.outcome is not None
    assert turn.pose is not None
    turn.after = turn.cell.look()
    turn.found_after, landed = turn.detect(turn.after)
    failure = turn.outcome.failure or _landing(turn.pose, turn.outcome.executed.place, landed, turn.doubted)
    if failure is None and landed is not None and turn.cell.watch is not None:
        turn.cell.watch.landed(turn.outcome.executed.place, landed)
    turn.outcome = replace(turn.outcome, failure=failure, tries=turn.tries)
    return State.RECORD


def _landing(
    start: PlanarPose, released: PlanarPose, landed: PlanarPose | None, doubted: bool
) -> Failure | None:
    if landed is None:
        return "lost-bag"
    if landed.distance(start) < UNMOVED_M:
        return "stalled"
    return "dropped" if landed.distance(released) > (LANDING_DOUBTED_M if doubted else LANDING_M) else None


STATES: dict[State, Callable[[Turn], State]] = {
    State.LOOK: look,
    State.FIND: find,
    State.PLAN: plan,
    State.MOVE: move,
    State.RETRY: retry,
    State.RECOVER: recover,
    State.ASK: ask,
    State.CHECK: check,
}


class Stopped(BaggieError):
    """The collector cannot go on without a person."""


def stopped(trouble: str) -> Stopped:
    """In one line, for the person who comes."""
    return Stopped(f"collecting stopped: {trouble}; what was recorded is safe, and the same command goes on")


def run_turn(turn: Turn) -> Turn:
    """Run a turn from LOOK to RECORD. Raises `Stopped` when it ends in STOPPED."""
    state = State.LOOK
    while state is not State.RECORD:
        if state is State.STOPPED:
            raise stopped(turn.trouble)
        state = STATES[state](turn)
    return turn
