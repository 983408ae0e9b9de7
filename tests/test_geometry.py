import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from baggie.geometry import (
    PlanarPose,
    Rectangle,
    apply_homography,
    hand_matrix,
    invert_transform,
    is_rigid,
    nearest_angle,
    wrap_angle,
)

poses = st.builds(PlanarPose, st.floats(-2, 2), st.floats(-2, 2), st.floats(-math.pi, math.pi))
IDENTITY = PlanarPose(0.0, 0.0, 0.0)


def assert_same(a: PlanarPose, b: PlanarPose) -> None:
    np.testing.assert_allclose(a.matrix(), b.matrix(), atol=1e-9)


@given(poses, poses, poses)
def test_planar_poses_are_a_group(a: PlanarPose, b: PlanarPose, c: PlanarPose) -> None:
    assert_same((a @ b) @ c, a @ (b @ c))
    assert_same(a @ IDENTITY, a)
    assert_same(a @ a.inverse(), IDENTITY)
    assert_same(a.inverse() @ a, IDENTITY)


@given(poses, poses)
def test_composition_is_matrix_multiplication(a: PlanarPose, b: PlanarPose) -> None:
    np.testing.assert_allclose((a @ b).matrix(), a.matrix() @ b.matrix(), atol=1e-9)


@given(st.floats(-100, 100), st.sampled_from([math.pi / 2, math.pi, 2 * math.pi]))
def test_wrapped_angles_are_the_same_angle_in_one_period(angle: float, period: float) -> None:
    wrapped = wrap_angle(angle, period)
    assert -period / 2 - 1e-12 <= wrapped <= period / 2 + 1e-12
    turns = (angle - wrapped) / period
    assert turns == pytest.approx(round(turns), abs=1e-9)


@given(st.floats(-100, 100), st.floats(-4, 4))
def test_the_nearest_angle_is_the_same_one_within_half_a_turn(angle: float, to: float) -> None:
    nearest = nearest_angle(angle, to)
    assert abs(nearest - to) <= math.pi + 1e-9
    assert math.remainder(nearest - angle, 2 * math.pi) == pytest.approx(0.0, abs=1e-9)
    assert nearest == angle or abs(angle - to) >= math.pi
    assert abs(nearest_angle(1e300, to) - to) <= math.pi + 1e-9


def test_half_a_turn_is_said_one_way() -> None:
    assert nearest_angle(-math.pi, 0.0) == nearest_angle(3 * math.pi, 0.0) == math.pi


@given(st.integers(0, 2**31))
def test_homographies_invert(seed: int) -> None:
    rng = np.random.default_rng(seed)
    matrix = np.eye(3) + rng.uniform(-0.2, 0.2, (3, 3)) * [[1, 1, 1], [1, 1, 1], [0.5, 0.5, 0.5]]
    points = rng.uniform(-0.5, 0.5, (8, 2))
    there = apply_homography(matrix, points)
    np.testing.assert_allclose(apply_homography(np.linalg.inv(matrix), there), points, atol=1e-8)


def test_a_transform_times_its_inverse_is_the_identity() -> None:
    angle = 0.7
    transform = np.eye(4)
    transform[:2, :2] = [[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]]
    transform[:3, 3] = [1.0, -2.0, 0.5]
    np.testing.assert_allclose(transform @ invert_transform(transform), np.eye(4), atol=1e-12)


@given(st.integers(0, 2**31), st.floats(0, 0.1))
def test_samples_lie_inside_by_the_margin(seed: int, margin: float) -> None:
    area = Rectangle(0.3, 0.7, -0.3, 0.3)
    x, y = area.sample(np.random.default_rng(seed), margin)
    assert area.contains(x, y, margin - 1e-9)


@given(poses, st.floats(-1e-3, 1e-3))
def test_a_transform_is_rigid_as_far_as_its_digits_say(pose: PlanarPose, error: float) -> None:
    T = hand_matrix(pose.at_height(0.1))
    assert is_rigid(T, 1e-9)
    T[0, 0] += error
    off = np.abs(T[:3, :3] @ T[:3, :3].T - np.eye(3)).max()
    assert is_rigid(T, off * 1.01 + 1e-12)
    assert off < 1e-9 or not is_rigid(T, off * 0.99)
    assert not is_rigid(np.diag([1.0, 1.0, -1.0, 1.0]), 1e-3)  # a mirror
    assert not is_rigid(np.eye(3), 1e-3)
    T[3, 0] = 0.1
    assert not is_rigid(T, 1.0)
