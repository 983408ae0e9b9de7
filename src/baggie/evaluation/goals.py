"""An episode's goal: where the bag is to go, and how the policy is told, all drawn from the episode's own stream."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from baggie import seeds
from baggie.calibration.image_to_robot.rectify import raise_card
from baggie.collect.machine import random_place
from baggie.errors import BaggieError
from baggie.evaluation.setup import Setup
from baggie.geometry import PlanarPose
from baggie.options.values import GoalKind
from baggie.seeds import first_fit
from baggie.types import Goal, Observation
from baggie.vision.goal_card import find_card
from baggie.workcell.workcell import Workcell

CLEARANCE_M = 0.16
"""Between a goal and what stands there or a bag that is to stay: two bags lie side by side, not on each other."""
CLICK_M = 0.02
"""How far from the middle of a bag a person may click on it."""
_GOALS = 0x60A1
"""Keeps the stream of an episode's goal apart from any the cell makes of its scene's."""
_CLICKS = 0xC11C
_TRIES = 100


class NoCardError(BaggieError):
    """The goal card is not to be seen."""


def draw_goal(cell: Workcell, bag: PlanarPose, kind: GoalKind, stream: Sequence[int]) -> PlanarPose:
    """Where the bag is to go: as the collector draws places, uniform in the workspace, at least 20 cm from where it is.

    Square to the workspace if `virtual`, else at any angle; at least 16 cm from obstacles and from a second bag. Raises
    `BaggieError` where there is no such place.
    """
    rng = seeds.generator(*stream, _GOALS)
    occupied = _occupied(cell)
    pose = first_fit(
        lambda: random_place(cell.settings.workspace, bag, rng),
        lambda place: all(place.distance(other) >= CLEARANCE_M for other in occupied),
        _TRIES,
    )
    if pose is None:
        raise BaggieError(
            f"expected room for a goal {CLEARANCE_M * 100:.0f} cm from each of {len(occupied)} things on the table, "
            f"found none in {_TRIES} tries; clear the workspace ({cell.settings.workspace})"
        )
    if kind == "virtual":
        return pose
    # One turn of the bag that looks like no turn: what is further away looks the same, and the wrist need not go there.
    half = math.pi / max(cell.settings.object_symmetry, 1)
    return replace(pose, yaw=float(rng.uniform(-half, half)))


def _occupied(cell: Workcell) -> list[PlanarPose]:
    """Where things stand, or are to stay, as far as anybody knows."""
    state = cell.state()
    if state is None:
        return []
    return [*state.obstacles, *(state.places[name] for name in (cell.scene.staying if cell.scene else ()))]


def goal_in(setup: Setup, kind: GoalKind, pose: PlanarPose, seen: Observation, stream: Sequence[int]) -> Goal:
    """The goal as the policy is told it in the picture `seen`, with a click on the bag where there are two.

    A card's corners are those found in the picture, raised to the bag's height where the setup has a map for that.
    Raises `NoCardError` where it is not found.
    """
    cell = setup.cell
    object_at = _click(cell, setup.object_in(seen), stream) if cell.scene and cell.scene.staying else None
    if kind != "card":
        return Goal(cell.outline(pose), object_at=object_at)
    card = find_card(seen.color)
    if card is None:
        raise NoCardError(
            "expected the goal card in the picture, found none; lay it where the camera sees all of it"
        )
    corners = card.corners
    if setup.image_to_robot is not None:
        to_robot = setup.image_to_robot.for_size(seen.size)
        corners = raise_card(corners, to_robot, cell.settings.object_size_m[2] / 2)
    return Goal(corners, "card", card.color, object_at)


def _click(cell: Workcell, bag: PlanarPose, stream: Sequence[int]) -> tuple[float, float]:
    """A pixel on the bag to be moved, uniform within 2 cm of its middle."""
    rng = seeds.generator(*stream, _CLICKS)
    radius, angle = CLICK_M * math.sqrt(rng.random()), rng.uniform(-math.pi, math.pi)
    there = PlanarPose(bag.x + radius * math.cos(angle), bag.y + radius * math.sin(angle))
    u, v = np.asarray(cell.outline(there)).mean(axis=0)
    return float(u), float(v)
