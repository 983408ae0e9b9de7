"""Angles as phases, soft targets, and the place and angle that are read from scores."""

import math

import pytest
import torch
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from baggie.policies.transporter.scores import (
    PlaceAngle,
    bin_angles,
    cross_entropy,
    expectation,
    log_softmax,
    soft_targets,
)
from baggie.policies.transporter.spatial import best_angle, coefficients, scores

B, N, M, H, W = 2, 5, 3, 4, 6
TURN = 2 * math.pi
SHAPE = (36, 20, 24)
seeds, angles = st.integers(0, 10_000), st.floats(-math.pi, math.pi)
symmetries = st.sampled_from([1, 2, 4])


def drawn(seed: int, *shape: int) -> torch.Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def channels(seed: int) -> tuple[torch.Tensor, torch.Tensor]:
    return drawn(seed, B, N, M, 2), drawn(seed + 1, B, N, M, 2, H, W)


def turned(channels: torch.Tensor, angle: float) -> torch.Tensor:
    """What channels `(B, N, M, 2, ...)` become when the scene turns."""
    cos, sin = channels.unbind(dim=3)
    n = torch.arange(1, N + 1).double().reshape(1, N, *[1] * (cos.dim() - 2))
    c, s = (n * angle).cos(), (n * angle).sin()
    return torch.stack([c * cos - s * sin, s * cos + c * sin], dim=3)


@given(seeds, st.lists(angles, min_size=1, max_size=4))
def test_scores_are_the_sum_over_orders(seed, turns):
    q, k = channels(seed)
    found = scores(coefficients(q, k), torch.tensor(turns, dtype=torch.float64))
    q_complex, k_complex = torch.complex(*q.unbind(3)), torch.complex(*k.unbind(3))
    for r, a in enumerate(turns):
        phase = torch.exp(-1j * a * torch.arange(1, N + 1).double())[None, :, None, None, None]
        expected = (q_complex.conj()[..., None, None] * k_complex * phase).real.sum(dim=(1, 2))
        assert torch.allclose(found[:, r], expected, atol=1e-9)


@given(seeds, angles)
def test_turning_the_whole_scene_changes_no_score(seed, b):
    q, k = channels(seed)
    turns = bin_angles(12).double()
    expected = scores(coefficients(q, k), turns)
    assert torch.allclose(scores(coefficients(turned(q, b), turned(k, b)), turns), expected, atol=1e-9)


@given(seeds, angles)
def test_turning_the_place_shifts_the_scores(seed, b):
    q, k = channels(seed)
    turns = bin_angles(12).double()
    shifted = scores(coefficients(q, turned(k, b)), turns)
    assert torch.allclose(shifted, scores(coefficients(q, k), turns - b), atol=1e-9)
    shifted = scores(coefficients(turned(q, b), k), turns)
    assert torch.allclose(shifted, scores(coefficients(q, k), turns + b), atol=1e-9)


@given(st.sampled_from([2, 3, 4, 5]), angles, st.floats(-5, 5), seeds)
def test_symmetric_objects_excite_only_multiples_of_their_symmetry(symmetry, direction, a, seed):
    sides = direction + torch.arange(symmetry, dtype=torch.float64) * TURN / symmetry
    n = torch.arange(1, N + 1, dtype=torch.float64)
    q = torch.stack([(n * sides[:, None]).cos().sum(0), (n * sides[:, None]).sin().sum(0)], dim=-1)
    excited = q.norm(dim=-1) > 1e-9
    assert excited.tolist() == [order % symmetry == 0 for order in range(1, N + 1)]
    found = coefficients(q[None, :, None], drawn(seed, 1, N, 1, 2, 1, 1))
    here, there = scores(found, torch.tensor([a, a + TURN / symmetry], dtype=torch.float64))[
        0, :, 0, 0
    ].tolist()
    assert here == pytest.approx(there, abs=1e-9)


