"""Features at points and about points of a map, whatever the resolution they are at."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F


def patches(features: Tensor, centres: Tensor, size: int, stride: int) -> Tensor:
    """Features `(B, C, h, w)` of cells of `stride` pixels, centres `(B, 2)` (u, v) pixels -> `(B, C, size, size)`.

    One value a pixel of the map, bilinear between the cells' centres and as at the rim beyond them. The centre is at
    row and column `size // 2`, as `correlate` has it.
    """
    along = torch.arange(size, device=features.device) - size // 2
    v, u = torch.meshgrid(along, along, indexing="ij")
    pixels = centres.to(features)[:, None, None] + torch.stack([u, v], dim=-1)
    height, width = features.shape[-2:]
    # `align_corners=False`: -1 and 1 are the outer edges of the cells, which are at pixels -0.5 and stride n - 0.5.
    grid = (2 * pixels + 1) / (stride * pixels.new_tensor([width, height])) - 1
    return F.grid_sample(features, grid, padding_mode="border", align_corners=False)


def at_points(features: Tensor, centres: Tensor, stride: int) -> Tensor:
    """The same at the centres alone: `(B, C)`."""
    return patches(features, centres, 1, stride)[:, :, 0, 0]
