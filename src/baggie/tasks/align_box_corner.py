"""A box comes to lie with one of its corners in a marked corner: Ravens' `align-box-corner`."""

from __future__ import annotations

import numpy as np

from baggie.geometry import PlanarPose
from baggie.sim.objects import Block, Fixture, Part
from baggie.tasks.conditions import InSlots, Slot
from baggie.tasks.layout import COLORS, radius_m, scatter
from baggie.tasks.task import Scene, Setting, Task

LENGTH_M, WIDTH_M, HEIGHT_M = (0.08, 0.12), (0.045, 0.07), (0.02, 0.05)  # of the box, from and to
ARM_M, THICK_M, HIGH_M = 0.06, 0.006, 0.003  # of the two bars that mark the corner
GAP_M = 0.002
"""Between bars and box."""

_BOX, _DARK = Block("box"), (50, 50, 50)
_AT = ARM_M / 2 - THICK_M / 2
_CORNER = Fixture(
    "corner",
    # Outside of the quadrant x > 0, y > 0 of its frame, in which the box lies.
    (
        Part((ARM_M + THICK_M, THICK_M, HIGH_M), _DARK, (_AT, -THICK_M / 2, HIGH_M / 2)),
        Part((THICK_M, ARM_M, HIGH_M), _DARK, (-THICK_M / 2, ARM_M / 2, HIGH_M / 2)),
    ),
)
_SQUARE_M = LENGTH_M[1] + GAP_M + THICK_M
"""What the bars and the box lie in, whichever way round."""
_MIDDLE = PlanarPose(_SQUARE_M / 2 - THICK_M, _SQUARE_M / 2 - THICK_M)
"""Of that square, in the corner's frame."""


def _draw(rng: np.random.Generator, _setting: Setting) -> Scene:
    size = tuple(float(rng.uniform(*sides)) for sides in (LENGTH_M, WIDTH_M, HEIGHT_M))
    length, width, height = size
    box = Block("box", (length, width, height), list(COLORS.values())[rng.integers(len(COLORS))])
    poses = scatter({"box": radius_m(size), "corner": radius_m((_SQUARE_M, _SQUARE_M))}, rng)
    poses["corner"] = poses["corner"] @ _MIDDLE.inverse()
    a, b = GAP_M + length / 2, GAP_M + width / 2
    slots = tuple(
        Slot(pose, height / 2, "corner") for pose in (PlanarPose(a, b), PlanarPose(b, a, np.pi / 2))
    )
    return Scene((box, _CORNER), poses, (InSlots(("box",), slots, weight=1.0, symmetry=2),))


ALIGN_BOX_CORNER = Task(
    name="align-box-corner",
    instruction="Lay the box into the marked corner.",
    tool="cup",
    view="height-map",
    things=(_BOX, _CORNER),
    draw_scene=_draw,
    max_steps=3,
    object_symmetry=2,
)
