"""`fast`: where to pick, from nothing but the map, and at which yaw, from what is there."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from baggie.policies.transporter.config import TransporterConfig
from baggie.policies.transporter.phases import scores
from baggie.policies.transporter.sampling import at_points
from baggie.policies.transporter.scores import Scores, turn_angles
from baggie.policies.transporter.soft_targets import PlaceAngle
from baggie.policies.transporter.trunk import CELL, Scene, convolution


class PickMap(nn.Module):
    """A logit for every pixel: each cell's features say one for each of its pixels.

    Source: W. Shi et al., "Real-Time Single Image and Video Super-Resolution Using an Efficient Sub-Pixel Convolutional
    Neural Network", CVPR 2016.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        self.logits = convolution(width, CELL**2, size=1, gain=0.1)

    def forward(self, scene: Scene, about: PlaceAngle) -> Scores:
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

    def forward(self, scene: Scene, about: PlaceAngle) -> Scores:
        """Of the yaw at the point: `(B, R, 1, 1)`."""
        coefficients = self.read(at_points(scene.features, about.place, CELL))
        coefficients = coefficients.view(-1, self.orders, 2, 1, 1)
        logits = scores(coefficients, max(self.fold, 1) * self.angles)
        return Scores(logits, torch.zeros_like(about.place), 1, self.fold)
