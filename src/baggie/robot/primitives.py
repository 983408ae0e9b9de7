"""Pick and place, written once for every arm, and with which turn of the wrist.

Height is no part of an action: it is found by touch, so the same action picks from the table or from a stack. Nor is
it said how often the wrist goes round: of all yaws that mean the same those are taken that turn the hand least.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from baggie.errors import ReachError
from baggie.geometry import PlanarPose, ToolPose, nearest_angle
from baggie.robot.arm import Arm, ArmInfo
from baggie.robot.limits import GuardedArm
from baggie.types import PickPlace

_SAME_TURN_RAD = 1e-3
"""Turns that differ by less are equal: the hand is not measured better."""
_ANY = 8
"""Turns that are tried of what looks the same at any angle."""
_WOBBLE_RAD = 0.01
"""An arm foresees turns less exactly than this; one that goes the longer way is off by more."""


@dataclass(frozen=True)
class Handling:
    """How an object likes to be handled. Metres, seconds, newtons; heights are the tool's, above the table."""

    travel_z_m: float = 0.20
    """Where the loaded hand travels: what it carries hangs 6 to 10 cm below it."""
    approach_z_m: float = 0.11
    """Where the empty hand arrives above an object, fast, before it feels its way down."""
    pick_z_m: float = 0.014
    """The lowest the tool goes for a grasp."""
    touch_force_n: float = 10.0
    """Fingertips that feel this stand on something hard; on soft cloth they sink in to `pick_z_m`."""
    land_force_n: float = 10.0
    """Felt when what hangs in the hand is pressed flat on something: let go at the first touch, it would topple."""
    place_z_m: float = 0.024
    """The lowest the tool goes to let go."""
    open_width_m: float = 0.08
    grasp_force_n: float = 10.0
    release_width_m: float = 0.035
    """How far the fingers open to let go, before they rise: further, they would drag the cloth along."""
    empty_width_m: float = 0.002
    """Fingers that close further than this hold nothing."""
    fast_m_s: float = 1.2
    feel_m_s: float = 0.35
    carry_m_s: float = 0.55


@dataclass(frozen=True)
class Grasp:
    """What came of a pick."""

    pose: ToolPose
    """Where the tool was when the gripper closed."""
    width_m: float
    """Between the fingers after the lift."""
    held: bool


@dataclass(frozen=True)
class Release:
    """What came of a place."""

    pose: ToolPose
    """Where the tool was when the gripper opened."""
    width_m: float
    """Between the fingers just before it opened."""
    held: bool
    """Whether there still was something between them."""


def pick(arm: Arm, target: PlanarPose, handling: Handling) -> Grasp:
    """Approach, descend until touch, squeeze, lift, verify by the gripper's width."""
    h = handling
    rise_to(arm, h.approach_z_m, h.fast_m_s)
    arm.move_gripper(h.open_width_m)
    arm.move_to(target.at_height(h.approach_z_m), h.fast_m_s)
    arm.lower_until_contact(h.pick_z_m, h.feel_m_s, h.touch_force_n)
    closed_at = arm.pose()
    arm.grasp(h.grasp_force_n)
    rise_to(arm, h.travel_z_m, h.carry_m_s)
    width = arm.gripper_width()
    return Grasp(closed_at, width, held=width > h.empty_width_m)


def place(arm: Arm, target: PlanarPose, handling: Handling) -> Release:
    """Carry gently, lower until what hangs in the hand stands, let go, retreat straight up."""
    h = handling
    rise_to(arm, h.travel_z_m, h.carry_m_s)
    arm.move_to(target.at_height(h.travel_z_m), h.carry_m_s)
    arm.lower_until_contact(h.place_z_m, h.feel_m_s, h.land_force_n)
    released_at, width = arm.pose(), arm.gripper_width()
    arm.move_gripper(h.release_width_m)
    rise_to(arm, h.approach_z_m, h.fast_m_s)
    return Release(released_at, width, held=width > h.empty_width_m)


def rise_to(arm: Arm, z: float, speed_m_s: float) -> None:
    """Straight up to at least this height."""
    here = arm.pose()
    if here.z < z - 0.01:
        arm.move_to(replace(here, z=z), speed_m_s)