@settings(deadline=None)
@given(
    st.lists(st.floats(0.01, 1), min_size=1, max_size=8),
    angles,
    st.sampled_from([torch.float32, torch.float64]),
)
def test_the_best_angle_is_found_between_all_grids(weights, angle, dtype):
    n = torch.arange(1, len(weights) + 1)
    peaked = torch.tensor(weights)[:, None] * torch.stack([(n * angle).cos(), (n * angle).sin()], dim=-1)
    found = best_angle(peaked.to(dtype))
    assert -math.pi <= found < math.pi
    assert math.remainder(found.item() - angle, TURN) == pytest.approx(0, abs=1e-4)
    near = best_angle(peaked.to(dtype), angle + torch.tensor([-0.3, 0.04, 0.5]))
    assert math.remainder(near.item() - angle, TURN) == pytest.approx(0, abs=1e-4)


@settings(deadline=None)
@given(seeds)
def test_no_angle_is_clearly_better_than_the_best(seed):
    drawn_coefficients = drawn(seed, 7, 8, 2)
    found = best_angle(drawn_coefficients)
    assert found.shape == (7,)
    n = torch.arange(1, 9)

    def score(a: torch.Tensor) -> torch.Tensor:
        waves = torch.stack([(a[..., None] * n).cos(), (a[..., None] * n).sin()], dim=-1)
        return (waves * drawn_coefficients[:, None]).sum(dim=(-2, -1))

    everywhere = score(torch.linspace(-math.pi, math.pi, 5000, dtype=torch.float64).expand(7, -1))
    best = score(found[:, None])[:, 0]
    assert (best >= everywhere.amax(1) - 0.08 * everywhere.abs().amax(1)).all()
    for step in (-1e-4, 1e-4):  # at the top, not beside it
        assert (score(found[:, None] + step)[:, 0] <= best).all()


def test_without_any_preference_there_is_still_an_angle():
    assert torch.isfinite(best_angle(torch.zeros(3, 4, 2))).all()


def sample(u: float, v: float, angle: float) -> PlaceAngle:
    return PlaceAngle(torch.tensor([[u, v]]), torch.tensor([angle]))


places = st.tuples(st.floats(5, 18), st.floats(5, 14))


@given(
    places,
    angles,
    symmetries,
    st.sampled_from([(0.0, 0.0, 2, 1), (0.8, 0.7, 4, 3)]),
    st.sampled_from([12, 36]),
)
def test_targets_recover_the_truth(place, angle, symmetry, widths, rotations):
    sigma_px, sigma_bins, radius_px, radius_bins = widths
    assume((2 * radius_bins + 1) * symmetry <= rotations)  # or copies of the angle would be averaged
    shape = (rotations, *SHAPE[1:])
    targets = soft_targets(sample(*place, angle), torch.tensor([symmetry]), shape, sigma_px, sigma_bins)
    assert targets.shape == (1, *shape)
    assert targets.min() >= 0
    assert targets.sum().item() == pytest.approx(1, abs=1e-5)
    found = expectation(targets.log(), radius_px, radius_bins)
    assert found.place[0].tolist() == pytest.approx(place, abs=0.1)
    assert -math.pi <= found.angle < math.pi
    assert math.degrees(math.remainder(found.angle.item() - angle, TURN / symmetry)) == pytest.approx(
        0, abs=0.5
    )


@given(places, angles, symmetries, st.just(0.0) | st.floats(0.2, 2))
def test_symmetric_copies_have_equal_weight(place, angle, symmetry, sigma):
    def of(turned_by: float) -> torch.Tensor:
        truth = sample(*place, angle + turned_by)
        return soft_targets(truth, torch.tensor([symmetry]), SHAPE, sigma_bins=sigma)[0].sum(dim=(1, 2))

    along_turn = of(0.0)
    assert torch.allclose(along_turn.view(symmetry, -1), along_turn.view(symmetry, -1)[:1], atol=1e-4)
    for copy in range(symmetry):  # whichever of them is called the true one
        assert torch.allclose(of(copy * TURN / symmetry), along_turn, atol=1e-4)


def test_copies_that_fall_between_bins_have_equal_weight_too():
    targets = soft_targets(sample(10.0, 10.0, 0.0), torch.tensor([4]), (10, 20, 24), sigma_bins=0.3)
    quarters = targets.sum(dim=(2, 3))[0]  # copies at bins 0, 2.5, 5 and 7.5
    assert quarters[[0, 5]].tolist() == pytest.approx([0.25, 0.25], abs=0.01)
    assert quarters[[2, 3, 7, 8]].tolist() == pytest.approx([0.125] * 4, abs=0.01)


