"""Policies that nobody trains: one goes by the object's colour and a calibration, the others are told the truth."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import yaml

from baggie.calibration.files import MAP_FILE
from baggie.calibration.image_to_robot.map import ImageToRobot
from baggie.errors import BaggieError, DataError
from baggie.files import read_yaml, write_text
from baggie.geometry import FloatArray, PlanarPose, wrap_angle
from baggie.options.values import COLOR_MASK, ORACLE
from baggie.policies import checkpoint
from baggie.policies.base import Policy
from baggie.types import (
    LAYER_M,
    Goal,
    Observation,
    PickPlace,
    Plan,
    middle_of_layer_m,
    require_goal,
    require_observation,
)
from baggie.vision.color_mask import find_bags

CONFIG_FILE = "config.yaml"


class ColorMaskPolicy(Policy):
    """Picks an object where its colour is, places it where the goal's outline is; right in one cell.

    Of several the largest to be seen, unless the goal says which.
    """

    name = COLOR_MASK
    wants_goal = True

    def __init__(self, image_to_robot: ImageToRobot, object_color: tuple[int, int, int]) -> None:
        """Use a map fitted in the cell the pictures come from, and the object's RGB colour."""
        self.image_to_robot = image_to_robot
        self.object_color = object_color

    def plan(self, observation: Observation, goal: Goal | None = None) -> Plan:
        """Where to pick and where to place; yaws modulo a quarter turn, heights as the goal's layers count them.

        Raises `BaggieError` when no object is in sight, the goal's centre lies outside the picture, the
        picture has another shape than those the map was fitted to, or layers are above the table and the map was
        fitted at one height only.
        """
        width, height = require_observation(observation).size
        goal = require_goal(goal)
        u, v = goal.center
        if not (-0.5 <= u < width - 0.5 and -0.5 <= v < height - 0.5):
            raise BaggieError(
                f"expected a goal inside the picture of {width} x {height} pixels, got its centre at "
                f"({u:.0f}, {v:.0f}); mark a place that is in view"
            )
        to_robot = self.image_to_robot.for_size(observation.size)
        bags = [bag for bag in find_bags(observation.color, self.object_color) if bag is not None]
        if not bags:
            raise BaggieError(
                f"expected an object of colour RGB {self.object_color} in the picture, found none; "
                "bring it into view or choose another colour"
            )
        at = goal.object_at
        found = bags[0] if at is None else min(bags, key=lambda bag: float(np.hypot(*(bag.center - at))))
        pick = _pose(_in_layer(to_robot, goal.object_layer), found.center, found.yaw)
        masks = np.any([bag.mask for bag in bags], axis=0).astype(np.float32)
        there = _in_layer(to_robot, goal.layer)
        # On the table: the middle of what a tilted camera sees is not what it sees of the middle.
        x, y = there.to_robot(goal.corners).mean(axis=0)
        place = PlanarPose(float(x), float(y), there.yaw_to_robot(goal.center, _goal_yaw(goal)))
        action = PickPlace(pick, place, goal.object_layer * LAYER_M, goal.layer * LAYER_M)
        return Plan(action, found.confidence, views={"pick": masks})

    def save(self, folder: Path) -> None:
        """Write `image-to-robot.yaml`, then `config.yaml`: where that is, all is."""
        self.image_to_robot.save(folder / MAP_FILE)
        config = {"policy": self.name, "object_color": list(self.object_color)}
        write_text(folder / CONFIG_FILE, yaml.safe_dump(config, sort_keys=False, default_flow_style=None))

    @classmethod
    def from_pretrained(cls, source: str | Path, device: str = "cpu") -> ColorMaskPolicy:
        """The policy saved in a folder or under a Hub id; nothing of it computes on a device. Raises as `load` does."""
        return cls.load(checkpoint.fetch(source))

    @classmethod
    def load(cls, folder: Path) -> ColorMaskPolicy:
        """Read what `save` wrote. Raises `DataError` when a file is missing or of another policy."""
        path = folder / CONFIG_FILE
        try:
            config = read_yaml(path)
            if config["policy"] != cls.name:
                raise ValueError(f"policy {config['policy']}")
            red, green, blue = (int(value) for value in config["object_color"])
        except OSError as error:
            raise DataError(
                f"no {cls.name} policy at {path} ({error.strerror}); give the folder of a recording of this cell"
            ) from None
        except (DataError, KeyError, TypeError, ValueError) as error:
            raise DataError(
                f"expected a {cls.name} policy in {path}, got {error!r}; give its folder"
            ) from error
        return cls(ImageToRobot.load(folder / MAP_FILE), (red, green, blue))


def _in_layer(to_robot: ImageToRobot, layer: int) -> ImageToRobot:
    """The map at the middle of bags of a layer; as it was fitted on the table. Raises `CalibrationError`."""
    return to_robot if layer == 0 else to_robot.at_height(middle_of_layer_m(layer))


def _pose(to_robot: ImageToRobot, pixel: FloatArray, yaw: float) -> PlanarPose:
    x, y = to_robot.to_robot(pixel)[0]
    return PlanarPose(float(x), float(y), to_robot.yaw_to_robot(pixel, yaw))


def _goal_yaw(goal: Goal) -> float:
    """Image angle of the goal's edges, radians in [-pi/4, pi/4)."""
    _, _, degrees = cv2.minAreaRect(goal.corners.astype(np.float32))
    return wrap_angle(math.radians(degrees), math.pi / 2)


class OraclePolicy(Policy):
    """Does what a demonstrator, who knows where everything is, does next. For evaluation in simulation only.

    cell.give_goal(goal)
    policy = OraclePolicy(cell.demonstrate)
    """

    name = ORACLE

    def __init__(self, next_action: Callable[[], PickPlace | None]) -> None:
        """`next_action` is asked at every plan; None when all is done."""
        self.next_action = next_action

    def plan(self, observation: Observation, goal: Goal | None = None) -> Plan:
        """Plan the next pick and place; neither the picture nor the goal in it is looked at.

        Raises `BaggieError` when nothing is left to do.
        """
        action = self.next_action()
        if action is None:
            raise BaggieError("expected something left to do, but the task is done; begin another scene")
        return Plan(action)
