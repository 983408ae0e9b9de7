import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from baggie.geometry import PlanarPose, apply_homography
from baggie.learning.augmentation import (
    WarpRange,
    object_mask,
    random_light,
    random_warp,
    stands_alone,
)
from baggie.policies.planning import View
from helpers.synthetic import BAG_SIDE_M, COLORS, Lying, box_corners, observe_bags

SIZE = (160, 96)
POINTS = np.array([[40.0, 30.0], [120.0, 70.0]])


@given(st.integers(0, 10**6))
def test_points_stay_in_the_picture(seed):
    moved = apply_homography(random_warp(np.random.default_rng(seed), SIZE, POINTS), POINTS)
    margin = WarpRange().margin * max(SIZE) - 1e-6
    assert (moved >= margin).all()
    assert (moved <= np.array(SIZE) - 1 - margin).all()


@given(st.integers(0, 10**6), st.floats(0, 159), st.floats(0, 95))
def test_warps_invert(seed, u, v):
    warp = random_warp(np.random.default_rng(seed), SIZE, POINTS)
    there = apply_homography(warp, [[u, v]])
    assert np.allclose(apply_homography(np.linalg.inv(warp), there), [[u, v]], atol=1e-6)
    assert np.linalg.det(warp) > 0  # nothing is mirrored


def test_warps_vary_and_are_repeated_by_seed():
    one, same, other = (random_warp(np.random.default_rng(seed), SIZE, POINTS) for seed in (1, 1, 2))
    assert np.array_equal(one, same)
    assert not np.allclose(one, other)


def test_points_that_fit_nowhere_leave_the_picture_alone():
    spread = np.array([[0.0, 0.0], [159.0, 95.0]])
    assert np.array_equal(random_warp(np.random.default_rng(0), SIZE, spread), np.eye(3))


@given(st.integers(0, 10**6))
def test_light_keeps_the_order_of_brightness(seed):
    table = random_light(np.random.default_rng(seed)).astype(int)
    assert table.shape == (256, 3)
    assert (np.diff(table, axis=0) >= 0).all()


def test_no_light_change_at_strength_zero():
    table = random_light(np.random.default_rng(0), strength=0.0)
    assert table == pytest.approx(np.repeat(np.arange(256)[:, None], 3, axis=1))


@pytest.mark.parametrize(("gap_m", "alone"), [(0.002, False), (0.01, False), (0.07, True)])
def test_an_object_right_beside_another_does_not_stand_alone_in_any_light(gap_m: float, alone: bool):
    poses = [PlanarPose(0.5, 0.0, 0.2), PlanarPose(0.5, BAG_SIDE_M + gap_m, 0.2)]
    view = View.around(np.concatenate([box_corners(pose, (640, 360)) for pose in poses]), (640, 360))
    for seed, color in enumerate(COLORS[1:]):
        rng = np.random.default_rng(seed)
        bags = [Lying(poses[0], 0), Lying(poses[1], 0, color)]
        picture = view.cut(observe_bags(bags, rng, (640, 360)).color)
        lit = np.asarray(cv2.LUT(picture, random_light(rng)[:, None]), np.uint8)
        mask = object_mask(lit, view.to_input(box_corners(poses[0], (640, 360))))
        assert stands_alone(lit, mask) == alone
