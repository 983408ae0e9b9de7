"""The colours of Ravens' blocks and bowls: Tableau's ten, RGB."""

from __future__ import annotations

from baggie.sim.blocks import Color

COLORS: dict[str, Color] = {
    "blue": (78, 121, 167),
    "red": (255, 87, 89),
    "green": (89, 169, 79),
    "orange": (242, 142, 43),
    "yellow": (237, 201, 72),
    "purple": (176, 122, 161),
    "pink": (255, 157, 167),
    "cyan": (118, 183, 178),
    "brown": (156, 117, 95),
    "gray": (186, 176, 172),
}