def least_turn(arm: GuardedArm, action: PickPlace, handling: Handling, symmetry: int) -> PickPlace:
    """The action with the yaws (radians, not wrapped) that turn the hand least, of all that mean the same.

    However it was said, it comes out the same; as it was said, where that turns least already. `symmetry`: how often a
    turn what is picked looks the same about its middle, where it is picked; 1 where that is not known, 0 for at any
    angle. Raises `LimitError` where pick or place would, and `ReachError` where the arm can carry out no saying.
    Nothing moves.

    A round tool holds alike at any yaw: it is turned at the pick where the arm could not turn so far at the place.
    """
    here = arm.pose().yaw
    sayings = sorted(
        _sayings(action, here, symmetry, arm.info.tool_symmetry),
        key=lambda saying: _turn_and_tie(saying, here),
    )
    best, least, unreachable = None, math.inf, None
    for saying in sayings:
        if _shortest_turn(saying, here) >= least:
            break
        try:
            # More than the shortest where the wrist has to go the longer way.
            turned = arm.foresee(rehearse(arm, saying, handling))
        except ReachError as error:
            unreachable = unreachable or error
            continue
        if turned < least:
            best, least = saying, turned - _WOBBLE_RAD
    if best is None:
        assert unreachable is not None
        raise unreachable
    return best


def _sayings(action: PickPlace, here: float, symmetry: int, tool: int) -> list[PickPlace]:
    """All that mean the same, each turned the shorter way: from the yaw `here` to the pick, from there to the place.

    `tool`: how often a turn it looks the same itself; of any angle, 0, so many that the wrist gets by its limits.
    """
    pick, place = action.pick, action.place
    if symmetry == 0:  # the hand need not turn at all
        pick, place, symmetry = replace(pick, yaw=here), replace(place, yaw=here), 4
    # The tool may be turned by what looks the same, if at both ends; what the thing is turned by says that already.
    alike = tool or _ANY
    hand = [2 * math.pi * k / alike for k in range(alike // math.gcd(alike, symmetry))]
    thing = [2 * math.pi * k / symmetry for k in range(symmetry)]
    return [
        replace(
            action,
            pick=replace(pick, yaw=(pick_yaw := nearest_angle(pick.yaw + tool_turn + a, here))),
            place=replace(place, yaw=nearest_angle(place.yaw + tool_turn + b, pick_yaw)),
        )
        for tool_turn in hand
        for a in thing
        for b in thing
    ]


def _shortest_turn(action: PickPlace, here: float) -> float:
    return abs(action.pick.yaw - here) + abs(action.place.yaw - action.pick.yaw)


def _turn_and_tie(action: PickPlace, here: float) -> tuple[float, float, float]:
    """What to sort by. Of two that turn equally the counterclockwise comes first, so that it is always the same."""
    turn, pick, place = _shortest_turn(action, here), action.pick.yaw, action.place.yaw
    return round(turn / _SAME_TURN_RAD), -round(pick / _SAME_TURN_RAD), -round(place / _SAME_TURN_RAD)


def rehearse(arm: GuardedArm, action: PickPlace, handling: Handling) -> list[ToolPose]:
    """The poses that pick and place would lead through, down to their lowest heights. Nothing moves.

    Raises `LimitError` for whatever the gate would refuse on the way: places, heights, speeds, forces, widths.
    """
    paper = _PaperArm(arm.info, arm.pose())
    gate = GuardedArm(paper, arm.limits)
    pick(gate, action.pick, handling)
    place(gate, action.place, handling)
    return paper.way[1:]


class _PaperArm:
    """An arm on paper: at once wherever it is sent, it remembers the way and touches nothing."""

    def __init__(self, info: ArmInfo, at: ToolPose) -> None:
        self.info = info
        self.way = [at]
        self._width = 0.0

    def pose(self) -> ToolPose:
        return self.way[-1]

    def move_to(self, target: ToolPose, speed_m_s: float) -> ToolPose:
        self.way.append(target)
        return target

    def lower_until_contact(self, z_min: float, speed_m_s: float, force_n: float) -> ToolPose:
        return self.move_to(replace(self.pose(), z=min(self.pose().z, z_min)), speed_m_s)

    def move_gripper(self, width_m: float) -> float:
        self._width = width_m
        return width_m

    def grasp(self, force_n: float) -> float:
        return self.move_gripper(0.0)

    def gripper_width(self) -> float:
        return self._width

    def park(self) -> ToolPose:
        return self.pose()

    def stop(self) -> None:
        return None
