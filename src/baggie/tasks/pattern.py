"""Patterns of stacked bags: towers, pyramids and layers, as slots with layers in a frame of their own.

In words, or in a YAML file that holds either the words or all slots:

- `tower:3`: three bags on each other;
- `pyramid:3-2-1`: three bags in a row along the pattern's y, two over the gaps between them, one on top;
- `layers:2x2,2x2 turned`: layers of rows along x by y; one that is `turned` lies at 45 degrees, its bags with it;
- `slots:` and a list of `{x: 0.0, y: 0.0, yaw_deg: 0, layer: 0}`: any other; metres, in the pattern's frame.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from baggie.errors import BaggieError
from baggie.files import parse_yaml, read_text
from baggie.geometry import FloatArray, PlanarPose, Rectangle
from baggie.types import LAYER_M, Image
from baggie.vision.draw import paint_layers

MOST_BAGS = 8
"""Of a pattern: a simulated arm takes seconds of a processor for each, and more the higher they lie."""
PITCH_M = 0.13
"""Between the middles of bags side by side, of 12 cm each: what is laid there by a hand touches no other."""
SUPPORT_M = 0.09
"""A bag is carried by those of the layer below whose middles are so near to its own."""
_APART_M = 0.12
"""Between two slots of a layer at least: bags are as wide."""
_STRAIGHT_M = 0.01
"""A slot so near above another stands straight on it."""
_ROUNDING_M = 1e-9
"""A pattern stays one when it is moved."""
_WORDS = "tower:3, pyramid:3-2-1, layers:2x2,2x2 turned or `slots:` with a list"
PATTERN_FILES = (".yaml", ".yml")
"""How the names of files with patterns end."""
_GRID = re.compile(r"([1-9])x([1-9])( turned)?")

Outline = Callable[[PlanarPose, int], FloatArray]
"""Where a bag at a pose appears, in a layer: `(4, 2)` pixels (u, v), as `Workcell.outline` says them."""


@dataclass(frozen=True)
class PatternSlot:
    """Where one bag of a pattern goes."""

    pose: PlanarPose
    """Of the bag's middle, and of the hand that lays it: its fingers open along the pose's y axis.

    The bag lies so, too, modulo the turns that it looks the same by.
    """
    layer: int
    """0 lies on the table."""


@dataclass(frozen=True)
class Pattern:
    """Slots for bags, each of which lies on the table or on others.

    Raises `BaggieError` for no slot or more than `MOST_BAGS`, for a slot that rests on none of the layer below, and for
    two of a layer that are nearer than a bag is wide.
    """

    slots: tuple[PatternSlot, ...]
    """In the order of building: layer by layer, within a layer as they were given."""

    def __post_init__(self) -> None:
        slots = tuple(sorted(self.slots, key=lambda slot: slot.layer))
        object.__setattr__(self, "slots", slots)
        if not 1 <= len(slots) <= MOST_BAGS:
            raise BaggieError(
                f"expected a pattern of 1 to {MOST_BAGS} bags in all, got {len(slots)}; take fewer layers, or shorter "
                "ones"
            )
        for number, slot in enumerate(slots):
            if slot.layer != 0 and not self.supports(number):
                raise BaggieError(
                    f"expected every slot above layer 0 on one of the layer below, at most {100 * SUPPORT_M:.0f} cm "
                    f"beside its middle, got {_said(slot)} on nothing; put a slot of layer {slot.layer - 1} there, or "
                    "move it"
                )
            beside = [other for other in slots[:number] if other.layer == slot.layer]
            for other in beside:
                if slot.pose.distance(other.pose) < _APART_M - _ROUNDING_M:
                    raise BaggieError(
                        f"expected slots of a layer at least {100 * _APART_M:.0f} cm apart, as bags are as wide, got "
                        f"{_said(other)} and {_said(slot)}; move one of them"
                    )

    @classmethod
    def parse(cls, text: str, source: str | Path = "the pattern") -> Pattern:
        """The pattern that a text says: in words, or in YAML with all slots.

        Raises `BaggieError` for anything else, with `source` named where the YAML is wrong.
        """
        written = parse_yaml(text, source)
        match written:
            case str() if ":" in written:
                kind, _, sizes = written.partition(":")
                make = {"tower": _tower, "pyramid": _pyramid, "layers": _layers}.get(kind)
                slots = make(sizes) if make else None
            case {"slots": [*listed], **others} if not others:
                slots = [_slot(each, source) for each in listed]
            case _:
                slots = None
        if slots is None:
            said = " ".join(str(text).split())
            raise BaggieError(
                f"expected a pattern such as {_WORDS}, got {said!r}; write it so, each row of a pyramid shorter "
                "than the one below it"
            )
        return cls(tuple(slots))

    @classmethod
    def given(cls, words: str) -> Pattern:
        """The pattern in words, or in the YAML file with this name. Raises `BaggieError` for what is neither."""
        path = Path(words)
        if path.suffix not in PATTERN_FILES:
            return cls.parse(words)
        try:
            return cls.read(path)
        except OSError as error:
            raise BaggieError(
                f"expected a file with a pattern at {path}, got none ({error.strerror}); write {_WORDS}"
            ) from None

    @classmethod
    def read(cls, path: Path) -> Pattern:
        """The pattern in a YAML file. Raises `OSError`, `DataError` for what is no text, and what `parse` does."""
        return cls.parse(read_text(path), path)

    def to_yaml(self) -> str:
        """All slots as `parse` reads them again: metres and degrees to six decimals."""
        slots = [
            {
                "x": round(slot.pose.x, 6) + 0.0,
                "y": round(slot.pose.y, 6) + 0.0,
                "yaw_deg": round(math.degrees(slot.pose.yaw), 6),
                "layer": slot.layer,
            }
            for slot in self.slots
        ]
        return str(yaml.safe_dump({"slots": slots}, sort_keys=False, default_flow_style=None))

    def at(self, site: PlanarPose) -> Pattern:
        """The pattern in the frame that its own is at `site` in, such as the robot's base frame."""
        return Pattern(tuple(replace(slot, pose=site @ slot.pose) for slot in self.slots))

    @property
    def layers(self) -> tuple[tuple[int, ...], ...]:
        """The numbers of the slots of each layer, from below."""
        top = self.slots[-1].layer
        return tuple(
            tuple(number for number, slot in enumerate(self.slots) if slot.layer == layer)
            for layer in range(top + 1)
        )

    def supports(self, slot: int) -> tuple[int, ...]:
        """The numbers of the slots of the layer below that carry the slot with this number; none on the table."""
        carried = self.slots[slot]
        return tuple(
            number
            for number, below in enumerate(self.slots)
            if below.layer == carried.layer - 1
            and below.pose.distance(carried.pose) <= SUPPORT_M + _ROUNDING_M
        )

    def straight_on(self, slot: int) -> int | None:
        """The number of the one slot that this one stands straight on; None on the table and over a gap."""
        supports = self.supports(slot)
        if len(supports) != 1:
            return None
        straight = self.slots[supports[0]].pose.distance(self.slots[slot].pose) <= _STRAIGHT_M
        return supports[0] if straight else None

    def check_fits(self, workspace: Rectangle, margin_m: float = 0.0) -> None:
        """Raise `BaggieError` unless the middle of every slot is in the workspace, `margin_m` from its edges."""
        for slot in self.slots:
            if workspace.contains(slot.pose.x, slot.pose.y, margin_m):
                continue
            inside = Rectangle(
                workspace.x_min + margin_m,
                workspace.x_max - margin_m,
                workspace.y_min + margin_m,
                workspace.y_max - margin_m,
            )
            x, y = inside.nearest(slot.pose.x, slot.pose.y)
            beyond = math.hypot(slot.pose.x - x, slot.pose.y - y)
            raise BaggieError(
                f"expected all of the pattern within {inside}, got {_said(slot)}, which is {100 * beyond:.1f} cm "
                "outside; move the site, turn it, or take a smaller pattern"
            )

    def outlines(self, length_m: float, width_m: float) -> FloatArray:
        """`(S, 4, 3)` metres: the corners of a bag of this size in each slot, at half the height of its layer."""
        return np.array(
            [
                np.c_[slot.pose.outline(length_m, width_m), np.full(4, (slot.layer + 0.5) * LAYER_M)]
                for slot in self.slots
            ]
        )

    def paint(self, image: Image, outline: Outline) -> Image:
        """A copy of a picture `(H, W, 3)` with bags drawn in all slots, numbered as they are built.

        The pattern is in the robot's base frame (`at`), as are the poses that `outline` takes.
        """
        corners = np.array([outline(slot.pose, slot.layer) for slot in self.slots])
        return paint_layers(image, corners, [slot.layer for slot in self.slots])


