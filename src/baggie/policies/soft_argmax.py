"""Points from heat maps, differentiably."""

from __future__ import annotations

import torch
from torch import Tensor

_NOWHERE = -1e4
"""A logit that leaves nothing of a cell."""


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
    u, v = cell_axes(heat)
    return torch.stack([heat.sum(dim=2) @ u, heat.sum(dim=3) @ v], dim=-1)


def local_soft_argmax(logits: Tensor, radius: float) -> Tensor:
    """The mean position within `radius` cells of each map's greatest value: `(B, K, h, w)` -> `(B, K, 2)` (u, v).

    What little weight lies elsewhere, on a second bag or something like one, does not pull.
    """
    width = logits.shape[-1]
    peak = logits.flatten(2).argmax(dim=2)
    at = torch.stack([peak % width, peak // width], dim=-1).to(logits.dtype)
    return soft_argmax(heat_maps(near_only(logits, at, radius)))


def near_only(logits: Tensor, points: Tensor, radius: float | Tensor) -> Tensor:
    """`(B, K, h, w)` with nothing left further than `radius` cells from the points `(B, K, 2)` (u, v) in cells."""
    return torch.where(squared_distances(logits, points) <= radius**2, logits, _NOWHERE)


def squared_distances(maps: Tensor, points: Tensor) -> Tensor:
    """From points `(B, K, 2)` (u, v) to every cell of `maps` `(B, K, h, w)`, in cells squared: `(B, K, h, w)`."""
    u, v = cell_axes(maps)
    return (u - points[..., 0:1]).square().unsqueeze(-2) + (v - points[..., 1:2]).square().unsqueeze(-1)


def gaussians(centers: Tensor, sigma: float, height: int, width: int) -> Tensor:
    """Heat maps of normal distributions: centres `(B, K, 2)` (u, v) in cells -> `(B, K, height, width)`, sums 1."""
    u, v = cell_axes(centers.new_empty(height, width))
    along_u = torch.softmax(-((u - centers[..., :1]) ** 2) / (2 * sigma**2), dim=-1)
    along_v = torch.softmax(-((v - centers[..., 1:]) ** 2) / (2 * sigma**2), dim=-1)
    return along_v.unsqueeze(-1) * along_u.unsqueeze(-2)


def cell_axes(maps: Tensor) -> tuple[Tensor, Tensor]:
    """The u `(w,)` and the v `(h,)` of the cells of maps `(..., h, w)`."""
    height, width = maps.shape[-2:]
    u = torch.arange(width, dtype=maps.dtype, device=maps.device)
    return u, torch.arange(height, dtype=maps.dtype, device=maps.device)
