"""How long the correlation of Transporter Networks takes: by spectra and directly, on one thread.

    python benchmarks/correlation.py

At the published size (3 channels, crops of 64 pixels, 36 rotations, a height map of 320 x 160), and at a quarter of its
resolution with more channels. Forward alone, as for a decision; then with the gradients of features and kernels, as for
a training step. The last column is how far the two results, or gradients, are apart, of the greatest value.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from baggie.learning.loop import flushed_denormals
from baggie.policies.transporter.spatial import Method, correlate

METHODS: tuple[Method, Method] = ("fft", "direct")


class Case(NamedTuple):
    """One size."""

    batch: int
    channels: int
    kernel: int
    rotations: int
    height: int
    width: int
    rounds: int


CASES = (
    Case(1, 3, 64, 36, 320, 160, rounds=5),
    Case(1, 8, 16, 12, 80, 40, rounds=25),
    Case(1, 8, 16, 36, 80, 40, rounds=25),
    Case(1, 24, 16, 12, 80, 40, rounds=25),
    Case(1, 24, 16, 36, 80, 40, rounds=25),
    Case(4, 16, 16, 12, 80, 40, rounds=25),
)
Results = tuple[Tensor, ...]


def main() -> None:
    torch.set_num_threads(1)
    print("one thread; rounds interleaved; ms")
    print(
        f"{'B':>2}{'C':>4}{'k':>4}{'R':>4}{'H x W':>11}  {'pass':<14}{'method':<8}{'rounds':>7}"
        f"{'median':>9}{'quartiles':>16}{'fastest':>9}{'slowest':>9}{'apart':>10}"
    )
    with flushed_denormals():
        for case in CASES:
            for name, run in (("forward", forward), ("+ backward", forward_and_backward)):
                measure(case, name, run)


def measure(case: Case, name: str, run: Callable[[Tensor, Tensor, Method], Results]) -> None:
    torch.manual_seed(0)
    features = torch.randn(case.batch, case.channels, case.height, case.width)
    kernels = torch.randn(case.batch, case.rotations, case.channels, case.kernel, case.kernel)
    times: dict[Method, list[float]] = {method: [] for method in METHODS}
    results: dict[Method, Results] = {}
    for turn in range(case.rounds + 1):
        for method in METHODS:
            start = time.perf_counter()
            results[method] = run(features, kernels, method)
            if turn > 0:  # the first one warms up
                times[method].append(1000 * (time.perf_counter() - start))
    apart = max(
        float((fft - direct).abs().max() / direct.abs().max())
        for fft, direct in zip(*results.values(), strict=True)
    )
    for method, ms in times.items():
        low, median, high = np.percentile(ms, (25, 50, 75))
        print(
            f"{case.batch:>2}{case.channels:>4}{case.kernel:>4}{case.rotations:>4}"
            f"{f'{case.height} x {case.width}':>11}  {name:<14}{method:<8}{case.rounds:>7}"
            f"{median:>9.1f}{f'{low:.1f} .. {high:.1f}':>16}{min(ms):>9.1f}{max(ms):>9.1f}{apart:>10.0e}",
            flush=True,
        )


@torch.no_grad()
def forward(features: Tensor, kernels: Tensor, method: Method) -> Results:
    return (correlate(features, kernels, method),)


def forward_and_backward(features: Tensor, kernels: Tensor, method: Method) -> Results:
    inputs = (features.requires_grad_(), kernels.requires_grad_())
    scores = correlate(*inputs, method)
    return torch.autograd.grad(scores.square().sum() / 2, inputs)


if __name__ == "__main__":
    main()
