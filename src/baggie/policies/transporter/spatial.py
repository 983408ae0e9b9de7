"""Features at and about points of a map: correlation with large kernels, turned crops, angles from phases.

Cross-correlation: A. Zeng et al., "Transporter Networks: Rearranging the Visual World for Robotic Manipulation", CoRL
2020, section 3.2: the kernels are crops of one feature map, turned by R angles; the features are another map of the
scene.

By how much an object has to turn is a band-limited score of the angle, without rotated crops. The network gives complex
channels of angular orders n = 1 .. N, as (cos, sin), at every pixel: q_n at the pick and k_n(y) at a place y. Where the
scene turns by b, channels of order n are to be multiplied by exp(i n b). To put the object at y after turning it by a
scores

    S(y, a) = Σ over n and channels of Re( conj(q_n) k_n(y) exp(-i n a) )

If the pick and the place turn alike, S stays as it is; if only the place turns by b, S is shifted by b along a. Angles
turn as in `rotation`.

Symmetry costs nothing: an object that looks the same s times a turn can only excite orders that are multiples of s (the
others would have to equal themselves times exp(2 π i n / s), so they are zero), and then S has s equal maxima a turn.

Crops about points, turned, show what an object would look like if it were turned. Angles turn from u towards v. In a
height map whose columns run along x and whose rows run along y of the robot's base frame that is from x towards y:
counterclockwise seen from above, the sign of a yaw. (On a screen, with v downwards, it looks clockwise.)
"""

from __future__ import annotations

import math
from typing import Literal

import torch
from scipy.fft import next_fast_len
from torch import Tensor
from torch.nn import functional as F

Method = Literal["fft", "direct"]


def correlate(features: Tensor, kernels: Tensor, method: Method = "fft", margin: int = 0) -> Tensor:
    """Features `(B, C, H, W)`, of each R kernels `(B, R, C, k, k)` -> scores `(B, R, H, W)`.

    With the kernel's centre at row and column k // 2 (of an odd k the middle, of an even k the first after it):

        scores[b, r, v, u] = Σ over c, i, j of kernels[b, r, c, i, j] features[b, c, v + i - k // 2, u + j - k // 2]

    and features outside the map are zero. Of the scores, `margin` cells at every side are left out. `"fft"` multiplies
    spectra and agrees with `"direct"`, a grouped convolution, to some 1e-6 of the greatest score, gradients too.
    `benchmarks/correlation.py` compares their speed.
    Raises `ValueError` when the shapes do not fit each other.
    """
    _check(features, kernels)
    # On a CPU the gradients of a channels-last convolution with kernels this large take some 20 times as long.
    features, kernels = features.contiguous(), kernels.contiguous()
    size, shape = kernels.shape[-1], [n - 2 * margin for n in features.shape[-2:]]
    before, after = size // 2 - margin, size - 1 - size // 2 - margin
    if method == "fft":
        # What wraps around meets the zeros put before the map: none are needed behind it.
        return _spectral(F.pad(features, (before, min(after, 0)) * 2), kernels, shape)
    # Padded beforehand: the convolution's own padding takes a hundred times as long with kernels of 65 on a CPU.
    return _direct(F.pad(features, (before, after) * 2), kernels, shape)


def _direct(features: Tensor, kernels: Tensor, shape: list[int]) -> Tensor:
    """Scores `(B, R, *shape)` from the first pixel on where a kernel's first one can be."""
    # A group is a sample.
    scores = F.conv2d(features.flatten(0, 1).unsqueeze(0), kernels.flatten(0, 1), groups=len(kernels))
    return scores.view(*kernels.shape[:2], *shape)


def _spectral(features: Tensor, kernels: Tensor, shape: list[int]) -> Tensor:
    """Correlate on a map that goes on at its other side. Channels are summed in the spectrum: one inverse transform a
    rotation.

    The two axes of the kernels and of the scores are transformed one after the other, so that no row is that holds only
    padding or is not kept; with `rfft2` and the gradients it takes twice as long.
    """
    (height, width), size = shape, features.shape[-2:]
    rows, columns = (next_fast_len(n, real=True) for n in size)
    of_features = torch.fft.rfft2(features, s=(rows, columns))
    of_kernels = torch.fft.fft(torch.fft.rfft(kernels, columns), rows, dim=-2)
    of_scores = (of_features.unsqueeze(1) * of_kernels.conj()).sum(dim=2)
    kept = torch.fft.ifft(of_scores, dim=-2)[..., :height, :]
    scores: Tensor = torch.fft.irfft(kept, columns)[..., :width].contiguous()
    return scores


def _check(features: Tensor, kernels: Tensor) -> None:
    fits = features.dim() == 4 and kernels.dim() == 5 and kernels.shape[-2] == kernels.shape[-1]
    if not fits or features.shape[:2] != (kernels.shape[0], kernels.shape[2]):
        raise ValueError(
            "expected features (B, C, H, W) and square kernels (B, R, C, k, k) of the same B and C, "
            f"got {tuple(features.shape)} and {tuple(kernels.shape)}"
        )


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


def rotated_crops(features: Tensor, centres: Tensor, angles: Tensor, size: int) -> Tensor:
    """Features `(B, C, H, W)`, centres `(B, 2)` (u, v) pixels, angles `(R,)` radians -> `(B, R, C, size, size)`.

    What lies at `centre + d` in the map appears in the crop of angle a at R(a) d from the crop's centre, which is at
    row and column `size // 2`, as `correlate` has it: the crop shows the surroundings turned by a, so the upright crop
    of a map that was turned by a about the centre is the crop of angle a. Only the crops' own pixels are sampled,
    bilinearly; centres need not be whole pixels, and features outside the map are zero. Differentiable in the features,
    the centres and the angles.
    Raises `ValueError` when the shapes do not fit each other.
    """
    _check_turns(features, centres, angles, size)
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


def _check_turns(features: Tensor, centres: Tensor, angles: Tensor, size: int) -> None:
    if features.dim() != 4 or centres.shape != (len(features), 2) or angles.dim() != 1 or size < 1:
        raise ValueError(
            "expected features (B, C, H, W), centres (B, 2), angles (R,) and a size of at least 1, "
            f"got {tuple(features.shape)}, {tuple(centres.shape)}, {tuple(angles.shape)} and {size}"
        )


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
    """Features `(B, C, h, w)` of cells of `stride` pixels at centres `(B, 2)` (u, v) pixels -> `(B, C)`."""
    return patches(features, centres, 1, stride)[:, :, 0, 0]
