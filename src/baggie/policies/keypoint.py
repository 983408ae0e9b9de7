"""The `keypoint` policy: finds bag and goal in the picture, and knows where that is for the robot."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Self

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from baggie.errors import BaggieError
from baggie.geometry import FloatArray, PlanarPose, apply_homography
from baggie.policies import phase
from baggie.policies.keypoint_net import CELL, KeypointNet, Keypoints
from baggie.policies.learned import LearnedPolicy
from baggie.policies.view import View
from baggie.types import Goal, Image, Observation, PickPlace, Plan
from baggie.vision.draw import region_mask

CELLS_TO_INPUT: FloatArray = np.array(
    [[CELL, 0.0, (CELL - 1) / 2], [0.0, CELL, (CELL - 1) / 2], [0.0, 0.0, 1.0]]
)
"""`(3, 3)`: cells of the heat maps -> pixels of the network's input, centres at integers in both."""

_PEAK_RADIUS = 4.0
"""Cells around the point in which a confident heat map has all its weight."""
_IN_SIGHT = 0.15
"""With a bag in sight this share of the pick's heat map, and far more, is at its peak; on an empty table, 0.05."""
_VIEW_SCALE = 4
"""Heat maps are shown at a quarter of the picture's size."""


class KeypointPolicy(LearnedPolicy):
    """One small network for pick and place.

    The goal's region goes in as a fourth channel rather than painted over the picture: a patch over the bag
    would hide what is to be picked, and how the goal is drawn (style, colour) makes no difference.
    """

    name = "keypoint"
    network: KeypointNet

    def __init__(self, network: KeypointNet, view: View, cell: int) -> None:
        """`view`: the part of the picture in which its training attempts took place."""
        super().__init__(network, view.picture, cell)
        self.view = view

    def model_config(self) -> dict[str, Any]:
        """The network's width and its view."""
        view = self.view
        edges = {"left": view.left, "top": view.top, "right": view.right, "bottom": view.bottom}
        return {"width": self.network.width, "view": {**edges, "size": list(view.size)}}

    @classmethod
    def build(cls, model: Mapping[str, Any], picture_size: tuple[int, int], cell: int) -> Self:
        """The policy with an untrained network."""
        width, height = (int(value) for value in model["view"]["size"])
        edges = {key: int(model["view"][key]) for key in ("left", "top", "right", "bottom")}
        return cls(KeypointNet(int(model["width"])), View(picture_size, **edges, size=(width, height)), cell)

    def to_picture(self) -> FloatArray:
        """`(3, 3)`: cells of an unwarped image's heat maps -> the normalised picture."""
        return self.view.normalize() @ self.view.from_input() @ CELLS_TO_INPUT

    def plan(self, observation: Observation, goal: Goal) -> Plan:
        """Where to pick and where to place; yaws modulo a quarter turn.

        The place yaw is that of the goal's sides. Confidence is the share of the heat maps' weight near the
        points, the smaller of the two. Raises `BaggieError` when no bag is in sight, or when the goal lies
        outside the part of the picture in which the training attempts took place.
        """
        picture, goal = self.as_trained(observation, goal)
        view = self.view
        if not view.contains(goal.corners):
            u, v = goal.center
            raise BaggieError(
                f"the goal at ({u:.0f}, {v:.0f}) is outside of what the training attempts covered, u {view.left}.."
                f"{view.right} and v {view.top}..{view.bottom} of {view.picture[0]} x {view.picture[1]} pixels: "
                "choose one nearer to the workspace's middle, or collect there"
            )
        image = network_input(view.cut(picture), view.to_input(goal.corners))
        batch = torch.from_numpy(image).unsqueeze(0).to(self.device)
        to_picture = torch.from_numpy(self.to_picture()).float().unsqueeze(0).to(self.device)
        self.network.eval()
        with torch.inference_mode():
            found = self.network(batch, to_picture)
            sure = peak_share(found)[0].tolist()
            yaw = float(phase.yaw_of(found.phase, found.jacobian))
            place_yaw = self._yaw_of(goal)
        if sure[0] < _IN_SIGHT:
            raise BaggieError(
                f"no bag in sight: only {sure[0]:.0%} of the heat map is at its peak; put one into the workspace"
            )
        (pick_x, pick_y), (place_x, place_y) = found.xy[0].tolist()
        action = PickPlace(PlanarPose(pick_x, pick_y, yaw), PlanarPose(place_x, place_y, place_yaw))
        heat = found.heat[0].cpu().numpy()
        views = {name: self._over_picture(map_) for name, map_ in zip(("pick", "place"), heat, strict=True)}
        return Plan(action, min(sure), views=views)

    def _yaw_of(self, goal: Goal) -> float:
        """The direction of the goal's sides on the table, radians in [-45°, 45°), long sides counting more."""
        corners = apply_homography(self.view.normalize(), goal.corners)
        on_table = self.network.to_robot(torch.from_numpy(corners).float().to(self.device))
        x, y = (on_table.roll(-1, 0) - on_table).cpu().double().numpy().T
        return (
            float(np.angle((np.hypot(x, y) * np.exp(1j * phase.SYMMETRY * np.arctan2(y, x))).sum()))
            / phase.SYMMETRY
        )

    def _over_picture(self, heat: NDArray[np.float32]) -> NDArray[np.float32]:
        """A heat map `(h, w)` of the view -> of the whole picture, a quarter its size, greatest value 1."""
        width, height = (side // _VIEW_SCALE for side in self.picture_size)
        offset = (1 / _VIEW_SCALE - 1) / 2
        shrink = np.array([[1 / _VIEW_SCALE, 0, offset], [0, 1 / _VIEW_SCALE, offset], [0, 0, 1]])
        place = shrink @ self.view.from_input() @ CELLS_TO_INPUT
        return np.asarray(cv2.warpAffine(heat / heat.max(), place[:2], (width, height)), np.float32)


def network_input(cut: Image, goal: FloatArray) -> Image:
    """A view `(H, W, 3)` and the goal's corners `(N, 2)` in its pixels -> `(4, H, W)` uint8."""
    height, width = cut.shape[:2]
    return np.concatenate([cut.transpose(2, 0, 1), region_mask(goal, (width, height))[None]])


def peak_share(found: Keypoints) -> Tensor:
    """The share of each heat map's weight within 4 cells of its point: `(B, 2)`, 0 to 1."""
    height, width = found.heat.shape[-2:]
    u = torch.arange(width, device=found.heat.device) - found.cells[..., 0:1]
    v = torch.arange(height, device=found.heat.device) - found.cells[..., 1:2]
    near = u.unsqueeze(-2) ** 2 + v.unsqueeze(-1) ** 2 < _PEAK_RADIUS**2
    return (found.heat * near).sum(dim=(-2, -1))
