"""The network of the `keypoint` policy: a small U-Net, two spatial soft-argmax heads, and the map to the
robot.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from baggie.policies import planar_map
from baggie.policies.planar_map import PlanarMap
from baggie.policies.soft_argmax import heat_maps, soft_argmax

CELL = 2
"""A cell of the heat maps is this many pixels of the network's input wide and high."""

CHANNELS = 4
"""Red, green, blue, and the goal."""


class Keypoints(NamedTuple):
    """What the network says about B pictures; axes of length K = 2 are (pick, place)."""

    xy: Tensor
    """`(B, K, 2)` metres in the robot's base frame."""
    phase: Tensor
    """`(B, 2)`: the phase (cos, sin) of the object's yaw in the heat map, about as long as it is certain."""
    jacobian: Tensor
    """`(B, 2, 2)`: d xy / d cells, where the pick is."""
    heat: Tensor
    """`(B, K, h, w)`: each map sums to 1."""
    log_heat: Tensor
    """`(B, K, h, w)`: its logarithm."""
    cells: Tensor
    """`(B, K, 2)`: the points in the heat maps as (u, v), cell centres at integers."""


class KeypointNet(nn.Module):
    """Picture and goal in, pick and place in robot coordinates out.

    Works at half the input's resolution from its first layer (the four pixels of a cell become channels):
    that costs a quarter, and the soft-argmax reads positions to a small fraction of a cell anyway. The phase
    of the yaw is read from coarser features, which see the whole object at once, where the heat map is.
    """

    def __init__(self, width: int = 24) -> None:
        """`width`: channels at the finest level; twice as many below."""
        super().__init__()
        self.width = width
        double = 2 * width
        self.stem = _block(CHANNELS * CELL**2, width)
        self.down1 = nn.Sequential(_block(width, double), _block(double, double))
        self.down2 = nn.Sequential(_block(double, double), _block(double, double), _block(double, double))
        self.up1 = _block(double, double)
        self.narrow = nn.Conv2d(double, width, 1, bias=False)
        self.up0 = _block(width, width)
        self.heat = nn.Conv2d(width, 2, 1)
        self.phase = nn.Sequential(_block(double, double), nn.Conv2d(double, 2, 1))
        self.to_robot = PlanarMap()
        for parameter in self.parameters():
            if parameter.dim() == 4:  # a convolution's: this layout is the faster one on a CPU
                parameter.data = parameter.data.contiguous(memory_format=torch.channels_last)

    def forward(self, images: Tensor, to_picture: Tensor) -> Keypoints:
        """Images `(B, 4, H, W)` uint8; `to_picture` `(B, 3, 3)` takes their cells to the normalised picture.

        A warped image needs nothing but its own `to_picture`: that is all there is to augmentation without
        calibration.
        """
        logits, field = self._fields(images)
        heat = heat_maps(logits)
        cells = soft_argmax(heat)
        object_heat = F.avg_pool2d(heat[:, :1].detach(), 2, divisor_override=1)
        phase = (field * object_heat).sum(dim=(-2, -1))
        points = planar_map.apply(to_picture.unsqueeze(1), cells)
        xy: Tensor = self.to_robot(points)
        jacobian = self.to_robot.jacobian(points[:, 0]) @ planar_map.jacobian(to_picture, cells[:, 0])
        log_heat = logits.flatten(2).log_softmax(dim=2).view_as(logits)
        return Keypoints(xy, phase, jacobian, heat, log_heat, cells)

    def _fields(self, images: Tensor) -> tuple[Tensor, Tensor]:
        """`(B, 4, H, W)` -> heat map logits `(B, 2, H / 2, W / 2)`, phase `(B, 2, H / 4, W / 4)`."""
        x = F.pixel_unshuffle(images.float() / 255 - 0.5, CELL).contiguous(memory_format=torch.channels_last)
        fine: Tensor = self.stem(x)  # (B, w, H / 2, W / 2)
        middle: Tensor = self.down1(F.max_pool2d(fine, 2))  # (B, 2w, H / 4, W / 4)
        coarse: Tensor = self.down2(F.max_pool2d(middle, 2))  # (B, 2w, H / 8, W / 8)
        middle = self.up1(middle + _twice(coarse))
        fine = self.up0(fine + _twice(self.narrow(middle)))
        return self.heat(fine), self.phase(middle)


def _block(inputs: int, outputs: int) -> nn.Sequential:
    convolution = nn.Conv2d(inputs, outputs, 3, padding=1, bias=False)
    return nn.Sequential(convolution, nn.BatchNorm2d(outputs), nn.ReLU(inplace=True))


def _twice(x: Tensor) -> Tensor:
    return F.interpolate(x, scale_factor=2.0, mode="bilinear")
