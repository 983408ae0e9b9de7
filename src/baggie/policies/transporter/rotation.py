"""Crops of a feature map about points, turned: what an object would look like if it were turned.

Angles turn from u towards v. In a height map whose columns run along x and whose rows run along y of the robot's base
frame that is from x towards y: counterclockwise seen from above, the sign of a yaw. (On a screen, with v downwards, it
looks clockwise.)
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F


def rotated_crops(features: Tensor, centres: Tensor, angles: Tensor, size: int) -> Tensor:
    """Features `(B, C, H, W)`, centres `(B, 2)` (u, v) pixels, angles `(R,)` radians -> `(B, R, C, size, size)`.

    What lies at `centre + d` in the map appears in the crop of angle a at R(a) d from the crop's centre, which is at
    row and column `size // 2`, as `correlate` has it: the crop shows the surroundings turned by a, so the upright crop
    of a map that was turned by a about the centre is the crop of angle a. Only the crops' own pixels are sampled,
    bilinearly; centres need not be whole pixels, and features outside the map are zero. Differentiable in the features,
    the centres and the angles.
    Raises `ValueError` when the shapes do not fit each other.
    """
    _check(features, centres, angles, size)
    batch, channels, height, width = features.shape
    at = centres.to(features)[:, None, None, None] + _offsets(
        angles.to(features), size
    )  # (B, R, size, size, 2)
    # `align_corners=False`: -1 and 1 are the outer edges of the outermost pixels, which are at -0.5 and n - 0.5.
    grid = (2 * at + 1) / at.new_tensor([width, height]) - 1
    crops = F.grid_sample(features, grid.flatten(1, 2), padding_mode="zeros", align_corners=False)
    return crops.view(batch, channels, len(angles), size, size).transpose(1, 2).contiguous()


def _offsets(angles: Tensor, size: int) -> Tensor:
    """From the centre to what each pixel of the crops shows: `(R,)` -> `(R, size, size, 2)` (u, v) pixels."""
    along = torch.arange(size, dtype=angles.dtype, device=angles.device) - size // 2
    v, u = torch.meshgrid(along, along, indexing="ij")
    cos, sin = angles.cos()[:, None, None], angles.sin()[:, None, None]
    return torch.stack([cos * u + sin * v, cos * v - sin * u], dim=-1)  # turned back, by -a


def _check(features: Tensor, centres: Tensor, angles: Tensor, size: int) -> None:
    if features.dim() != 4 or centres.shape != (len(features), 2) or angles.dim() != 1 or size < 1:
        raise ValueError(
            "expected features (B, C, H, W), centres (B, 2), angles (R,) and a size of at least 1, "
            f"got {tuple(features.shape)}, {tuple(centres.shape)}, {tuple(angles.shape)} and {size}"
        )
