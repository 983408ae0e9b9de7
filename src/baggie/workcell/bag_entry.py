"""What a person writes down about what lies on the table, and how it is to be handled."""

from __future__ import annotations

from typing import Any

from pydantic import Field, model_validator

from baggie.ranges import Color
from baggie.sim.bag import FULL_HEIGHT_M, LONG_ASPECT
from baggie.workcell.entries import Section
from baggie.workcell.handling_rules import Thing

_SIMULATED_M = (0.06, 0.2)
"""Sides of a simulated bag."""


class HandlingEntry(Section):
    """What is written of `Handling`; the rest follows from the object and the gripper, see `handling_rules`."""

    travel_z_m: float | None = None
    approach_z_m: float | None = None
    pick_z_m: float | None = None
    touch_force_n: float | None = None
    land_force_n: float | None = None
    place_z_m: float | None = None
    open_width_m: float | None = None
    grasp_force_n: float | None = None
    release_width_m: float | None = None
    empty_width_m: float | None = None
    fast_m_s: float | None = None
    feel_m_s: float | None = None
    carry_m_s: float | None = None

    @property
    def written(self) -> dict[str, float]:
        """By name."""
        return self.model_dump(exclude_none=True)


class Bag(Section):
    """The bag, or whatever lies there in its place: in a simulated cell all of it, for a real one size and colour."""

    length_m: float = Field(0.12, gt=0.01, lt=0.5)
    width_m: float = Field(0.12, gt=0.01, lt=0.5)
    height_m: float = Field(FULL_HEIGHT_M, gt=0.001, lt=0.5)
    """Of what rests on the table: it is seen, and measured, at half of it."""
    hard: bool = False
    """Whether the fingers hold it by its sides, rather than pinch it."""
    mass_kg: float = Field(0.2, gt=0.02, lt=1.0)
    """In a simulated cell."""
    color: Color = (196, 40, 44)

    @model_validator(mode="after")
    def _length_is_the_longer(self) -> Bag:
        if self.width_m >= LONG_ASPECT * self.length_m:
            raise ValueError(
                f"expected the longer side as length_m, got {self.length_m:g} and a width_m of {self.width_m:g}; "
                "exchange them"
            )
        return self

    @property
    def long(self) -> bool:
        """Whether it looks the same twice a turn only, and is gripped across its width."""
        return self.length_m >= LONG_ASPECT * self.width_m

    @property
    def thing(self) -> Thing:
        """What is handled."""
        return Thing((self.length_m, self.width_m, self.height_m), self.hard, self.long)

    def recorded(self) -> dict[str, Any]:
        """What a recording says of it: `height_m` and `hard`, which older ones do not know, where they are unusual."""
        usual = Bag()
        return self.model_dump(
            mode="json",
            exclude={name for name in ("height_m", "hard") if getattr(self, name) == getattr(usual, name)},
        )

    def check_simulated(self) -> None:
        """Raise `ValueError` for what the simulated bag, a soft pillow, cannot be."""
        low, high = _SIMULATED_M
        for name in ("length_m", "width_m"):
            value = getattr(self, name)
            if not low < value < high:
                raise ValueError(
                    f"bag.{name} is {value:g}, expected {low:g} to {high:g} in a simulated cell, where a smaller "
                    "pillow is so thin between the fingers that they seem empty; change it, or take a real arm"
                )
        if self.height_m != FULL_HEIGHT_M:
            raise ValueError(
                f"bag.height_m is {self.height_m:g}, a simulated bag rests {FULL_HEIGHT_M:g} m high; leave it out"
            )
        if self.hard:
            raise ValueError("bag.hard is true, a simulated bag is soft; leave it out, or take a real arm")
