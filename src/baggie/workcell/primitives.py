"""Pick and place, written once for every arm.

Height is no part of an action: it is found by touch, so the same action picks from the table or from a stack.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from baggie.geometry import PlanarPose, ToolPose
from baggie.workcell.arm import Arm


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
    land_force_n: float = 3.0
    """Felt when what hangs in the hand stands on something."""
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
