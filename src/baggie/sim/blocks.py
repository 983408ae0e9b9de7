"""Rigid things made of boxes: blocks that can be carried and stacked, fixtures that stay where they are put."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

Size = tuple[float, float, float]
Color = tuple[int, int, int]

WOOD_KG_M3 = 600.0
# Stacks stand still on contacts that are as stiff as steps of 4 ms allow, without friction that creeps.
_CONTACT = 'friction="0.8 0.005 0.0001" solref="0.01 1" solimp="0.95 0.99 0.001" condim="3"'


@dataclass(frozen=True)
class Block:
    """A solid box that moves freely; its frame is at its middle."""

    name: str
    size_m: Size = (0.04, 0.04, 0.04)
    color: Color = (200, 60, 50)
    """RGB."""
    density: float = WOOD_KG_M3
    """kg/m³."""

    @property
    def mass_kg(self) -> float:
        """What it weighs."""
        return float(self.density * np.prod(self.size_m))


@dataclass(frozen=True)
class Part:
    """One box of a fixture."""

    size_m: Size
    color: Color
    """RGB."""
    position_m: Size
    """Of its middle, in the fixture's frame."""


@dataclass(frozen=True)
class Fixture:
    """Boxes that are one rigid body and give way to nothing; its frame is at the middle of what lies on the table."""

    name: str
    parts: tuple[Part, ...]


def stand(
    name: str = "stand",
    colors: tuple[Color, Color, Color] = ((70, 70, 70), (130, 130, 130), (190, 190, 190)),
    plate_m: Size = (0.04, 0.04, 0.005),
) -> Fixture:
    """Three plates in a row along y, each in a shade (RGB) of its own, so that a picture shows which way it lies."""
    places = [(0.0, (number - 1) * plate_m[1], plate_m[2] / 2) for number in range(3)]
    return Fixture(name, tuple(Part(plate_m, color, at) for color, at in zip(colors, places, strict=True)))


def block_xml(block: Block) -> str:
    """A free body of this name, its joint's and its geom's too."""
    return f"""
    <body name="{block.name}">
      <freejoint name="{block.name}"/>
      <geom name="{block.name}" {_box(block.size_m, block.color)} density="{block.density}" {_CONTACT}/>
    </body>"""


def fixture_xml(fixture: Fixture) -> str:
    """A body of this name that moves only when it is put somewhere, at first under the table."""
    geoms = "".join(
        f"""
      <geom {_box(part.size_m, part.color)} pos="{_numbers(part.position_m)}" {_CONTACT}/>"""
        for part in fixture.parts
    )
    return f"""
    <body name="{fixture.name}" mocap="true" pos="0.4 0 -0.4">{geoms}
    </body>"""


def _box(size_m: Size, color: Color) -> str:
    half = [side / 2 for side in size_m]
    return f'type="box" size="{_numbers(half)}" rgba="{_numbers([value / 255 for value in color])} 1"'


def _numbers(values: Size | list[float]) -> str:
    return " ".join(f"{value:.6f}" for value in values)
