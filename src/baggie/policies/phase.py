"""Angles as phases: no seam, and no ambiguity for things that look the same several times a turn.

The yaw ψ of an object that looks the same s times a turn is the phase exp(i s θ) of its direction θ in the picture.
A map with Jacobian J from picture to robot turns directions: a side at ψ in the robot's frame lies along
J⁻¹ (cos ψ, sin ψ) in the picture. A tilted camera shears the sides of a square, so both sides' phases are averaged;
of a long thing the long side counts.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

SQUARE = 4
"""How often a square bag looks the same in one turn."""
LONG = 2
"""The same for one that is clearly longer than wide; its yaw is that of its long side."""


def phase_of(yaw: Tensor, jacobian: Tensor, symmetry: int = SQUARE) -> Tensor:
    """Yaw in the robot's frame `(...)` radians, J `(..., 2, 2)` -> unit phase in the picture `(..., 2)` (cos, sin).

    `symmetry` is even: `SQUARE` or `LONG`.
    """
    total: Tensor | float = 0.0
    for turn in range(symmetry // 2):
        side = yaw + turn * 2 * math.pi / symmetry
        cos, sin = side.cos(), side.sin()
        # The adjugate of J turns directions as its inverse does, but for a half turn where J mirrors: s θ is the same.
        u = jacobian[..., 1, 1] * cos - jacobian[..., 0, 1] * sin
        v = jacobian[..., 0, 0] * sin - jacobian[..., 1, 0] * cos
        theta = symmetry * torch.atan2(v, u)
        total = total + torch.stack([theta.cos(), theta.sin()], dim=-1)
    return torch.nn.functional.normalize(torch.as_tensor(total), dim=-1)


def yaw_of(phase: Tensor, jacobian: Tensor, symmetry: int = SQUARE, iterations: int = 10) -> Tensor:
    """The inverse of `phase_of` by fixed-point iteration: yaw `(...)`, radians in [-π / s, π / s)."""
    yaw = torch.zeros_like(phase[..., 0])
    j = jacobian
    mirrored = torch.sign(j[..., 0, 0] * j[..., 1, 1] - j[..., 0, 1] * j[..., 1, 0])
    for _ in range(iterations):
        now = phase_of(yaw, jacobian, symmetry)
        sine = phase[..., 1] * now[..., 0] - phase[..., 0] * now[..., 1]
        cosine = (phase * now).sum(dim=-1)
        yaw = yaw + mirrored * torch.atan2(sine, cosine) / symmetry
    turn = 2 * math.pi / symmetry
    return torch.remainder(yaw + turn / 2, turn) - turn / 2
