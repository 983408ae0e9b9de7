"""Angles as phases: no seam, and no four-fold ambiguity for square things.

The yaw ψ of an object that looks the same s = 4 times a turn is the phase exp(i s θ) of its direction θ in
the picture. A map with Jacobian J from picture to robot turns directions: the object's sides, at ψ and ψ +
90° in the robot's frame, lie along J⁻¹ (cos, sin) in the picture. A tilted camera shears them, so both sides'
phases are averaged.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

SYMMETRY = 4
"""How often a square bag looks the same in one turn."""

QUARTER_TURN = 2 * math.pi / SYMMETRY


def phase_of(yaw: Tensor, jacobian: Tensor) -> Tensor:
    """Yaw in the robot's frame `(...)` radians, J `(..., 2, 2)` -> unit phase in the picture `(..., 2)` (cos,
    sin).
    """
    total: Tensor | float = 0.0
    for side in (yaw, yaw + QUARTER_TURN):
        cos, sin = side.cos(), side.sin()
        # The adjugate of J turns directions as its inverse does, but for a half turn where J mirrors: 4 θ is
        # the same.
        u = jacobian[..., 1, 1] * cos - jacobian[..., 0, 1] * sin
        v = jacobian[..., 0, 0] * sin - jacobian[..., 1, 0] * cos
        theta = SYMMETRY * torch.atan2(v, u)
        total = total + torch.stack([theta.cos(), theta.sin()], dim=-1)
    return torch.nn.functional.normalize(torch.as_tensor(total), dim=-1)


def yaw_of(phase: Tensor, jacobian: Tensor, iterations: int = 10) -> Tensor:
    """The inverse of `phase_of` by fixed-point iteration: yaw `(...)`, radians in [-45°, 45°)."""
    yaw = torch.zeros_like(phase[..., 0])
    j = jacobian
    mirrored = torch.sign(j[..., 0, 0] * j[..., 1, 1] - j[..., 0, 1] * j[..., 1, 0])
    for _ in range(iterations):
        now = phase_of(yaw, jacobian)
        sine = phase[..., 1] * now[..., 0] - phase[..., 0] * now[..., 1]
        cosine = (phase * now).sum(dim=-1)
        yaw = yaw + mirrored * torch.atan2(sine, cosine) / SYMMETRY
    return torch.remainder(yaw + QUARTER_TURN / 2, QUARTER_TURN) - QUARTER_TURN / 2
