"""An L goes into an L-shaped outline: Ravens' `block-insertion`."""

from __future__ import annotations

import numpy as np

from baggie.geometry import PlanarPose
from baggie.sim.objects import Block, Fixture, Part
from baggie.tasks.conditions import InSlots, Slot
from baggie.tasks.layout import COLORS, radius_m, scatter
from baggie.tasks.task import Scene, Setting, Task

LEG_M, WIDE_M, HIGH_M = (
    0.10,
    0.04,
    0.04,
)  # of the L: each leg from the corner's outside to its end, across, and up
PLAY_M = 0.003
"""Between the L in the middle of its outline and the walls, on every side."""
WALL_M, RIM_M = 0.005, 0.02  # how thick the walls are, and how high

_NEAR, _FAR = -WIDE_M / 2, LEG_M - WIDE_M / 2  # of the L along either axis; its frame is where the legs cross
_INNER = WIDE_M / 2
_MIDDLE = PlanarPose((_NEAR + _FAR) / 2, (_NEAR + _FAR) / 2)
"""Of the square around the L or its outline, in the frame of either."""


def _leg(size_x: float, size_y: float, x: float, y: float) -> Part:
    return Part((size_x, size_y, HIGH_M), COLORS["red"], (x, y, 0.0))


def _wall(x: tuple[float, float], y: tuple[float, float]) -> Part:
    """From a corner to the opposite one."""
    size = (x[1] - x[0], y[1] - y[0], RIM_M)
    return Part(size, COLORS["gray"], (sum(x) / 2, sum(y) / 2, RIM_M / 2))


def _outline() -> tuple[Part, ...]:
    """Six walls around the L, no two inside each other."""
    near, inner, far = _NEAR - PLAY_M, _INNER + PLAY_M, _FAR + PLAY_M  # where the walls face the L
    before, beyond, end = near - WALL_M, inner + WALL_M, far + WALL_M
    sides = (
        ((before, near), (before, end)),  # along the back of one leg, and around the corner
        ((near, beyond), (far, end)),  # across its end
        ((inner, beyond), (inner, far)),  # down its inside
    )
    # The other leg's are these with x and y exchanged; the corners, once.
    others = (((near, end), (before, near)), ((far, end), (near, beyond)), ((beyond, far), (inner, beyond)))
    return tuple(_wall(x, y) for x, y in (*sides, *others))


_LENGTH_M = LEG_M - WIDE_M
_ELL = Block(
    "ell",
    (WIDE_M, WIDE_M, HIGH_M),
    COLORS["red"],
    more=(
        _leg(_LENGTH_M, WIDE_M, LEG_M / 2, 0.0),
        _leg(WIDE_M, _LENGTH_M, 0.0, LEG_M / 2),
    ),
)
_FIXTURE = Fixture("outline", _outline())
_OUTER_M = LEG_M + 2 * (PLAY_M + WALL_M)
_RADII_M = {"ell": radius_m((LEG_M, LEG_M)), "outline": radius_m((_OUTER_M, _OUTER_M))}
_CONDITION = InSlots(("ell",), (Slot(PlanarPose(0.0, 0.0), HIGH_M / 2, "outline"),), weight=1.0, symmetry=1)


def _draw(rng: np.random.Generator, _setting: Setting) -> Scene:
    poses = {name: pose @ _MIDDLE.inverse() for name, pose in scatter(_RADII_M, rng).items()}
    return Scene((_ELL, _FIXTURE), poses, (_CONDITION,))


BLOCK_INSERTION = Task(
    name="block-insertion",
    instruction="Put the L into its outline.",
    tool="cup",
    view="height-map",
    things=(_ELL, _FIXTURE),
    draw_scene=_draw,
    max_steps=3,
    object_symmetry=1,
)
