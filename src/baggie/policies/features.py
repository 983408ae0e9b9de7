"""What a heat map is made from: features of a picture at a half, a quarter and an eighth of its size."""

from __future__ import annotations

from typing import Literal, NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from baggie.policies.keypoint_plan import CELL
from baggie.policies.resnet import IMAGENET_MEAN, IMAGENET_STD, ResNet18

Backbone = Literal["small", "resnet18"]


class Features(NamedTuple):
    """Channels by scale; each scale has half the rows and columns of the one before."""

    fine: Tensor
    """`(B, C, H / 2, W / 2)`."""
    middle: Tensor
    """`(B, C, H / 4, W / 4)`."""
    coarse: Tensor
    """`(B, C, H / 8, W / 8)`."""


class SmallFeatures(nn.Module):
    """Six convolutions. The four pixels of a cell become channels, so the first works at half size already."""

    def __init__(self, channels: int, width: int) -> None:
        """`channels`: of the input; `width`: at the finest scale, twice as many below."""
        super().__init__()
        double = 2 * width
        self.sizes = (width, double, double)
        self.stem = block(channels * CELL**2, width)
        self.down1 = nn.Sequential(block(width, double), block(double, double))
        self.down2 = nn.Sequential(block(double, double), block(double, double), block(double, double))

    def forward(self, images: Tensor) -> Features:
        """`(B, C, H, W)`, values -0.5 to 0.5."""
        x = F.pixel_unshuffle(images, CELL).contiguous(memory_format=torch.channels_last)
        fine = self.stem(x)
        middle = self.down1(F.max_pool2d(fine, 2))
        return Features(fine, middle, self.down2(F.max_pool2d(middle, 2)))


class ResNetFeatures(nn.Module):
    """The first three scales of a ResNet-18, for its published weights; what is no colour has a path of its own."""

    mean: Tensor
    std: Tensor

    def __init__(self, channels: int) -> None:
        """`channels`: of the input, of which the first three are red, green and blue."""
        super().__init__()
        self.sizes = (64, 64, 128)
        resnet = ResNet18()
        self.conv1, self.bn1, self.maxpool = resnet.conv1, resnet.bn1, resnet.maxpool
        self.layer1, self.layer2 = resnet.layer1, resnet.layer2
        self.beside_color = block((channels - 3) * CELL**2, 64) if channels > 3 else None
        self.register_buffer("mean", torch.tensor(IMAGENET_MEAN).view(3, 1, 1) - 0.5, persistent=False)
        self.register_buffer("std", torch.tensor(IMAGENET_STD).view(3, 1, 1), persistent=False)

    def load_imagenet(self, weights: dict[str, Tensor]) -> None:
        """Take over published weights by name, as `resnet.load_imagenet` reads them, but for the deepest scales."""
        own = self.state_dict()
        self.load_state_dict(own | {name: tensor for name, tensor in weights.items() if name in own})

    def forward(self, images: Tensor) -> Features:
        """`(B, C, H, W)`, values -0.5 to 0.5."""
        color = ((images[:, :3] - self.mean) / self.std).contiguous(memory_format=torch.channels_last)
        fine = F.relu(self.bn1(self.conv1(color)))
        if self.beside_color is not None:
            fine = fine + self.beside_color(F.pixel_unshuffle(images[:, 3:], CELL))
        middle = self.layer1(self.maxpool(fine))
        return Features(fine, middle, self.layer2(middle))


def block(inputs: int, outputs: int) -> nn.Sequential:
    """A 3 x 3 convolution, batch normalisation, ReLU."""
    convolution = nn.Conv2d(inputs, outputs, 3, padding=1, bias=False)
    return nn.Sequential(convolution, nn.BatchNorm2d(outputs), nn.ReLU(inplace=True))
