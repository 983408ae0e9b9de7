"""Draws the light over a table: lamps, ambient light, exposure and colour cast."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from baggie.sim.cell import Cell, Light
from baggie.sim.sensor import Exposure

_HEADLIGHT = 0.15  # what the scene's camera light adds straight down
_SPOT_M = 0.15  # how far from the table's middle a lamp may point


@dataclass(frozen=True)
class LightRange:
    """Between what the light is drawn; lengths in metres."""

    lamps: tuple[int, int]
    height_m: tuple[float, float]
    aside_m: tuple[float, float]
    """How far to the left or right of the robot they hang."""
    brightness: tuple[tuple[float, float], ...]
    """Of all light together, 1 showing a white sheet white: one of these bands."""
    ambient: tuple[float, float]
    """Share of the ambient light."""
    gain: tuple[float, float]
    """Of the exposure."""
    cast: tuple[float, float]
    """By how much red is raised and blue lowered, or the other way round."""


USUAL = LightRange((1, 2), (1.6, 2.2), (0.4, 1.2), ((0.9, 1.2),), (0.25, 0.45), (0.95, 1.05), (0.0, 0.04))
UNSEEN = LightRange(
    (1, 3), (1.0, 1.5), (0.3, 1.2), ((0.6, 0.8), (1.25, 1.4)), (0.1, 0.6), (0.85, 1.1), (0.07, 0.14)
)


def draw_light(cell: Cell, light: LightRange, rng: np.random.Generator) -> tuple[Cell, Exposure]:
    """The cell under other lamps, and the exposure that its pictures have on the average."""
    low, high = light.brightness[rng.integers(len(light.brightness))]
    brightness = rng.uniform(low, high) - _HEADLIGHT
    ambient = brightness * rng.uniform(*light.ambient)
    count = int(rng.integers(light.lamps[0], light.lamps[1] + 1))
    shares = rng.uniform(0.5, 1.0, count)
    side = rng.choice([-1.0, 1.0])
    lamps = []
    for number, share in enumerate(shares / shares.sum()):
        position = np.array(
            [rng.uniform(-0.1, 1.1), side * rng.uniform(*light.aside_m), rng.uniform(*light.height_m)]
        )
        aim = np.array([0.5, 0.0, 0.0]) + np.append(rng.uniform(-_SPOT_M, _SPOT_M, 2), 0.0)
        direction = (aim - position) / np.linalg.norm(aim - position)
        # What hits the table askew is spread over more of it.
        diffuse = (brightness - ambient) * share / -direction[2]
        x, y, z = position.tolist()
        to_x, to_y, to_z = direction.tolist()
        lamps.append(Light((x, y, z), (to_x, to_y, to_z), float(diffuse), shadow=number == 0))
        side = -side
    cast = rng.choice([-1.0, 1.0]) * rng.uniform(*light.cast)
    exposure = Exposure(float(rng.uniform(*light.gain)), (float(1 + cast), 1.0, float(1 - cast)))
    return replace(cell, lights=tuple(lamps), ambient=float(ambient)), exposure
