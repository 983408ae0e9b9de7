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


def correlate(features: Tensor, kernels: Tensor, method: Method = "fft") -> Tensor:
    """Features `(B, C, H, W)`, of each R kernels `(B, R, C, k, k)` -> scores `(B, R, H, W)`.

    With the kernel's centre at row and column k // 2 (of an odd k the middle, of an even k the first after it):

        scores[b, r, v, u] = Σ over c, i, j of kernels[b, r, c, i, j] features[b, c, v + i - k // 2, u + j - k // 2]

    and features outside the map are zero. `"fft"` multiplies spectra and agrees with `"direct"`, a grouped convolution,
    to some 1e-6 of the greatest score, gradients too. `benchmarks/correlation.py` compares their speed.
    Raises `ValueError` when the shapes do not fit each other.
    """
    _check(features, kernels)
    # On a CPU the gradients of a channels-last convolution with kernels this large take some 20 times as long.
    features, kernels = features.contiguous(), kernels.contiguous()
    return _spectral(features, kernels) if method == "fft" else _direct(features, kernels)


def _direct(features: Tensor, kernels: Tensor) -> Tensor:
    batch, rotations, _, size, _ = kernels.shape
    before, after = size // 2, size - 1 - size // 2
    # Padded beforehand: the convolution's own padding takes a hundred times as long with kernels of 65 on a CPU.
    padded = F.pad(features, (before, after, before, after)).flatten(0, 1).unsqueeze(0)
    scores = F.conv2d(padded, kernels.flatten(0, 1), groups=batch)  # a group is a sample
    return scores.view(batch, rotations, *features.shape[-2:])


def _spectral(features: Tensor, kernels: Tensor) -> Tensor:
    """Channels are summed in the spectrum: one inverse transform a rotation.

    A circular correlation of length n + k // 2 is enough: what wraps around meets the zeros put before the map, and
    what of a kernel is longer than that meets no feature. The two axes of the kernels and of the scores are transformed
    one after the other, so that no row is that holds only padding or is not kept; with `rfft2` and the gradients it
    takes twice as long.
    """
    height, width = features.shape[-2:]
    before = kernels.shape[-1] // 2
    rows, columns = (next_fast_len(n + before, real=True) for n in (height, width))
    of_features = torch.fft.rfft2(F.pad(features, (before, 0, before, 0)), s=(rows, columns))
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
