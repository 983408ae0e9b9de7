"""A small Ravens demonstration that is known exactly: two blocks put onto a third, as ray-cast cameras see them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from baggie.geometry import FloatArray, PlanarPose
from baggie.ravens.format import (
    RAVENS_CAMERAS,
    RavensAction,
    RavensEpisode,
    RavensObject,
    RavensPose,
    planar_to_pose,
)
from baggie.types import Image, Observation
from helpers.ray_caster import Box, look

SIDE_M = 0.04
COLORS = {"red": (200, 40, 40), "blue": (40, 60, 210), "green": (40, 170, 60)}
STAND = (0.45, -0.15)
STILL = (0.0, 0.0, 0.0, 1.0)
STARTS = {"red": (0.6, 0.2), "blue": (0.4, 0.35)}
TURNS = {"red": np.pi / 2, "blue": -np.pi}
"""By quarters, as the caster's boxes lie along the axes."""


def scene(step: int) -> dict[str, tuple[float, float, float]]:
    """Where the blocks' middles are after so many actions, metres."""
    at = {"green": (*STAND, SIDE_M / 2)}
    for level, name in enumerate(STARTS, start=1):
        done = level <= step
        x, y = STAND if done else STARTS[name]
        at[name] = (x, y, SIDE_M * (level if done else 0) + SIDE_M / 2)
    return at


def action(step: int) -> RavensAction:
    """What puts the next block on the stack; the cup takes it 7 mm off its middle."""
    name = list(STARTS)[step]
    start, turn = PlanarPose(*STARTS[name]), TURNS[name]
    grip = PlanarPose(0.005, -0.005)
    pick, place = start @ grip, PlanarPose(*STAND, turn) @ grip
    return RavensAction(
        RavensPose((pick.x, pick.y, SIDE_M), STILL), planar_to_pose(place, SIDE_M * (step + 1))
    )


@lru_cache(maxsize=3)
def views(step: int) -> tuple[Observation, ...]:
    """What the three cameras see then."""
    half = SIDE_M / 2
    boxes = [
        Box((x - half, y - half, z - half), (x + half, y + half, z + half), COLORS[name])
        for name, (x, y, z) in scene(step).items()
    ]
    return tuple(look(camera, pose, boxes) for camera, pose in RAVENS_CAMERAS)


def observation(step: int) -> dict[str, Sequence[Image | FloatArray]]:
    """The same as Ravens' environment gives it."""
    seen = views(step)
    return {
        "color": tuple(o.color for o in seen),
        "depth": tuple(o.depth for o in seen if o.depth is not None),
    }


def episode(number: int = 0, seed: int = 9000) -> RavensEpisode:
    """The whole demonstration."""
    moments = [observation(step) for step in range(len(STARTS) + 1)]
    objects = [
        {
            key: RavensObject((x, y, z), STILL, (SIDE_M,) * 3)
            for key, (x, y, z) in enumerate(scene(step).values(), start=6)
        }
        for step in range(len(STARTS) + 1)
    ]
    return RavensEpisode(
        number,
        seed,
        color=np.stack([np.stack(moment["color"]) for moment in moments]),
        depth=np.stack([np.stack(moment["depth"]) for moment in moments]),
        actions=tuple(action(step) for step in range(len(STARTS))),
        rewards=np.array([0.0, 0.5, 0.5]),
        info=(None, *objects[1:]),
    )
