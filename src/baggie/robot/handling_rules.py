"""How an object is handled follows from what it is and from what arm and limits allow; what a person wrote wins.

A soft bag of 12 x 12 x 3 cm gets `Handling()` as it is. Drawings: docs/handling.md.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Literal

from baggie.robot.arm import ArmInfo
from baggie.robot.limits import Limits
from baggie.robot.primitives import Handling

Source = Literal["written", "the object", "the gripper", "the arm", "the limits", "default"]
"""Where an entry comes from."""

ABOVE_M = 0.08
"""So far above whatever may lie there the fingertips arrive, or what is carried passes."""
HANGS = 0.75
"""Of its length hangs below the hand that carries a soft thing by its middle."""
FINGERS_M = 0.04
"""So long are fingers below the palm: they close no lower than this below the top of a hard object."""
ROOM_M = 0.005
"""The least that a hand must be wider than a hard object on either side of it, for where it is seen is not exact."""
WIDER_M = 0.02
"""How much wider, on either side, a hand opens where it can; and to let go, half as much."""
BELOW_M = 0.005
"""So far below where it stood when it was grasped a hard object is felt for."""
PRESS_N_S_M = 600.0
"""By how much more than asked for a hard object presses, for each m/s it comes down at: of an arm that goes on for 60
ms after it has felt something, and gives way by a millimetre for 10 N."""
SLOWEST_M_S = 0.02
"""No thing has to be felt for more slowly."""
WIDEST_M = 0.5
"""No two fingers open further."""


@dataclass(frozen=True)
class Thing:
    """What is handled."""

    size_m: tuple[float, float, float]
    """Length, width and resting height."""
    hard: bool = False
    long: bool = False
    """Whether it is gripped across its width only, rather than any two sides."""

    @property
    def gripped_m(self) -> float:
        """The most that may be between the fingers."""
        length, width, _ = self.size_m
        return width if self.long else max(length, width)

    def handling(self, usual: Handling, limits: Limits) -> dict[str, float]:
        """What follows from it, whatever the arm."""
        height = self.size_m[2]
        above = {"approach_z_m": max(usual.approach_z_m, height + ABOVE_M)}
        if not self.hard:
            # The hand pinches a soft thing, so it opens as wide as always, to grasp and to let go.
            over = height + HANGS * max(self.size_m[:2]) + ABOVE_M
            return {**above, "travel_z_m": max(usual.travel_z_m, over)}
        grip_z = max(height / 2, height - FINGERS_M)
        spare_n = limits.max_contact_force_n - max(usual.touch_force_n, usual.land_force_n)
        return {
            **above,
            "travel_z_m": max(usual.travel_z_m, grip_z + height + ABOVE_M),
            "pick_z_m": grip_z,
            "place_z_m": grip_z - BELOW_M,
            "open_width_m": max(usual.open_width_m, self.gripped_m + 2 * WIDER_M),
            "release_width_m": self.gripped_m + WIDER_M,
            "empty_width_m": max(usual.empty_width_m, min(self.size_m) / 2),
            "feel_m_s": min(usual.feel_m_s, max(SLOWEST_M_S, spare_n / PRESS_N_S_M)),
        }


@dataclass(frozen=True)
class Handled:
    """How it is handled, and why so."""

    handling: Handling
    sources: Mapping[str, Source]
    """Of each entry."""


def handled(
    thing: Thing,
    limits: Limits,
    arm: ArmInfo | None = None,
    written: Mapping[str, float] | None = None,
    usual: Handling | None = None,
) -> Handled:
    """What is `written`; of the rest what follows from the object, as far as the arm, where it is known, and limits go.

    `usual`: of what follows from nothing; `Handling()` unless given.
    """
    usual, written = usual or Handling(), written or {}
    follows = thing.handling(usual, limits)
    values: dict[str, float] = {**asdict(usual), **{name: round(value, 4) for name, value in follows.items()}}
    sources: dict[str, Source] = {name: "the object" if name in follows else "default" for name in values}
    for name, lowest, highest, source in _bounds(limits, arm):
        within = min(max(values[name], lowest), highest)
        if within != values[name] and name not in written:
            values[name], sources[name] = within, source
    for name, value in written.items():
        values[name], sources[name] = value, "written"
    return Handled(replace(usual, **values), sources)


def _bounds(limits: Limits, arm: ArmInfo | None) -> Iterator[tuple[str, float, float, Source]]:
    """Each entry that has bounds, from and to, and whose they are."""
    for name in ("travel_z_m", "approach_z_m", "pick_z_m", "place_z_m"):
        yield name, limits.z_min_m, limits.z_max_m, "the limits"
    for name in ("fast_m_s", "feel_m_s", "carry_m_s"):
        yield name, 0.0, limits.max_speed_m_s, "the limits"
        if arm is not None:
            yield name, 0.0, arm.max_speed_m_s, "the arm"
    for name in ("touch_force_n", "land_force_n", "top_force_n", "stand_force_n"):
        yield name, 0.0, limits.max_contact_force_n, "the limits"
    yield "grasp_force_n", 0.0, limits.max_grasp_force_n, "the limits"
    if arm is not None:
        yield "grasp_force_n", 0.0, arm.max_force_n, "the gripper"
    for name in ("open_width_m", "release_width_m"):
        yield name, 0.0, WIDEST_M if arm is None else arm.max_width_m, "the gripper"
    if (
        arm is not None
    ):  # a suction cup has no width while it holds nothing, and as little as it likes while it does
        yield "empty_width_m", 0.0, max(Handling().empty_width_m, arm.max_width_m / 2), "the gripper"


def contradiction(handling: Handling, thing: Thing, limits: Limits, arm: ArmInfo | None = None) -> str | None:
    """What in it contradicts itself, the object, the limits or the arm where it is known: one line, or None."""
    return next(
        (
            line
            for lines in (
                _beyond_limits(handling, limits),
                _upside_down(handling),
                [] if arm is None else _beyond_arm(handling, thing, arm),
                _against_the_thing(handling, thing),
            )
            for line in lines
        ),
        None,
    )


def _beyond_limits(handling: Handling, limits: Limits) -> Iterator[str]:
    for name, highest in (
        ("fast_m_s", limits.max_speed_m_s),
        ("feel_m_s", limits.max_speed_m_s),
        ("carry_m_s", limits.max_speed_m_s),
        ("touch_force_n", limits.max_contact_force_n),
        ("land_force_n", limits.max_contact_force_n),
        ("top_force_n", limits.max_contact_force_n),
        ("stand_force_n", limits.max_contact_force_n),
        ("grasp_force_n", limits.max_grasp_force_n),
    ):
        value = getattr(handling, name)
        if not 0 < value <= highest:
            yield f"handling.{name} is {value:g}, the limits allow up to {highest:g}; lower it"
    for name in ("travel_z_m", "approach_z_m"):
        value = getattr(handling, name)
        if not limits.z_min_m <= value <= limits.z_max_m:
            yield (
                f"handling.{name} is {value:g}, the limits allow {limits.z_min_m:g} to {limits.z_max_m:g}; change it"
            )
    if not min(handling.pick_z_m, handling.place_z_m) >= limits.z_min_m:
        yield (
            f"handling.pick_z_m and place_z_m are {handling.pick_z_m:g} and {handling.place_z_m:g}, the limits "
            f"allow no less than {limits.z_min_m:g}; raise them"
        )
    for name in ("open_width_m", "release_width_m", "empty_width_m"):
        value = getattr(handling, name)
        if not 0 <= value <= WIDEST_M:
            yield f"handling.{name} is {value:g}, expected metres from 0 to {WIDEST_M:g}; change it"


def _upside_down(handling: Handling) -> Iterator[str]:
    for name, above in (("pick_z_m", "approach_z_m"), ("place_z_m", "travel_z_m")):
        value, highest = getattr(handling, name), getattr(handling, above)
        if value > highest:
            yield f"handling.{name} is {value:g}, the hand comes down from handling.{above}, {highest:g}; lower it"


def _beyond_arm(handling: Handling, thing: Thing, arm: ArmInfo) -> Iterator[str]:
    for name in ("open_width_m", "release_width_m"):
        value = getattr(handling, name)
        if value > arm.max_width_m:
            yield f"handling.{name} is {value:g}, the gripper of {arm.name} opens to {arm.max_width_m:g}; lower it"
    for name in ("fast_m_s", "feel_m_s", "carry_m_s"):
        value = getattr(handling, name)
        if value > arm.max_speed_m_s:
            yield f"handling.{name} is {value:g}, {arm.name} moves at up to {arm.max_speed_m_s:g} m/s; lower it"
    if handling.grasp_force_n > arm.max_force_n:
        yield (
            f"handling.grasp_force_n is {handling.grasp_force_n:g}, the gripper of {arm.name} squeezes with up to "
            f"{arm.max_force_n:g} N; lower it"
        )
    room = thing.gripped_m + 2 * ROOM_M
    if thing.hard and 0 < arm.max_width_m < room:  # a suction cup opens to nothing
        yield (
            f"the bag is hard and {thing.gripped_m:g} m wide, the gripper of {arm.name} opens to {arm.max_width_m:g}, "
            f"and needs {room:g} to go over it; take a narrower one, or another gripper"
        )


def _against_the_thing(handling: Handling, thing: Thing) -> Iterator[str]:
    width, height = thing.gripped_m, thing.size_m[2]
    if handling.approach_z_m <= height:
        yield f"handling.approach_z_m is {handling.approach_z_m:g}, the bag is {height:g} m high; raise it"
    if not thing.hard:
        return
    if handling.pick_z_m >= height:
        yield (
            f"handling.pick_z_m is {handling.pick_z_m:g}, the bag is hard and {height:g} m high, so the fingers close "
            "above it; lower it, and limits.z_min_m, where your fingers may go lower"
        )
    if not handling.open_width_m:  # a suction cup
        return
    room = width + 2 * ROOM_M
    if handling.open_width_m < room:
        yield (
            f"handling.open_width_m is {handling.open_width_m:g}, a hand needs {room:g} to go over a hard bag "
            f"{width:g} m wide; raise it, or leave it out"
        )
    if handling.release_width_m < width + ROOM_M:
        yield (
            f"handling.release_width_m is {handling.release_width_m:g}, which never lets go of a hard bag {width:g} m "
            f"wide; raise it to {width + ROOM_M:g} or more, or leave it out"
        )
    if handling.empty_width_m >= (thin := min(thing.size_m[:2])):
        yield (
            f"handling.empty_width_m is {handling.empty_width_m:g}, the bag is hard and {thin:g} m thin, so a hand "
            "that holds it counts as empty; lower it, or leave it out"
        )
