"""Cross-correlation of feature maps with large kernels of their own.

Source: A. Zeng et al., "Transporter Networks: Rearranging the Visual World for Robotic Manipulation", CoRL 2020,
section 3.2: the kernels are crops of one feature map, turned by R angles; the features are another map of the scene.
"""

from __future__ import annotations

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
    """The same, on a map that goes on at its other side. Channels are summed in the spectrum: one inverse transform a
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
