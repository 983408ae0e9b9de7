"""The networks of the preset `fast`: one small U-Net whose features serve the pick, the place and both angles.

The pick's pixel follows from nothing but the map, its yaw from what is there. The place is coarse over the whole map,
then to the pixel near by. Both looks add two scores of a place y and an angle a: how well the surroundings of the pick,
turned by a, correlate with those of y (Zeng et al., CoRL 2020, section 3.2), which is right about the place, and the
phases of `spatial.py`, which are right about the angle.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from baggie.policies.transporter.config import TransporterConfig
from baggie.policies.transporter.scores import PlaceAngle, Scores, turn_angles
from baggie.policies.transporter.spatial import (
    Method,
    at_points,
    coefficients,
    correlate,
    patches,
    rotated_crops,
    scores,
)

CELL = 4
"""Features have one cell for so many pixels along each axis."""
DEEPEST = 16
"""Pixels a cell of the coarsest scale: shifting the map by multiples of this shifts the features."""
_HEIGHT_M = 0.05
"""A thing of this height is as different from the table as black is from white."""


class MapFeatures(NamedTuple):
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

    def forward(self, color: Tensor, height: Tensor) -> MapFeatures:
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
        return MapFeatures(maps, features[..., : -(-rows // CELL), : -(-columns // CELL)].contiguous())


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
    """Make a convolution that keeps the variance through a ReLU, times `gain`², and starts without bias."""
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


class PickMap(nn.Module):
    """A logit for every pixel: each cell's features say one for each of its pixels.

    Source: W. Shi et al., "Real-Time Single Image and Video Super-Resolution Using an Efficient Sub-Pixel Convolutional
    Neural Network", CVPR 2016.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        self.logits = convolution(width, CELL**2, size=1, gain=0.1)

    def forward(self, scene: MapFeatures, about: PlaceAngle) -> Scores:
        """Over the whole map, whatever it is about."""
        rows, columns = scene.maps.shape[-2:]
        logits = F.pixel_shuffle(self.logits(scene.features), CELL)[..., :rows, :columns]
        return Scores(logits, torch.zeros_like(about.place), 1, 1)


class PickAngle(nn.Module):
    """A band-limited score of the yaw at one point: the Fourier coefficients along the angle, from its features."""

    def __init__(self, config: TransporterConfig, width: int) -> None:
        super().__init__()
        self.fold = config.pick_fold
        self.orders = config.orders_of(self.fold)
        self.read = nn.Sequential(
            nn.Linear(width, 2 * width), nn.ReLU(), nn.Linear(2 * width, 2 * self.orders)
        )
        self.register_buffer("angles", turn_angles(config.bins(self.fold), self.fold), persistent=False)
        self.angles: Tensor

    def forward(self, scene: MapFeatures, about: PlaceAngle) -> Scores:
        """Score the yaw at the point: `(B, R, 1, 1)`."""
        coefficients = self.read(at_points(scene.features, about.place, CELL))
        coefficients = coefficients.view(-1, self.orders, 2, 1, 1)
        logits = scores(coefficients, max(self.fold, 1) * self.angles)
        return Scores(logits, torch.zeros_like(about.place), 1, self.fold)


CHANNELS = 8
"""That are correlated."""
_OF_AN_ORDER = 2
"""Complex channels of each angular order."""
_COARSE_STEP = 3
"""A bin of the coarse look is as wide as so many of the fine one."""
_COARSE_CROP = 16
"""Cells: 64 pixels, as published."""
_CROP = 24
"""Pixels of the fine look's crops."""
_SEARCH = 6
"""Pixels the fine look looks around: one and a half cells of the coarse one."""
_RIM = 2
"""Pixels at the rim of a patch that the fine look's convolutions know too little about."""
_FEW_BINS = 18
"""Of so many, a small patch is correlated sooner by spectra, with more by a convolution."""
_FINE_WIDTH = 24
_CONTEXT = 12
"""Channels of the trunk's features that the fine look sees beside the pixels."""


