"""How `regression` plans, whatever runs its network. Nothing here needs PyTorch."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from baggie.geometry import PlanarPose
from baggie.policies.checkpoint import as_trained
from baggie.policies.keypoint.plan import GoalInput
from baggie.types import Goal, Image, Observation, PickPlace, Plan

SIDE = 224
"""The network's input is this many pixels wide and high, whatever the shape of the picture."""

Read = Callable[[NDArray[np.uint8]], NDArray[np.float32]]
"""Runs the network: `(1, 3, 224, 224)` images -> `(1, 2, 2)`: (pick, place) x (x, y), metres."""


def goal_input(model: Mapping[str, Any]) -> GoalInput:
    """How goals are painted, by a config's `model`."""
    red, green, blue = (int(value) for value in model["goal_color"])
    return GoalInput("painted", model["goal_style"], (red, green, blue))


def network_input(drawn: GoalInput, picture: Image, goal: Goal) -> Image:
    """A picture and its goal -> `(3, 224, 224)` uint8 with the goal painted in it."""
    small = np.asarray(cv2.resize(picture, (SIDE, SIDE), interpolation=cv2.INTER_AREA), np.uint8)
    height, width = picture.shape[:2]
    return drawn.network_input(small, goal.scaled(SIDE / width, SIDE / height))


def plan(
    read: Read,
    drawn: GoalInput,
    picture_size: tuple[int, int],
    observation: Observation,
    goal: Goal,
    *,
    camera_size: tuple[int, int],
) -> Plan:
    """Pick and place positions; yaw 0 and confidence 1, as it has no word on either.

    `picture_size`: `(width, height)` of the training pictures, which a camera took at `camera_size`; pixels. Raises
    `BaggieError` as `as_trained` does.
    """
    image = network_input(drawn, *as_trained(observation, goal, picture_size, camera_size))
    pick, place = read(image[None])[0]
    return Plan(PickPlace(PlanarPose(*map(float, pick)), PlanarPose(*map(float, place))))
