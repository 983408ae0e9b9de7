"""Points from heat maps, differentiably."""

from __future__ import annotations

import torch
from torch import Tensor


def heat_maps(logits: Tensor) -> Tensor:
    """Softmax over the cells of each map: `(B, K, h, w)` -> `(B, K, h, w)`, each map sums to 1."""
    return logits.flatten(2).softmax(dim=2).view_as(logits)


def soft_argmax(heat: Tensor) -> Tensor:
    """The mean position under each heat map: `(B, K, h, w)` -> `(B, K, 2)` as (u, v) in cells.

    Cell centres are at integers. Unlike the argmax it is differentiable and finer than a cell.
    Source: S. Levine, C. Finn, T. Darrell, P. Abbeel, "End-to-end training of deep visuomotor policies", JMLR
    17 (2016).

    >>> heat = torch.zeros(1, 1, 3, 5)
    >>> heat[0, 0, 1, 2] = heat[0, 0, 1, 3] = 0.5
    >>> soft_argmax(heat)
    tensor([[[2.5000, 1.0000]]])
    """
    height, width = heat.shape[-2:]
    u = torch.arange(width, dtype=heat.dtype, device=heat.device)
    v = torch.arange(height, dtype=heat.dtype, device=heat.device)
    return torch.stack([heat.sum(dim=2) @ u, heat.sum(dim=3) @ v], dim=-1)


def gaussians(centers: Tensor, sigma: float, height: int, width: int) -> Tensor:
    """Heat maps of normal distributions: centres `(B, K, 2)` (u, v) in cells -> `(B, K, height, width)`, sums
    1.
    """
    u = torch.arange(width, dtype=centers.dtype, device=centers.device)
    v = torch.arange(height, dtype=centers.dtype, device=centers.device)
    along_u = torch.softmax(-((u - centers[..., :1]) ** 2) / (2 * sigma**2), dim=-1)
    along_v = torch.softmax(-((v - centers[..., 1:]) ** 2) / (2 * sigma**2), dim=-1)
    return along_v.unsqueeze(-1) * along_u.unsqueeze(-2)