class Matching(nn.Module):
    """Scores of places and angles from two maps of features: of the pick's surroundings, and of the places'."""

    def __init__(self, config: TransporterConfig, inputs: int, bins: int, crop: int) -> None:
        super().__init__()
        self.fold, self.crop = config.symmetry, crop
        self.orders = config.orders_of(self.fold)
        self.channels = 2 * _OF_AN_ORDER * self.orders
        self.query = convolution(inputs, CHANNELS + self.channels, size=1, gain=0.5)
        self.key = convolution(inputs, CHANNELS + self.channels, size=1, gain=0.5)
        self.register_buffer("angles", turn_angles(bins, self.fold), persistent=False)
        self.angles: Tensor

    def forward(self, of_pick: Tensor, at: Tensor, of_places: Tensor, margin: int = 0) -> Tensor:
        """Features `(B, C, h, w)` with the pick at `(B, 2)` (u, v) cells, and `(B, C, h', w')` -> `(B, R, h', w')`.

        Of the places' features `margin` cells at every side are only surroundings: no places to score.
        """
        query, key = self.query(of_pick).contiguous(), self.key(of_places).contiguous()
        kernels = rotated_crops(query[:, :CHANNELS], at, self.angles, self.crop)
        places = key[..., margin : key.shape[-2] - margin, margin : key.shape[-1] - margin]
        batch, _, height, width = places.shape
        method: Method = "direct" if margin > 0 and len(self.angles) > _FEW_BINS else "fft"
        matched = correlate(key[:, :CHANNELS], kernels, method, margin) / self.crop
        if self.fold == 0:
            return matched
        q = at_points(query[:, CHANNELS:], at, 1).view(batch, self.orders, _OF_AN_ORDER, 2)
        k = places[:, CHANNELS:].reshape(batch, self.orders, _OF_AN_ORDER, 2, height, width)
        return matched + scores(coefficients(q, k), self.fold * self.angles)


class CoarsePlace(nn.Module):
    """Scores of a place in every cell of the map."""

    def __init__(self, config: TransporterConfig, width: int) -> None:
        super().__init__()
        bins = max(3, config.bins(config.symmetry) // _COARSE_STEP) if config.symmetry else 1
        self.match = Matching(config, width, bins, _COARSE_CROP)

    def forward(self, scene: MapFeatures, pick: PlaceAngle, about: PlaceAngle) -> Scores:
        """Over the whole map, whatever it is about."""
        first = (CELL - 1) / 2
        logits = self.match(scene.features, (pick.place - first) / CELL, scene.features)
        return Scores(logits, torch.full_like(about.place, first), CELL, self.match.fold)


class FinePlace(nn.Module):
    """Scores of every pixel near a place, from the pixels themselves and the trunk's features.

    Only two patches are looked at, about the pick and about the place, so that full resolution costs next to nothing.
    """

    def __init__(self, config: TransporterConfig, width: int) -> None:
        super().__init__()
        self.context = convolution(width, _CONTEXT, size=1, gain=0.7)
        self.conv1 = convolution(4 + _CONTEXT, _FINE_WIDTH)
        self.conv2 = convolution(_FINE_WIDTH, _FINE_WIDTH)
        self.match = Matching(config, _FINE_WIDTH, config.bins(config.symmetry), _CROP)

    def forward(self, scene: MapFeatures, pick: PlaceAngle, about: PlaceAngle) -> Scores:
        """Score the pixels within 6 of the place that it is about."""
        size = _CROP + 2 * (_SEARCH + _RIM) + 1
        batch, centre = len(pick.place), about.place.round()
        context = self.context(scene.features).contiguous()
        looked_at = torch.cat([pick.place, centre])
        pixels = patches(scene.maps.repeat(2, 1, 1, 1), looked_at, size, 1)
        around = patches(context.repeat(2, 1, 1, 1), looked_at, size, CELL)
        x = torch.cat([pixels, around], dim=1).contiguous(memory_format=torch.channels_last)
        x = F.relu(self.conv2(F.relu(self.conv1(x))))
        of_pick, of_place = x[:batch], x[batch:]
        middle = torch.full_like(pick.place, size // 2)
        logits = self.match(of_pick, middle, of_place, margin=size // 2 - _SEARCH)
        return Scores(logits, centre - _SEARCH, 1, self.match.fold)
