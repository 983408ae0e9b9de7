"""Pick and place, written once for every arm, from the table and from stacks, and with which turn of the wrist.

An action says what lies below, where that is known or counted. On the table the hand goes as low as follows from it,
and touch is the guard. Above it bags lie some millimetres higher or lower than counted, so arms that can feel for them;
where nothing is known they have to.
Nor is it said how often the wrist goes round: of all yaws that mean the same those are taken that turn the hand least.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from baggie.errors import LimitError, ReachError
from baggie.geometry import PlanarPose, ToolPose, nearest_angle
from baggie.robot.arm import Arm, ArmInfo
from baggie.robot.limits import GuardedArm
from baggie.types import PickPlace

_SAME_TURN_RAD = 1e-3
"""Turns that differ by less are equal: the hand is not measured better."""
_ANY = 8
"""Turns that are tried of what looks the same at any angle."""
_FINELY = 3
"""So many times more slowly the hand comes down to feel for what is soft."""
_LOWER_M = 0.012
"""So much lower than counted what lies above the table is felt for, or, where it is soft, taken without feeling."""
_SHORT_M = 0.025
"""Until so much short of where it is counted the hand comes down as ever,"""
_STRAY_M = 0.003
"""and is not further from there then, unless something was in the way."""
_WOBBLE_RAD = 0.01
"""An arm foresees turns less exactly than this; one that goes the longer way is off by more."""


@dataclass(frozen=True)
class Handling:
    """How an object likes to be handled. Metres, seconds, newtons; heights are the tool's, above what it lies on."""

    travel_z_m: float = 0.20
    """Where the loaded hand travels: what it carries hangs 6 to 10 cm below it. Above the tallest stack, too."""
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
    release_width_m: float = 0.08
    """How far the fingers open to let go, before they rise: cloth that they still touch then they drag along."""
    empty_width_m: float = 0.002
    """Fingers that close further than this hold nothing."""
    top_force_n: float = 0.7
    """Where nobody knows how high a soft thing lies, its top is where the fingertips feel this."""
    sink_m: float = 0.018
    """So far below its top they grasp it then."""
    stand_force_n: float = 1.5
    """Where nobody knows how high it shall be placed, what hangs in the hand begins to stand where this is felt."""
    press_m: float = 0.016
    """So much lower it is let go then."""
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


def pick(
    arm: Arm, target: PlanarPose, handling: Handling, on_m: float | None = 0.0, tallest_m: float = 0.0
) -> Grasp:
    """Approach, descend until touch, squeeze, lift, verify by the gripper's width.

    `on_m`, `tallest_m`: as `PickPlace` says them of the pick. Raises `LimitError` where the height is not known and the
    arm feels too little to find it.
    """
    h, over_m = handling, max(on_m or 0.0, tallest_m)
    rise_to(arm, over_m + h.approach_z_m, h.fast_m_s)
    arm.move_gripper(h.open_width_m)
    arm.move_to(target.at_height(over_m + h.approach_z_m), h.fast_m_s)
    if on_m is not None and on_m < over_m:
        arm.move_to(target.at_height(on_m + h.approach_z_m), h.fast_m_s)
    _feel_down(arm, h, on_m, _Descent(h.pick_z_m, h.touch_force_n, h.top_force_n, h.sink_m))
    closed_at = arm.pose()
    arm.grasp(h.grasp_force_n)
    rise_to(arm, over_m + h.travel_z_m, h.carry_m_s)
    width = arm.gripper_width()
    return Grasp(closed_at, width, held=width > h.empty_width_m)


def place(
    arm: Arm, target: PlanarPose, handling: Handling, on_m: float | None = 0.0, tallest_m: float = 0.0
) -> Release:
    """Carry gently, lower until what hangs in the hand stands, let go, retreat straight up.

    `on_m`, `tallest_m`: as `PickPlace` says them of the place. Raises `LimitError` as `pick` does.
    """
    h, over_m = handling, max(on_m or 0.0, tallest_m)
    rise_to(arm, over_m + h.travel_z_m, h.carry_m_s)
    arm.move_to(target.at_height(over_m + h.travel_z_m), h.carry_m_s)
    if on_m is not None and on_m < over_m:
        arm.move_to(target.at_height(on_m + h.travel_z_m), h.carry_m_s)
    _feel_down(arm, h, on_m, _Descent(h.place_z_m, h.land_force_n, h.stand_force_n, h.press_m))
    released_at, width = arm.pose(), arm.gripper_width()
    arm.move_gripper(h.release_width_m)
    rise_to(arm, over_m + h.approach_z_m, h.fast_m_s)
    return Release(released_at, width, held=width > h.empty_width_m)


@dataclass(frozen=True)
class _Descent:
    """How the tool comes down to a soft thing."""

    z: float
    """The lowest it goes, above what lies there."""
    guard_n: float
    """It stops where it feels this."""
    first_n: float
    """What it feels first, where nobody knows what lies there,"""
    further_m: float
    """and by how much it goes further then."""


def _feel_down(arm: Arm, handling: Handling, on_m: float | None, descent: _Descent) -> None:
    """Lower the tool as a descent says, onto what is `on_m` above the table, or is felt for where that is not known."""
    feel_m_s, feels = handling.feel_m_s, arm.info.feels_n <= descent.first_n
    if on_m is not None and not (feels and on_m > 0):
        arm.lower_until_contact(on_m + descent.z, feel_m_s, descent.guard_n)
        return
    if not feels:
        raise LimitError(
            f"expected an arm that feels {descent.first_n:g} N, to find out how high a soft thing lies, got "
            f"{arm.info.name}, which feels {arm.info.feels_n:g} N; say the height of what lies below "
            "(PickPlace.pick_on_m, place_on_m)"
        )
    lowest = descent.z
    if on_m is not None:
        lowest += max(on_m - _LOWER_M, 0.0)
        short_m = on_m + descent.z + descent.further_m + _SHORT_M
        # Fast, so a load that swings is felt, too: only what is clearly in the way counts.
        if arm.lower_until_contact(short_m, feel_m_s, descent.guard_n).z > short_m + _STRAY_M:
            return
    touched = arm.lower_until_contact(lowest, feel_m_s / _FINELY, descent.first_n)
    if touched.z > lowest:
        lower = max(touched.z - descent.further_m, lowest)
        arm.lower_until_contact(lower, feel_m_s / _FINELY, descent.guard_n)


def lowered(action: PickPlace, arm: ArmInfo, handling: Handling, hard: bool) -> PickPlace:
    """The action with the pick at which an arm that cannot feel how high a soft thing lies takes it from a stack.

    Stacks sink together: fingers that close where it is counted hold its top fold only, and lose it.
    """
    counted_m = action.pick_on_m
    if hard or not counted_m or arm.feels_n <= handling.top_force_n:
        return action
    tallest_m = max(counted_m, action.tallest_m)
    return replace(action, pick_on_m=max(counted_m - _LOWER_M, 0.0), tallest_m=tallest_m)


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
    pick(gate, action.pick, handling, action.pick_on_m, action.tallest_m)
    place(gate, action.place, handling, action.place_on_m, action.tallest_m)
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
