"""All of a plan that is computed from the network, as one module: PyTorch runs it, or onnxruntime its export."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from baggie.geometry import FloatArray
from baggie.policies import phase
from baggie.policies.keypoint_net import KeypointNet
from baggie.policies.soft_argmax import near_only, squared_distances

_SURE_LONG, _SURE_SQUARE = 0.5, 0.25
"""Phases are as long as they are certain: below these, a thing is not taken for long, or for square."""
_PEAK = 4.0
"""Cells around the point in which a confident heat map has all its weight."""


class KeypointReader(nn.Module):
    """One picture and goal -> what `keypoint_plan.Reading` holds, as tensors in its order."""

    to_picture: Tensor

    def __init__(self, network: KeypointNet, to_picture: FloatArray) -> None:
        """`to_picture` `(3, 3)`: cells of the heat maps -> the normalised picture."""
        super().__init__()
        self.network = network
        device = network.to_robot.homography.device
        self.register_buffer("to_picture", torch.from_numpy(to_picture).float().unsqueeze(0).to(device))

    def forward(self, images: Tensor, near: Tensor, corners: Tensor) -> tuple[Tensor, ...]:
        """Images `(1, C, H, W)` uint8; `near` `(3,)`: the object is within so many cells (last) of (u, v) in cells;
        `corners` `(N, 2)` of the goal in the normalised picture.
        """
        logits, field = self.network.fields(images)
        pick = near_only(logits[:, :1], near[:2].view(1, 1, 2), near[2])
        found = self.network.read(torch.cat([pick, logits[:, 1:]], dim=1), field, self.to_picture)
        heat = found.heat()
        share = (heat * (squared_distances(heat, found.cells) < _PEAK**2)).sum(dim=(-2, -1))
        yaw, symmetry = _yaw(found.phases()[0], found.jacobian[0, 0])
        return (
            found.xy[0],
            yaw,
            symmetry,
            share[0],
            self.network.radius(found)[0],
            heat[0],
            self.network.to_robot(corners),
        )


def _yaw(phases: Tensor, jacobian: Tensor) -> tuple[Tensor, Tensor]:
    """Phases `(2, 2)` as a square and as a long thing -> yaw, radians, and how often a turn it looks the same."""
    square, long = phases
    is_long = long.norm() > _SURE_LONG
    is_square = square.norm() > _SURE_SQUARE
    as_long, as_square = (
        phase.yaw_of(long, jacobian, phase.LONG),
        phase.yaw_of(square, jacobian, phase.SQUARE),
    )
    zero = torch.zeros_like(as_long)
    yaw = torch.where(is_long, as_long, torch.where(is_square, as_square, zero))
    symmetry = torch.where(is_long, zero + phase.LONG, torch.where(is_square, zero + phase.SQUARE, zero))
    return yaw, symmetry