def _said(slot: PatternSlot) -> str:
    return f"layer {slot.layer} at x {slot.pose.x:.3f}, y {slot.pose.y:.3f} m"


def _slot(written: Any, source: str | Path) -> PatternSlot:
    """A slot of a list, from its entries. Raises `BaggieError` where they are others."""
    given: dict[str, Any] = {"yaw_deg": 0.0} | written if isinstance(written, dict) else {}
    layer, place = given.get("layer"), [given.get(name) for name in ("x", "y", "yaw_deg")]
    numbers = [float(each) for each in place if isinstance(each, float | int) and math.isfinite(each)]
    known = given.keys() == {"x", "y", "yaw_deg", "layer"} and len(numbers) == len(place)
    if not known or type(layer) is not int or layer < 0:
        raise BaggieError(
            f"expected slots such as {{x: 0.0, y: 0.065, yaw_deg: 90, layer: 0}} in {source}, metres, degrees and a "
            f"layer from 0 on, got {written}; write it so"
        )
    x, y, yaw_deg = numbers
    return PatternSlot(PlanarPose(x, y, math.radians(yaw_deg)), layer)


def _tower(sizes: str) -> Sequence[PatternSlot] | None:
    """`3`: how many lie on each other."""
    if not re.fullmatch(r"[1-9]\d?", sizes):
        return None
    return [PatternSlot(PlanarPose(0.0, 0.0), layer) for layer in range(int(sizes))]