def test_samples_of_one_batch_may_differ_in_symmetry():
    truth = PlaceAngle(torch.tensor([[4.0, 5.0]]).repeat(4, 1), torch.full((4,), 0.1))
    symmetry = torch.tensor([0, 1, 2, 4])
    together = soft_targets(truth, symmetry, SHAPE)
    along_turn = together.sum(dim=(2, 3))
    assert torch.allclose(along_turn[0], torch.full((36,), 1 / 36))
    assert (along_turn > 1e-6).sum(dim=1).tolist() == [36, 2, 4, 8]
    for i in range(4):
        alone = soft_targets(
            PlaceAngle(truth.place[i : i + 1], truth.angle[i : i + 1]), symmetry[i : i + 1], SHAPE
        )
        assert torch.allclose(alone[0], together[i])


@pytest.mark.parametrize(("u", "v"), [(-0.5, 7.0), (23.5, 19.5), (0.0, -0.4)])
def test_places_on_the_rim_have_targets(u, v):
    targets = soft_targets(sample(u, v, 1.0), torch.tensor([1]), SHAPE)
    assert targets.sum().item() == pytest.approx(1)
    found = expectation(targets.log())
    assert found.place[0].tolist() == pytest.approx([min(max(u, 0), 23), min(max(v, 0), 19)], abs=0.01)


@given(places, angles, st.floats(-8, 8))
def test_something_alike_elsewhere_does_not_pull(place, angle, lower):
    assume(abs(place[0] - 10) > 4)
    one = soft_targets(sample(*place, angle), torch.tensor([1]), SHAPE)
    other = soft_targets(sample(10.0, 10.0, angle + lower), torch.tensor([1]), SHAPE)
    found = expectation((one + 0.2 * other).log())
    assert found.place[0].tolist() == pytest.approx(place, abs=0.1)


@given(seeds)
def test_the_loss_is_least_where_scores_say_the_target(seed):
    targets = soft_targets(
        PlaceAngle(torch.tensor([[3.2, 2.9], [1.0, 4.5]]), torch.tensor([0.4, 3.0])),
        torch.tensor([1, 2]),
        (8, 6, 7),
    )
    logits = drawn(seed, 2, 8, 6, 7).float()
    log_probability = log_softmax(logits)
    assert log_probability.exp().sum(dim=(1, 2, 3)).tolist() == pytest.approx([1, 1], abs=1e-5)
    loss = cross_entropy(logits, targets)
    assert loss.item() == pytest.approx(-(targets * log_probability).sum().item() / 2, rel=1e-5)
    assert loss > cross_entropy(targets.clamp_min(1e-12).log(), targets)


def test_gradients_of_the_expectation():
    logits = (3 * drawn(0, 1, 7, 6, 8)).requires_grad_()
    assert torch.autograd.gradcheck(lambda x: tuple(expectation(x)), (logits,))


@pytest.mark.parametrize(("u", "v"), [(-0.6, 3.0), (24.0, 3.0), (3.0, 20.0), (math.nan, 3.0)])
def test_places_outside_the_picture(u, v):
    with pytest.raises(ValueError, match="inside a picture of 24 x 20"):
        soft_targets(sample(u, v, 0.0), torch.tensor([1]), SHAPE)


def test_other_bad_input():
    with pytest.raises(ValueError, match="symmetries of 0"):
        soft_targets(sample(3.0, 3.0, 0.0), torch.tensor([-1]), SHAPE)
    with pytest.raises(ValueError, match="places \\(B, 2\\)"):
        soft_targets(sample(3.0, 3.0, 0.0), torch.tensor(1), SHAPE)
    with pytest.raises(ValueError, match="at least 5 rotations"):
        expectation(torch.zeros(1, 4, 6, 6), radius_bins=2)
    with pytest.raises(ValueError, match="expected channels"):
        coefficients(torch.zeros(B, N, M, 2), torch.zeros(B, N, M + 1, 2, H, W))
