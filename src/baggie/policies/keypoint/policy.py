"""What a `keypoint` policy has learned of the camera, as a calibration like any other.

The `keypoint` policy: finds bag and goal in the picture, and knows where that is for the robot.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any, Self

import numpy as np
import torch
from numpy.typing import NDArray

from baggie.calibration.files import CameraIdentity
from baggie.calibration.image_to_robot.map import ImageToRobot
from baggie.geometry import FloatArray, apply_homography
from baggie.policies.keypoint.network import KeypointNet, KeypointReader
from baggie.policies.learned import LearnedPolicy
from baggie.policies.planning import Float32, GoalInput, Reading, View, keypoint_plan, to_picture
from baggie.types import Goal, Observation, Plan, marked


class KeypointPolicy(LearnedPolicy):
    """One small network for pick and place.

    The goal's region goes in as a fourth channel rather than painted over the picture: a patch over the bag
    would hide what is to be picked, and how the goal is drawn (style, colour) makes no difference.
    """

    name = "keypoint"
    network: KeypointNet

    def __init__(
        self, network: KeypointNet, view: View, cell: int, goal_input: GoalInput | None = None
    ) -> None:
        """`view`: the part of the picture in which its training attempts took place."""
        super().__init__(network, view.picture, cell)
        self.view = view
        self.goal_input = goal_input or GoalInput()

    def model_config(self) -> dict[str, Any]:
        """The network's kind, its view, and how goals get into its input."""
        return {
            "width": self.network.width,
            "backbone": self.network.backbone,
            "view": self.view.config(),
            "goal": self.goal_input.config(),
        }

    @classmethod
    def build(cls, model: Mapping[str, Any], picture_size: tuple[int, int], cell: int) -> Self:
        """The policy with an untrained network."""
        goal_input = GoalInput.of(model["goal"])
        network = KeypointNet(int(model["width"]), goal_input.channels, model["backbone"])
        return cls(network, View.of(model["view"], picture_size), cell, goal_input)

    def plan(self, observation: Observation, goal: Goal | None = None) -> Plan:
        """Where to pick and where to place; see `keypoint_plan`, whose errors it raises."""
        return keypoint_plan(
            self.read, self.view, self.goal_input, observation, marked(goal), camera_size=self.camera_size
        )

    def reader(self) -> KeypointReader:
        """The network with all that is computed from it, in evaluation mode: what is exported."""
        return KeypointReader(self.network, to_picture(self.view)).eval()

    def read(self, images: NDArray[np.uint8], near: Float32, corners: Float32) -> Reading:
        """Run the network; see `KeypointRead`."""
        with torch.inference_mode():
            given = (torch.from_numpy(array).to(self.device) for array in (images, near, corners))
            return Reading(*(part.cpu().numpy() for part in self.reader()(*given)))


_ROWS, _COLUMNS = 9, 16
_LIMIT_MM = 1.0


def as_calibration(policy: KeypointPolicy, height_m: float) -> ImageToRobot:
    """The policy's map from its picture to the robot, fitted to a grid over its view.

    `height_m` is the height it was learned at, half that of the bags at rest. The map's lens bends from the picture to
    the table and a calibration's the other way: `residuals` says what the conversion costs; what the policy's own map
    is worth it does not know. The camera is named after the cell.

    Raises `CalibrationError` where the conversion costs more than a millimetre, or the map is no camera's.
    """
    view = policy.view
    u, v = np.linspace(view.left, view.right - 1, _COLUMNS), np.linspace(view.top, view.bottom - 1, _ROWS)
    pixels = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    xy = _to_robot(policy, apply_homography(view.normalize(), pixels))
    robot = np.column_stack([xy, np.full(len(xy), height_m)])
    camera = CameraIdentity(f"cell {policy.cell}", *policy.picture_size)
    return ImageToRobot.fit(pixels, robot, camera, limit_mm=_LIMIT_MM)


def _to_robot(policy: KeypointPolicy, normalized: FloatArray) -> FloatArray:
    exact = copy.deepcopy(policy.network.to_robot).cpu().double()
    with torch.no_grad():
        return np.asarray(exact(torch.from_numpy(normalized)).numpy(), float)
