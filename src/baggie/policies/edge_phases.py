"""Which way edges run: what the yaw of an object is made of, computed rather than learned.

A phase of angular order s says exp(i s θ) of directions θ that look the same s times a turn: order 2 for edges, whose
two sides are alike, and order 4 for the sides of a square. Averaged over edges it is a sum of unit vectors, as in the
structure tensor (J. Bigün and G. Granlund, "Optimal orientation detection of linear symmetry", ICCV 1987) and its
higher orders. A network that has to find this by itself under random rotations may not in some hundred batches.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

STRIDE = 4
"""Pixels of the image to one of the phases."""
AROUND = (1.5, 3.0, 5.0)
"""Radii, sigmas in strides, within which edges are averaged: from a corner to all of a bag."""
CHANNELS = 4 * len(AROUND)
_FAINT = 0.01
"""Edges that are fainter than this, in brightness a pixel, count little: they are noise."""
_SOBEL = (
    torch.tensor([[[[-1.0, 0, 1], [-2, 0, 2], [-1, 0, 1]]], [[[-1.0, -2, -1], [0, 0, 0], [1, 2, 1]]]]) / 8
)


def edge_phases(images: Tensor) -> Tensor:
    """Images `(B, C, H, W)`, 0 to 255, of which the first three channels are colours -> `(B, CHANNELS, H / 4, W / 4)`.

    For each radius in `AROUND` cos and sin of order 4, then of order 2, of the directions across the edges around, as
    long as these agree, at most 1. Directions are from u towards v. No gradients pass.
    """
    with torch.no_grad():
        colors = images[:, :3].float() / 255
        batch, channels, height, width = colors.shape
        sobel = _SOBEL.to(colors)
        slopes = F.conv2d(colors.reshape(-1, 1, height, width), sobel, padding=1)
        du, dv = slopes.view(batch, channels, 2, height, width).unbind(dim=2)
        strength = (du.square() + dv.square() + 1e-6).sqrt()
        # z = du + i dv: |z| exp(2 i θ) is z² / |z|, and squared once more and divided again |z| exp(4 i θ).
        cos2, sin2 = (du.square() - dv.square()) / strength, 2 * du * dv / strength
        cos4, sin4 = (cos2.square() - sin2.square()) / strength, 2 * cos2 * sin2 / strength
        sums = torch.stack([cos4, sin4, cos2, sin2, strength], dim=1).mean(dim=2)
        sums = F.avg_pool2d(sums, STRIDE)
        around = [_blurred(sums, sigma) for sigma in AROUND]
        return torch.cat([part[:, :4] / (part[:, 4:] + _FAINT) for part in around], dim=1)


def _blurred(x: Tensor, sigma: float) -> Tensor:
    """Averaged with a normal distribution's weights, 2.5 `sigma` far; zero outside the picture."""
    reach = int(2.5 * sigma)
    along = torch.arange(-reach, reach + 1, dtype=x.dtype, device=x.device)
    weights = torch.softmax(-along.square() / (2 * sigma**2), dim=0).expand(x.shape[1], 1, 1, -1)
    x = F.conv2d(x, weights, padding=(0, reach), groups=x.shape[1])
    return F.conv2d(x, weights.transpose(2, 3), padding=(reach, 0), groups=x.shape[1])
