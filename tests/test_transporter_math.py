"""Correlation with rotated crops: what is the same whichever way it is computed, and what turns with the picture."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.nn import functional as F

from baggie.policies.transporter.spatial import correlate, rotated_crops

METHODS = ("fft", "direct")
seeds, angles = st.integers(0, 10_000), st.floats(-math.pi, math.pi)
shapes = st.tuples(
    st.integers(1, 3), st.integers(1, 4), st.integers(1, 3), st.integers(1, 14), st.integers(1, 14)
)
UPRIGHT = torch.zeros(1)


def drawn(seed: int, *shape: int, dtype: torch.dtype = torch.float32) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=dtype)


def assert_as_close_as(found: torch.Tensor, expected: torch.Tensor, relative: float) -> None:
    assert (found - expected).abs().max() <= relative * expected.abs().max()


@settings(deadline=None)
@given(shapes, st.integers(1, 9), seeds, st.sampled_from([(torch.float32, 1e-5), (torch.float64, 1e-13)]))
def test_spectral_correlation_and_its_gradients_equal_the_direct_one(shape, size, seed, precision):
    batch, channels, rotations, height, width = shape
    dtype, relative = precision
    features = drawn(seed, batch, channels, height, width, dtype=dtype)
    kernels = drawn(seed + 1, batch, rotations, channels, size, size, dtype=dtype)
    weights = drawn(seed + 2, batch, rotations, height, width, dtype=dtype)
    spectral = scores_and_gradients(features, kernels, weights, "fft")
    direct = scores_and_gradients(features, kernels, weights, "direct")
    # Sums may cancel; the same without signs is what the rounding goes by.
    sizes = scores_and_gradients(features.abs(), kernels.abs(), weights.abs(), "direct")
    for found, expected, of_size in zip(spectral, direct, sizes, strict=True):
        assert found.shape == expected.shape
        assert (found - expected).abs().max() <= relative * of_size.max()


def scores_and_gradients(features, kernels, weights, method) -> list[torch.Tensor]:
    """The scores, and the gradients of their weighted sum by features and kernels."""
    inputs = [features.clone().requires_grad_(), kernels.clone().requires_grad_()]
    scores = correlate(*inputs, method)
    return [scores.detach(), *torch.autograd.grad((scores * weights).sum(), inputs)]


@settings(deadline=None)
@given(
    st.sampled_from(METHODS),
    st.integers(1, 9),
    st.integers(1, 6),
    seeds,
    st.tuples(st.integers(7, 14), st.integers(7, 14)),
)
def test_a_margin_leaves_out_the_scores_at_every_side(method, size, margin, seed, shape):
    features = drawn(seed, 2, 3, *(n + 6 for n in shape), dtype=torch.float64)
    kernels = drawn(seed + 1, 2, 2, 3, size, size, dtype=torch.float64)
    everywhere = correlate(features, kernels, "direct")
    inner = everywhere[..., margin:-margin, margin:-margin]
    assert torch.allclose(correlate(features, kernels, method, margin), inner)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(("height", "width", "size"), [(4, 5, 3), (5, 3, 4), (2, 3, 6)])
def test_gradients_of_the_correlation(method, height, width, size):
    features = drawn(0, 2, 2, height, width, dtype=torch.float64).requires_grad_()
    kernels = drawn(1, 2, 3, 2, size, size, dtype=torch.float64).requires_grad_()
    assert torch.autograd.gradcheck(lambda f, k: correlate(f, k, method), (features, kernels))


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("size", [1, 2, 3, 4, 5, 8])
def test_a_kernels_centre_is_at_half_its_size_rounded_down(method, size):
    features = drawn(0, 1, 1, 9, 11)
    kernel = torch.zeros(1, 1, 1, size, size)
    kernel[..., size // 2, size // 2] = 1
    assert torch.allclose(correlate(features, kernel, method), features, atol=1e-6)


@pytest.mark.parametrize("method", METHODS)
@given(st.integers(1, 8), st.integers(-5, 5), st.integers(-5, 5), seeds)
def test_a_shifted_picture_gives_a_shifted_score(method, size, down, right, seed):
    features = F.pad(drawn(seed, 1, 2, 6, 8), (14, 14, 14, 14))  # nothing reaches the edges
    kernels = drawn(seed + 1, 1, 3, 2, size, size)
    shifted = correlate(features.roll((down, right), dims=(2, 3)), kernels, method)
    expected = correlate(features, kernels, method).roll((down, right), dims=(2, 3))
    assert_as_close_as(shifted, expected, 1e-5)


def test_convolutions_never_see_channels_last(monkeypatch):
    convolve, contiguous = F.conv2d, []

    def watched(features, kernels, **options):
        contiguous.extend([features.is_contiguous(), kernels.is_contiguous()])
        return convolve(features, kernels, **options)

    features = drawn(0, 2, 3, 10, 12)
    kernels = drawn(1, 2, 4, 3, 5, 5)
    expected = correlate(features, kernels, "direct")
    monkeypatch.setattr(F, "conv2d", watched)
    found = correlate(
        features.contiguous(memory_format=torch.channels_last), kernels.mT.contiguous().mT, "direct"
    )
    assert contiguous == [True, True]
    assert torch.equal(found, expected)


@given(st.floats(8, 22), st.floats(8, 14), angles, st.integers(1, 9), seeds)
def test_the_upright_crop_of_a_turned_picture_is_the_turned_crop(u, v, angle, size, seed):
    slope_u, slope_v, level = drawn(seed, 3, dtype=torch.float64).tolist()
    down, right = torch.meshgrid(
        torch.arange(24, dtype=torch.float64), torch.arange(32, dtype=torch.float64), indexing="ij"
    )
    c, s = math.cos(angle), math.sin(angle)
    # A plane is bilinear, so sampling it is exact; turned about (u, v), from u towards v, it is a plane again.
    picture = level + slope_u * (right - u) + slope_v * (down - v)
    turned = level + (c * slope_u - s * slope_v) * (right - u) + (s * slope_u + c * slope_v) * (down - v)
    centre = torch.tensor([[u, v]], dtype=torch.float64)
    found = rotated_crops(turned[None, None], centre, UPRIGHT, size)
    expected = rotated_crops(picture[None, None], centre, torch.tensor([angle], dtype=torch.float64), size)
    assert torch.allclose(found, expected, atol=1e-9)


@pytest.mark.parametrize("size", [3, 6, 7, 14])
def test_quarter_turns_of_any_picture(size):
    features = drawn(0, 2, 3, 11, 11)
    centre = torch.full((2, 2), 5.0)
    quarters = torch.arange(4) * (math.pi / 2)
    crops = rotated_crops(features, centre, quarters, size)
    for turn in range(4):
        # Of an array, `rot90` turns from columns to rows backwards: v towards u.
        turned = rotated_crops(features.rot90(-turn, dims=(2, 3)), centre, UPRIGHT, size)
        assert torch.allclose(crops[:, turn], turned[:, 0], atol=1e-4)


@given(st.integers(0, 11), st.integers(0, 9), st.integers(1, 8), seeds)
def test_an_upright_crop_about_a_pixel_is_a_slice_with_zeros_around(u, v, size, seed):
    features = drawn(seed, 1, 2, 10, 12)
    crop = rotated_crops(features, torch.tensor([[u, v]]), UPRIGHT, size)[0, 0]
    padded = F.pad(features[0], (8, 8, 8, 8))
    top, left = v + 8 - size // 2, u + 8 - size // 2
    assert torch.allclose(crop, padded[:, top : top + size, left : left + size], atol=1e-4)


def test_gradients_of_the_crops():
    features = drawn(0, 2, 2, 6, 7, dtype=torch.float64).requires_grad_()
    centres = torch.tensor([[3.3, 2.6], [0.4, 5.1]], dtype=torch.float64, requires_grad=True)
    turns = torch.tensor([0.3, -2.0], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda f, c, a: rotated_crops(f, c, a, 4), (features, centres, turns))


@pytest.mark.parametrize("method", METHODS)
@settings(deadline=None, max_examples=30)
@given(st.integers(0, 11), st.integers(-3, 3), st.integers(-3, 3))
def test_what_was_picked_is_found_where_it_lies_turned(method, turn, right, down):
    angles = torch.arange(12) * (math.pi / 6)
    picked = arrow(20, 20, 0.0)
    crops = rotated_crops(picked, torch.tensor([[20.0, 20.0]]), angles, 17)
    scores = correlate(arrow(20 + right, 20 + down, angles[turn].item()), crops, method)
    best = int(scores.argmax())
    assert (best // 41**2, best % 41, best // 41 % 41) == (turn, 20 + right, 20 + down)


def arrow(u: float, v: float, angle: float) -> torch.Tensor:
    """Three blobs without any symmetry about (u, v), turned by `angle`: `(1, 3, 41, 41)`, a channel each."""
    offsets = torch.tensor([[5.0, 0.0], [1.0, 3.0], [-4.0, -1.0]])
    c, s = math.cos(angle), math.sin(angle)
    at = offsets @ torch.tensor([[c, s], [-s, c]]) + torch.tensor([u, v])
    along = torch.arange(41.0)
    down, right = ((along - at[:, axis, None]) ** 2 for axis in (1, 0))
    return torch.exp(-(down[:, :, None] + right[:, None, :]) / 4)[None]


@pytest.mark.parametrize(
    ("features", "kernels"),
    [((2, 3, 8, 8), (1, 4, 3, 5, 5)), ((2, 3, 8, 8), (2, 4, 2, 5, 5)), ((2, 3, 8, 8), (2, 4, 3, 5, 4))],
)
def test_kernels_that_do_not_fit(features, kernels):
    with pytest.raises(ValueError, match="square kernels"):
        correlate(torch.zeros(features), torch.zeros(kernels))


@pytest.mark.parametrize(
    ("centres", "turns", "size"),
    [((1, 2), (3,), 5), ((2, 3), (3,), 5), ((2, 2), (3, 1), 5), ((2, 2), (3,), 0)],
)
def test_crops_that_cannot_be_cut(centres, turns, size):
    with pytest.raises(ValueError, match="expected features"):
        rotated_crops(torch.zeros(2, 3, 8, 8), torch.zeros(centres), torch.zeros(turns), size)
