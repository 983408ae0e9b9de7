"""The directions of edges around a drawn thing are those of its sides."""

import math

import cv2
import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from baggie.policies.keypoint.heads import AROUND, CHANNELS, STRIDE, edge_phases

SIZE = 96
MIDDLE = SIZE // 2
patient = settings(deadline=None)  # PyTorch warms up in whichever call is the first
WIDE = -4  # the first channel of the widest radius


def drawn(yaw: float, length: float, width: float) -> np.ndarray:
    """A bright rectangle on a dark ground, `(SIZE, SIZE)` in [0, 1], with smooth edges; yaw from u towards v."""
    c, s = math.cos(yaw), math.sin(yaw)
    corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * [length / 2, width / 2]
    corners = 4 * (corners @ np.array([[c, s], [-s, c]]) + MIDDLE) + 1.5
    large = np.zeros((4 * SIZE, 4 * SIZE), np.float32)
    cv2.fillPoly(large, [np.round(corners * 16).astype(np.int32)], 1.0, cv2.LINE_AA, 4)
    return np.asarray(cv2.resize(large, (SIZE, SIZE), interpolation=cv2.INTER_AREA))


def phases(picture: np.ndarray) -> np.ndarray:
    """`(CHANNELS,)` at the middle."""
    image = torch.from_numpy(np.stack([255 * picture] * 3)).float()[None]
    found = edge_phases(image)
    assert found.shape == (1, CHANNELS, SIZE // STRIDE, SIZE // STRIDE)
    middle = found[
        0, :, MIDDLE // STRIDE - 1 : MIDDLE // STRIDE + 1, MIDDLE // STRIDE - 1 : MIDDLE // STRIDE + 1
    ]
    return middle.mean(dim=(1, 2)).numpy()


def off(found: np.ndarray, wanted: float) -> float:
    """The angle between a phase (cos, sin) and the one wanted, radians."""
    return abs(math.remainder(math.atan2(found[1], found[0]) - wanted, 2 * math.pi))


@patient
@given(yaw=st.floats(-math.pi, math.pi), side=st.floats(18, 34))
def test_a_squares_sides_show_in_the_fourth_order(yaw: float, side: float) -> None:
    square = phases(drawn(yaw, side, side))[WIDE : WIDE + 2]
    assert np.hypot(*square) > 0.5
    assert off(square, 4 * yaw) < 0.2


@patient
@given(yaw=st.floats(-math.pi, math.pi))
def test_long_sides_show_in_the_second_order(yaw: float) -> None:
    # The directions are those across the edges: a quarter turn from along the long sides.
    long = phases(drawn(yaw, 36, 14))[WIDE + 2 :]
    assert np.hypot(*long) > 0.2
    assert off(long, 2 * (yaw + math.pi / 2)) < 0.2


def test_a_disc_and_a_plain_table_have_no_direction() -> None:
    v, u = np.mgrid[:SIZE, :SIZE]
    disc = np.clip(14.5 - np.hypot(u - MIDDLE + 0.5, v - MIDDLE + 0.5), 0, 1)
    for picture in (disc, np.full((SIZE, SIZE), 0.4)):
        assert np.abs(phases(picture)[WIDE:]).max() < 0.1


@patient
@given(st.integers(0, 2**32 - 1))
def test_phases_are_no_longer_than_one_and_darker_light_changes_little(seed: int) -> None:
    noise = np.random.default_rng(seed).random((SIZE, SIZE)).astype(np.float32)
    bright, dark = phases(noise), phases(0.7 * noise)
    assert np.hypot(*bright.reshape(-1, 2).T).max() <= 1.0
    np.testing.assert_allclose(bright, dark, atol=0.05)


def test_other_channels_are_not_looked_at_and_no_gradient_passes() -> None:
    image = 255 * torch.rand(2, 4, 32, 32, requires_grad=True)
    other = image.detach().clone()
    other[:, 3] = 0
    found = edge_phases(image)
    assert torch.equal(found, edge_phases(other))
    assert not found.requires_grad
    assert found.shape[1] == 4 * len(AROUND)
