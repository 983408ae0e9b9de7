"""What one look at a map says about a place, an angle, or both: logits, and which pixels and angles they are of.

A decision is a chain of such looks, from coarse to fine: each is about where the one before it ended. All that learning
and planning need to know of a look is here, so that presets may differ in how many they take.

What a network is to say about a true place and angle, and what it says, are distributions over R rotation bins, H rows
and W columns at once. Bin r is the angle 2 π r / R; angles turn as in `rotation`. Truths between pixels and between
bins are not rounded.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional as F

from baggie.policies.transporter.spatial import patches


class PlaceAngle(NamedTuple):
    """Places and angles of B samples."""

    place: Tensor
    """`(B, 2)` (u, v) pixels, centres at integers."""
    angle: Tensor
    """`(B,)` radians in [-π, π)."""


def bin_angles(rotations: int) -> Tensor:
    """The angles of R rotation bins: `(R,)` radians, 2 π r / R."""
    return torch.arange(rotations) * (2 * math.pi / rotations)


def soft_targets(
    truth: PlaceAngle,
    symmetry: Tensor,
    shape: tuple[int, int, int],
    sigma_px: float = 0.0,
    sigma_bins: float = 0.0,
) -> Tensor:
    """Target distributions `(B, R, H, W)`, each sums to 1, for `shape` (R, H, W).

    `symmetry` `(B,)`, whole numbers: how often a turn the object looks the same; each of so many copies of the angle
    has the same weight. 0 is a thing that looks the same at any angle: all bins are alike.
    Weight falls off from the truth as a normal distribution of `sigma_px` pixels and `sigma_bins` bins; at 0, linearly
    to nothing at a distance of 1, so that the two next to the truth share it and their mean is exactly there.
    Raises `ValueError` for places outside the picture, whose outermost pixels reach half a pixel further than their
    centres, and for shapes that do not fit.
    """
    rotations, height, width = shape
    _check(truth, symmetry, height, width)
    u, v = truth.place.unbind(dim=-1)
    along_u = _fall_off(_cells(width, u) - u.unsqueeze(-1), sigma_px)
    along_v = _fall_off(_cells(height, v) - v.unsqueeze(-1), sigma_px)
    along_turn = _angle_weights(truth.angle, symmetry, rotations, sigma_bins)
    return along_turn[:, :, None, None] * along_v[:, None, :, None] * along_u[:, None, None, :]


def log_softmax(scores: Tensor) -> Tensor:
    """Log probabilities over all rotations and pixels together: `(B, R, H, W)` -> `(B, R, H, W)`."""
    return scores.flatten(1).log_softmax(dim=1).view_as(scores)


def cross_entropy(scores: Tensor, targets: Tensor) -> Tensor:
    """The loss: of scores (logits) against target distributions, both `(B, R, H, W)`; mean over B, nats."""
    return F.cross_entropy(scores.flatten(1), targets.flatten(1))


def expectation(scores: Tensor, radius_px: int = 2, radius_bins: int = 1) -> PlaceAngle:
    """Place and angle finer than pixels and bins: the mean of the softmax around the best cell of `(B, R, H, W)`.

    Only cells within `radius_px` rows and columns and `radius_bins` bins of the best one count, so that other places
    and symmetric copies of the angle do not pull. Angles are averaged as turns from the best bin: there is no seam. Of
    targets without sigma the mean is the truth; with one, radii of 3 sigma lose little. Differentiable.
    Raises `ValueError` when the bins around the best one would meet on its other side.
    """
    batch, rotations, height, width = scores.shape
    if 2 * radius_bins + 1 > rotations:
        raise ValueError(
            f"expected at least {2 * radius_bins + 1} rotations, got {rotations}: lower radius_bins"
        )
    best = scores.flatten(1).argmax(dim=1)
    best_r, best_v, best_u = best // (height * width), best // width % height, best % width
    turn, near = _steps(radius_bins, scores), _steps(radius_px, scores)
    r = (best_r[:, None] + turn) % rotations
    v, u = best_v[:, None] + near, best_u[:, None] + near
    inside = ((v >= 0) & (v < height))[:, :, None] & ((u >= 0) & (u < width))[:, None, :]
    around = scores[
        torch.arange(batch, device=scores.device)[:, None, None, None],
        r[:, :, None, None],
        v.clamp(0, height - 1)[:, None, :, None],
        u.clamp(0, width - 1)[:, None, None, :],
    ].masked_fill(~inside[:, None], -math.inf)
    weight = around.flatten(1).softmax(dim=1).view_as(around)
    mean_u = best_u + weight.sum(dim=(1, 2)) @ near.to(scores)
    mean_v = best_v + weight.sum(dim=(1, 3)) @ near.to(scores)
    mean_r = best_r + weight.sum(dim=(2, 3)) @ turn.to(scores)
    angle = torch.remainder(mean_r * (2 * math.pi / rotations) + math.pi, 2 * math.pi) - math.pi
    return PlaceAngle(torch.stack([mean_u, mean_v], dim=-1), angle)


def _angle_weights(angles: Tensor, symmetry: Tensor, rotations: int, sigma_bins: float) -> Tensor:
    """`(B,)` radians, `(B,)` -> `(B, R)`: the sum over the symmetric copies of each angle; each row sums to 1."""
    copies = torch.arange(max(1, int(symmetry.max())), device=angles.device)
    times = symmetry.clamp(min=1)[:, None]
    at = (angles[:, None] / (2 * math.pi) + copies / times) * rotations  # (B, copies), in bins
    apart = _cells(rotations, angles) - at.unsqueeze(-1)
    apart = torch.remainder(apart + rotations / 2, rotations) - rotations / 2
    weight = _fall_off(apart, sigma_bins) * (copies < times).unsqueeze(-1)
    return torch.where(symmetry[:, None] == 0, 1 / rotations, weight.sum(dim=1) / times)


def _fall_off(apart: Tensor, sigma: float) -> Tensor:
    """Weights of cells so far from the truth, `(..., n)`; each row sums to 1."""
    if sigma > 0:
        return torch.softmax(-apart.square() / (2 * sigma**2), dim=-1)
    return F.normalize((1 - apart.abs()).clamp(min=0), p=1, dim=-1)


def _cells(count: int, like: Tensor) -> Tensor:
    return torch.arange(count, dtype=like.dtype, device=like.device)


def _check(truth: PlaceAngle, symmetry: Tensor, height: int, width: int) -> None:
    batch = len(truth.place)
    if truth.place.shape != (batch, 2) or truth.angle.shape != (batch,) or symmetry.shape != (batch,):
        raise ValueError(
            "expected places (B, 2), angles (B,) and symmetries (B,), "
            f"got {tuple(truth.place.shape)}, {tuple(truth.angle.shape)} and {tuple(symmetry.shape)}"
        )
    reach = truth.place.new_tensor([width - 0.5, height - 0.5])
    inside = ((truth.place >= -0.5) & (truth.place <= reach)).all(dim=1)
    if not bool(inside.all()):
        raise ValueError(
            f"expected places inside a picture of {width} x {height} pixels, got (u, v) "
            f"{truth.place[~inside].tolist()}: leave out samples whose place is not in the picture"
        )
    if bool((symmetry < 0).any()):
        raise ValueError(f"expected symmetries of 0 (any angle), 1 (none), 2, ...; got {symmetry.tolist()}")


def _steps(radius: int, like: Tensor) -> Tensor:
    return torch.arange(-radius, radius + 1, device=like.device)


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
        """Leave out the pixels that are `barred` `(B, H, W)`, of a look at every pixel of the map."""
        return self._replace(logits=self.logits.masked_fill(barred[:, None], -math.inf))

    def given(self, before: Scores) -> Scores:
        """Combine a finer look with what a coarser one said: the product of both, whatever its angles.

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
        """Share of the weight that is within two cells of the best one: `(B,)` in [0, 1]."""
        heat = self.heat()
        _, height, width = heat.shape
        best = heat.flatten(1).argmax(dim=1)
        rows = (torch.arange(height, device=heat.device) - (best // width)[:, None]).abs() <= _RADIUS_PX
        columns = (torch.arange(width, device=heat.device) - (best % width)[:, None]).abs() <= _RADIUS_PX
        return (heat * rows[:, :, None] * columns[:, None, :]).sum(dim=(1, 2))
