"""`fast`: where to put what was picked, turned by how much. Coarse over the whole map, then to the pixel near by.

Both looks add two scores of a place y and an angle a: how well the surroundings of the pick, turned by a, correlate
with those of y (Zeng et al., CoRL 2020, section 3.2), which is right about the place, and the phases of `phases.py`,
which are right about the angle.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from baggie.policies.transporter import phases
from baggie.policies.transporter.config import TransporterConfig
from baggie.policies.transporter.correlation import Method, correlate
from baggie.policies.transporter.rotation import rotated_crops
from baggie.policies.transporter.sampling import at_points, patches
from baggie.policies.transporter.scores import Scores, turn_angles
from baggie.policies.transporter.soft_targets import PlaceAngle
from baggie.policies.transporter.trunk import CELL, Scene, convolution

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
        return matched + phases.scores(phases.coefficients(q, k), self.fold * self.angles)


class CoarsePlace(nn.Module):
    """Every cell of the map."""

    def __init__(self, config: TransporterConfig, width: int) -> None:
        super().__init__()
        bins = max(3, config.bins(config.symmetry) // _COARSE_STEP) if config.symmetry else 1
        self.match = Matching(config, width, bins, _COARSE_CROP)

    def forward(self, scene: Scene, pick: PlaceAngle, about: PlaceAngle) -> Scores:
        """Over the whole map, whatever it is about."""
        first = (CELL - 1) / 2
        logits = self.match(scene.features, (pick.place - first) / CELL, scene.features)
        return Scores(logits, torch.full_like(about.place, first), CELL, self.match.fold)


class FinePlace(nn.Module):
    """Every pixel near a place, from the pixels themselves and the trunk's features.

    Only two patches are looked at, about the pick and about the place, so that full resolution costs next to nothing.
    """

    def __init__(self, config: TransporterConfig, width: int) -> None:
        super().__init__()
        self.context = convolution(width, _CONTEXT, size=1, gain=0.7)
        self.conv1 = convolution(4 + _CONTEXT, _FINE_WIDTH)
        self.conv2 = convolution(_FINE_WIDTH, _FINE_WIDTH)
        self.match = Matching(config, _FINE_WIDTH, config.bins(config.symmetry), _CROP)

    def forward(self, scene: Scene, pick: PlaceAngle, about: PlaceAngle) -> Scores:
        """Within 6 pixels of what it is about."""
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
