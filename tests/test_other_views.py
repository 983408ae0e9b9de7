"""Maps as other cameras and lamps would show them: what stays, what may change, and which way."""

import math

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from baggie.geometry import Grid
from baggie.learning.demonstrations import Demonstrations
from baggie.learning.moved_maps import Light, MovedMaps, Moves, with_gaps_closed, with_shadow

PIXEL_M = 0.003125
GRAY, RED = (120, 120, 120), (200, 30, 30)


def two_blocks(gap_px: int) -> tuple[np.ndarray, np.ndarray]:
    """Red, 4 cm high, side by side along u with so many pixels of table between."""
    height = np.zeros((60, 80), np.float32)
    height[20:33, 20:33] = height[20:33, 33 + gap_px : 46 + gap_px] = 0.04
    color = np.full((60, 80, 3), GRAY, np.uint8)
    color[height > 0] = RED
    return color, height


@given(st.integers(1, 6), st.sampled_from([3, 5]))
def test_gaps_that_are_narrower_are_closed_and_nothing_else_changes(gap, size):
    color, height = two_blocks(gap)
    closed_color, closed = with_gaps_closed(color, height, size)
    between = np.zeros_like(height, bool)
    between[20:33, 33 : 33 + gap] = True
    assert (closed[between] == np.float32(0.04 if gap < size else 0.0)).all()
    assert (closed_color[between] == (RED if gap < size else GRAY)).all()
    assert (closed[~between] == height[~between]).all()
    assert (closed_color[~between] == color[~between]).all()


@pytest.mark.parametrize(("pixel_m", "closes"), [(0.003125, True), (0.01, False)])
def test_what_is_wide_enough_to_look_into_stays_open_whatever_the_size_of_pixels(pixel_m, closes):
    """Gaps of 3 pixels are scarcely 1 cm wide, or 3 cm: a hole for something."""
    color, height = two_blocks(3)
    grid = Grid(x=(0, 80 * pixel_m), y=(0, 60 * pixel_m), pixel_m=pixel_m)
    (pick, place), still = grid.to_robot([[26, 26], [42, 26]]), Moves(share=0.0)
    poses = np.array([[*pick, 0, *place, 0]])
    maps = MovedMaps(Demonstrations(color[None], height[None], poses, np.ones(1, int), grid), still)
    drawn = [maps.draw(np.random.default_rng(seed), [0])[0].height for seed in range(20)]
    assert any((seen != height).any() for seen in drawn) == closes


@given(st.integers(0, 1000), st.sampled_from([(40, 64), (157, 331), (61, 43)]))
def test_a_closed_gap_looks_like_the_highest_thing_beside_it_whatever_the_size_of_the_map(seed, shape):
    rng = np.random.default_rng(seed)
    height = np.zeros(shape, np.float32)
    for v, u in rng.integers(0, np.array(shape) - 9, (20, 2)):
        height[v : v + 8, u : u + 8] = rng.uniform(0.02, 0.25)
    color = np.repeat(np.round(height * 1000)[..., None], 3, axis=2).astype(
        np.uint8
    )  # which tells the height
    closed_color, closed = with_gaps_closed(color, height, 5)
    highest = cv2.dilate(color, np.ones((5, 5), np.uint8))
    gaps = closed > height
    assert (closed_color[gaps] == highest[gaps]).all()
    assert (closed_color[~gaps] == color[~gaps]).all()


def test_what_is_flat_keeps_every_mark():
    rng = np.random.default_rng(0)
    color = rng.integers(0, 255, (40, 40, 3), dtype=np.uint8)
    height = rng.normal(0, 0.001, (40, 40)).astype(np.float32)
    closed_color, closed = with_gaps_closed(color, height, 5)
    assert (closed_color == color).all()
    assert (closed == height).all()
    assert (with_shadow(color, np.zeros_like(height), Light(0.3, 1.0, 0.5), PIXEL_M) == color).all()


@pytest.mark.parametrize("quarters", range(4))
def test_a_shadow_falls_away_from_the_light_as_far_as_it_rises(quarters):
    height = np.zeros((61, 61), np.float32)
    height[26:35, 26:35] = 0.02
    color = np.full((61, 61, 3), 200, np.uint8)
    light = Light(quarters * math.pi / 2, 1.0, 0.5)
    dark = with_shadow(color, height, light, PIXEL_M)[..., 0] < 150
    assert not dark[27:34, 27:34].any()  # its own top is in the light
    v, u = np.nonzero(dark)
    along = np.array([math.cos(light.way), math.sin(light.way)])
    from_middle = np.column_stack([u, v]) - 30
    assert (from_middle @ along < -4).all()
    assert (from_middle @ along).min() == pytest.approx(-4 - 0.02 / PIXEL_M, abs=1.5)
    assert np.abs(from_middle @ [-along[1], along[0]]).max() <= 5


@given(st.integers(0, 1000))
def test_a_shadow_only_darkens(seed):
    color, height = two_blocks(4)
    light = Light.random(np.random.default_rng(seed))
    shaded = with_shadow(color, height, light, PIXEL_M)
    assert (shaded <= color).all()
    assert (shaded.astype(float) >= (1 - light.dark) * color - 1).all()
