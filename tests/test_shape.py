"""Turned, stretched, larger and round objects: their middle stays, and their labels say what is to be seen."""

import math

import cv2
import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from baggie.learning.augmentation import (
    Shape,
    object_mask,
    randomly_turned,
    reshaped,
    unchanged,
    with_shape,
    without_object,
)
from baggie.policies.keypoint import heads as phase
from baggie.policies.planning import LONG_RATIO
from baggie.vision.color_mask import find_bag

SIDE = 41
MIDDLE = np.array([100.0, 70.0])
TABLE = np.full((140, 200, 3), 150, np.uint8)
PICTURE = TABLE.copy()
PICTURE[50:91, 80:121] = (200, 40, 40)
BOX = np.array([[80, 50], [120, 50], [120, 90], [80, 90]], float)
MASK = object_mask(PICTURE, BOX)
JACOBIAN = np.diag([0.002, -0.002])
angles, seeds = st.floats(-1.5, 1.5), st.integers(0, 1000)


def shown(shape: Shape) -> np.ndarray:
    """Where the object is then, `(H, W)`."""
    picture, _ = with_shape(PICTURE, without_object(PICTURE, MASK), MASK, MIDDLE, shape)
    red = picture.astype(int)
    return red[..., 0] - red[..., 1] > 80


@given(seeds)
def test_its_middle_stays(seed):
    rng = np.random.default_rng(seed)
    shape = reshaped(rng, randomly_turned(rng, unchanged(0.0), JACOBIAN), JACOBIAN, LONG_RATIO)
    v, u = np.nonzero(shown(shape))
    assert [u.mean(), v.mean()] == pytest.approx(MIDDLE, abs=0.5)


@given(angles, angles, seeds)
def test_a_turn_in_the_picture_turns_the_phase_as_far(yaw, angle, seed):
    """Whatever the camera: the phase seen after is the phase seen before, plus that of the turn."""
    rng = np.random.default_rng(seed)
    jacobian = JACOBIAN + rng.normal(0, 2e-4, (2, 2))
    shape = randomly_turned(rng, unchanged(yaw, 2), jacobian)
    angle = math.atan2(shape.linear[1, 0], shape.linear[0, 0])
    before, after = (
        phase.phase_of(torch.tensor(y, dtype=torch.float64), torch.from_numpy(jacobian), phase.LONG).tolist()
        for y in (yaw, shape.yaw)
    )
    off = math.atan2(after[1], after[0]) - math.atan2(before[1], before[0]) - 2 * angle
    assert math.remainder(off, 2 * math.pi) == pytest.approx(0, abs=1e-5)


@given(seeds)
def test_what_is_long_lies_along_its_yaw(seed):
    rng = np.random.default_rng(seed)
    shape = randomly_turned(rng, reshaped(rng, unchanged(0.0), JACOBIAN, LONG_RATIO), JACOBIAN)
    points = np.argwhere(shown(shape))[:, ::-1].astype(np.float32)
    sides = 1 + np.array(cv2.minAreaRect(points)[1])  # between the outermost pixels' centres
    if shape.round_from is not None:
        assert len(points) == pytest.approx(math.pi / 4 * max(sides) * min(sides), rel=0.07)
        assert shape.phases == (0.0, 0.0)
        return
    assert len(points) == pytest.approx(max(sides) * min(sides), rel=0.1)
    ratio = max(sides) / min(sides)
    if abs(ratio - LONG_RATIO) > 0.05:
        assert shape.symmetry == (2 if ratio > LONG_RATIO else 4)
        assert shape.phases == (1.0, float(ratio > LONG_RATIO))
    if ratio > 1.3:
        _, _, axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)
        x, y = JACOBIAN @ axes[0]
        assert math.remainder(math.atan2(y, x) - shape.yaw, math.pi) == pytest.approx(0, abs=0.05)


def test_what_is_long_stays_long_and_is_not_stretched():
    for seed in range(20):
        shape = reshaped(np.random.default_rng(seed), unchanged(0.3, 2), JACOBIAN, LONG_RATIO)
        assert shape.phases == (1.0, 1.0)
        assert shape.linear == pytest.approx(np.eye(2) * shape.linear[0, 0])


def test_nothing_is_left_where_it_was():
    quarter = Shape(0.0, 4, np.array([[0.0, -1.0], [1.0, 0.0]]) * 0.8)
    picture, mask = with_shape(PICTURE, without_object(PICTURE, MASK), MASK, MIDDLE, quarter)
    bag = find_bag(picture, (200, 40, 40))
    assert bag is not None
    assert bag.area_px == pytest.approx((0.8 * SIDE) ** 2, rel=0.1)
    assert mask.sum() == pytest.approx(0.64 * MASK.sum(), rel=0.05)
