"""By how much an object has to turn, from phases: a band-limited score of the angle, without rotated crops.

The network gives complex channels of angular orders n = 1 .. N, as (cos, sin), at every pixel: q_n at the pick and
k_n(y) at a place y. Where the scene turns by b, channels of order n are to be multiplied by exp(i n b). To put the
object at y after turning it by a scores

    S(y, a) = Σ over n and channels of Re( conj(q_n) k_n(y) exp(-i n a) )

If the pick and the place turn alike, S stays as it is; if only the place turns by b, S is shifted by b along a. Angles
turn as in `rotation`.

Symmetry costs nothing: an object that looks the same s times a turn can only excite orders that are multiples of s (the
others would have to equal themselves times exp(2 π i n / s), so they are zero), and then S has s equal maxima a turn.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

_GRID = 8
"""Angles a wave of the highest order, from which the best one is refined."""
_STEPS = 4
"""Of Newton's method: the number of right digits doubles at each."""


def coefficients(q: Tensor, k: Tensor) -> Tensor:
    """Fourier coefficients of S along the angle: conj(q_n) k_n(y), summed over the channels of each order.

    q `(B, N, M, 2)` at the pick, M channels of each order 1 .. N; k `(B, N, M, 2, H, W)` at the places
    -> `(B, N, 2, H, W)`, real and imaginary parts.
    Raises `ValueError` when the shapes do not fit each other.
    """
    if q.dim() != 4 or k.dim() != 6 or q.shape != k.shape[:4] or q.shape[3] != 2:
        raise ValueError(
            "expected channels q (B, N, M, 2) and k (B, N, M, 2, H, W) of the same B, N and M, "
            f"got {tuple(q.shape)} and {tuple(k.shape)}"
        )
    q_cos, q_sin = q.unbind(dim=3)
    crossed = torch.stack([torch.stack([q_cos, q_sin], dim=-1), torch.stack([-q_sin, q_cos], dim=-1)], dim=-2)
    return torch.einsum("bnmpc,bnmchw->bnphw", crossed, k)


def scores(coefficients: Tensor, angles: Tensor) -> Tensor:
    """S(y, a): coefficients `(B, N, 2, H, W)`, angles `(R,)` radians -> `(B, R, H, W)`."""
    return torch.einsum(
        "rnp,bnphw->brhw", _waves(angles.to(coefficients), coefficients.shape[1]), coefficients
    )


def best_angle(coefficients: Tensor, start: Tensor | None = None) -> Tensor:
    """The angle of the greatest S: coefficients `(..., N, 2)` of places -> `(...)` radians in [-π, π).

    The best of the angles `start` `(R,)`, then a few steps of Newton's method uphill, each of at most the grid's width.
    By default 8 N angles a turn: with these S is within 8% of its greatest magnitude even where another maximum is
    nearly as high, and exact where none is. Where S has equal maxima, any one of them. Not differentiable.
    """
    with torch.no_grad():
        c = torch.view_as_complex(coefficients.contiguous())
        n = torch.arange(1, c.shape[-1] + 1).to(coefficients)
        width = 2 * math.pi / (_GRID * len(n))
        if start is None:
            start = width * torch.arange(_GRID * len(n))
        start = start.to(coefficients)
        angle = start[torch.einsum("rnp,...np->...r", _waves(start, len(n)), coefficients).argmax(dim=-1)]
        for _ in range(_STEPS):
            terms = c * torch.exp(-1j * n * angle.unsqueeze(-1))  # S is their sum's real part
            slope, curvature = (n * terms.imag).sum(dim=-1), -(n**2 * terms.real).sum(dim=-1)
            uphill = slope / curvature.abs().clamp_min(torch.finfo(slope.dtype).tiny)
            angle = angle + uphill.clamp(-width, width)
        return torch.remainder(angle + math.pi, 2 * math.pi) - math.pi


def _waves(angles: Tensor, orders: int) -> Tensor:
    """The cosine and sine of n a, n = 1 .. N: `(R,)` -> `(R, N, 2)`."""
    phase = angles.unsqueeze(-1) * torch.arange(1, orders + 1).to(angles)
    return torch.stack([phase.cos(), phase.sin()], dim=-1)
