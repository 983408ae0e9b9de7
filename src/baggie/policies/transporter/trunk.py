"""What `fast` sees of a map: one small U-Net whose features serve the pick, the place and both angles."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as F

CELL = 4
"""Features have one cell for so many pixels along each axis."""
DEEPEST = 16
"""Pixels a cell of the coarsest scale: shifting the map by multiples of this shifts the features."""
_HEIGHT_M = 0.05
"""A thing of this height is as different from the table as black is from white."""


class Scene(NamedTuple):
    """What is known of B maps after one look."""

    maps: Tensor
    """`(B, 4, H, W)`: red, green, blue, height; about -1 to 1."""
    features: Tensor
    """`(B, C, ceil(H / 4), ceil(W / 4))`, contiguous."""


class Trunk(nn.Module):
    """Space to depth, then three scales down and up again.

    The pixels of a cell become channels, so that no convolution ever runs at full size, and yet nothing is thrown away.
    There is no normalisation: statistics over a map would make what is seen here depend on what lies there, and a
    batch of one is as good as any.
    """

    def __init__(self, width: int = 32) -> None:
        """`width`: channels of the features."""
        super().__init__()
        middle, deep = width * 3 // 2, 2 * width
        self.width = width
        self.stem = convolution(4 * CELL**2, width)
        self.fine = Residual(width)
        self.down1 = convolution(width, middle, stride=2)
        self.middle = Residual(middle)
        self.down2 = convolution(middle, deep, stride=2)
        self.deep = nn.Sequential(Residual(deep), Residual(deep))
        self.up1 = convolution(deep, middle, size=1)
        self.join1 = Residual(middle)
        self.up0 = convolution(middle, width, size=1)
        self.join0 = Residual(width)

    def forward(self, color: Tensor, height: Tensor) -> Scene:
        """`(B, 3, H, W)` uint8 and `(B, H, W)` metres, of any size."""
        maps = torch.cat([color.float() / 127.5 - 1, height.unsqueeze(1) / _HEIGHT_M], dim=1)
        rows, columns = maps.shape[-2:]
        padded = F.pad(maps, (0, -columns % DEEPEST, 0, -rows % DEEPEST))
        # On a CPU convolutions take two thirds of the time in this layout of memory; correlations must never see it.
        x = _cells(padded)
        fine = self.fine(F.relu(self.stem(x)))
        middle = self.middle(F.relu(self.down1(fine)))
        deep = self.deep(F.relu(self.down2(middle)))
        middle = self.join1(middle + _enlarged(self.up1(deep)))
        features = self.join0(fine + _enlarged(self.up0(middle)))
        return Scene(maps, features[..., : -(-rows // CELL), : -(-columns // CELL)].contiguous())


class Residual(nn.Module):
    """Two 3 x 3 convolutions beside a shortcut. The second starts small, which takes the place of normalisation.

    Source: H. Zhang et al., "Fixup Initialization", ICLR 2019.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        self.conv1, self.conv2 = convolution(width, width), convolution(width, width, gain=0.25)

    def forward(self, x: Tensor) -> Tensor:
        """`(B, width, h, w)` -> the same shape."""
        return F.relu(x + self.conv2(F.relu(self.conv1(x))))


def convolution(inputs: int, outputs: int, size: int = 3, stride: int = 1, gain: float = 1.0) -> nn.Conv2d:
    """One that keeps the variance through a ReLU, times `gain`², and starts without bias."""
    layer = nn.Conv2d(inputs, outputs, size, stride=stride, padding=size // 2)
    nn.init.kaiming_normal_(layer.weight, nonlinearity="relu")
    assert layer.bias is not None
    nn.init.zeros_(layer.bias)
    with torch.no_grad():
        layer.weight.mul_(gain)
    return layer


def _cells(maps: Tensor) -> Tensor:
    """The pixels of a cell as channels, as `pixel_unshuffle` has them, laid out channels last at one go: it takes half
    the time.
    """
    batch, channels, rows, columns = maps.shape
    split = maps.view(batch, channels, rows // CELL, CELL, columns // CELL, CELL)
    last = split.permute(0, 2, 4, 1, 3, 5).reshape(batch, rows // CELL, columns // CELL, -1)
    return last.permute(0, 3, 1, 2)


def _enlarged(x: Tensor) -> Tensor:
    return F.interpolate(x, scale_factor=2.0, mode="bilinear", align_corners=False)
