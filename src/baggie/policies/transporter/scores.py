"""What one look at a map says about a place, an angle, or both: logits, and which pixels and angles they are of.

A decision is a chain of such looks, from coarse to fine: each is about where the one before it ended. All that learning
and planning need to know of a look is here, so that presets may differ in how many they take.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from baggie.policies.transporter.sampling import patches
from baggie.policies.transporter.soft_targets import (
    PlaceAngle,
    bin_angles,
    cross_entropy,
    expectation,
    soft_targets,
)

_RADIUS_PX = 2
"""Cells about the best one that decide where it is to a fraction of a cell."""
_DOUBT = 1e-3
"""Of what a coarse look is surest of: so much a finer one gives it to have overlooked elsewhere."""
_SIGMA_PX = 1.0
"""Of targets whose cells are pixels, labels being no better; coarser cells share the truth between neighbours."""


def turn_angles(bins: int, fold: int) -> Tensor:
    """The angles of bins that share the `fold`-th part of a turn: `(bins,)` radians in [-π / fold, π / fold).

    Of all copies of an angle that look the same these are the ones that turn least.
    """
    wrapped = torch.remainder(bin_angles(bins) + math.pi, 2 * math.pi) - math.pi
    return wrapped / max(fold, 1)


class Scores(NamedTuple):
    """Logits over R bins of angle and h x w cells, of B samples."""

    logits: Tensor
    """`(B, R, h, w)`."""
    origin: Tensor
    """`(B, 2)` (u, v) pixels: the centre of the first cell."""
    stride: int
    """Pixels from one cell to the next."""
    fold: int
    """How often a turn everything looks the same, so that the bins share one such part; 0 where no angle matters."""

    def loss(self, truth: PlaceAngle, symmetry: Tensor) -> Tensor:
        """Cross-entropy to the truth, nats. `symmetry` `(B,)`: of the samples, multiples of `fold`; 0 for any angle.

        A look with one bin is only about the place, one with one cell only about the angle.
        """
        _, rotations, height, width = self.logits.shape
        place = (truth.place - self.origin) / self.stride
        if height == width == 1:
            place = torch.zeros_like(place)
        times = max(self.fold, 1)
        within = torch.ones_like(symmetry) if rotations == 1 else symmetry // times
        targets = soft_targets(
            PlaceAngle(place, truth.angle * times),
            within,
            (rotations, height, width),
            sigma_px=_SIGMA_PX if self.stride == 1 else 0.0,
        )
        return cross_entropy(self.logits, targets)

    def read(self, before: PlaceAngle) -> PlaceAngle:
        """The best place and angle, finer than cells and bins; what this look is not about stays as it was `before`."""
        _, rotations, height, width = self.logits.shape
        found = expectation(self.logits, _RADIUS_PX, radius_bins=min(1, (rotations - 1) // 2))
        place = before.place if height == width == 1 else self.origin + self.stride * found.place
        angle = before.angle if rotations == 1 else found.angle / max(self.fold, 1)
        return PlaceAngle(place, angle)

    def without(self, barred: Tensor) -> Scores:
        """The same of a look at every pixel of the map, but for those that are `barred` `(B, H, W)`."""
        return self._replace(logits=self.logits.masked_fill(barred[:, None], -math.inf))

    def given(self, before: Scores) -> Scores:
        """The same of a finer look, given what a coarser one said: the product of both, whatever its angles.

        A finer look is taught to tell places near by from each other, all as likely; how likely they are the coarser
        one, at every cell of the map, knows. A look at one cell, or after one at one cell, stays as it is; else it is
        square, at pixels.
        """
        heat, size = before.heat(), self.logits.shape[-1]
        if size == 1 or heat.shape[1] == heat.shape[2] == 1:
            return self
        near = patches(heat[:, None], self.origin + size // 2, size, before.stride)
        doubt = _DOUBT * heat.amax(dim=(1, 2))[:, None, None, None]
        return self._replace(logits=self.logits + torch.log(near + doubt))

    def heat(self) -> Tensor:
        """How likely each cell is, whatever the angle: `(B, h, w)`, sums to 1."""
        return self.logits.flatten(1).softmax(dim=1).view_as(self.logits).sum(dim=1)

    def share(self) -> Tensor:
        """Of the weight, what is within two cells of the best one: `(B,)` in [0, 1]."""
        heat = self.heat()
        _, height, width = heat.shape
        best = heat.flatten(1).argmax(dim=1)
        rows = (torch.arange(height, device=heat.device) - (best // width)[:, None]).abs() <= _RADIUS_PX
        columns = (torch.arange(width, device=heat.device) - (best % width)[:, None]).abs() <= _RADIUS_PX
        return (heat * rows[:, :, None] * columns[:, None, :]).sum(dim=(1, 2))