def _pyramid(sizes: str) -> Sequence[PatternSlot] | None:
    """`3-2-1`: how many lie in each row. Fingers that open across the row let bags bridge the gaps, not fall in."""
    if not re.fullmatch(r"[1-9](-[1-9])*", sizes):
        return None
    rows = [int(count) for count in sizes.split("-")]
    if rows != sorted(set(rows), reverse=True):
        return None
    return [
        PatternSlot(PlanarPose(0.0, y, math.pi / 2), layer)
        for layer, count in enumerate(rows)
        for y in _along(count)[::-1]
    ]


def _layers(sizes: str) -> Sequence[PatternSlot] | None:
    """`2x2,2x2 turned`: grids of so many along x by so many along y, on each other."""
    grids = [_GRID.fullmatch(grid.strip()) for grid in sizes.split(",")]
    slots = []
    for layer, grid in enumerate(grids):
        if grid is None:
            return None
        turn = PlanarPose(0.0, 0.0, math.pi / 4 if grid[3] else 0.0)
        for x in _along(int(grid[1])):
            slots += [PatternSlot(turn @ PlanarPose(x, y), layer) for y in _along(int(grid[2]))[::-1]]
    return slots


def _along(count: int) -> list[float]:
    """The middles of so many bags in a row about 0, metres."""
    return [float(at) for at in PITCH_M * (np.arange(count) - (count - 1) / 2)]
