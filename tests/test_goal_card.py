"""A card is found to a small part of a pixel, in any light and beside anything; its colour is that of most of it."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from baggie.calibration.files import CameraIdentity
from baggie.calibration.image_to_robot.map import ImageToRobot
from baggie.calibration.image_to_robot.rectify import raise_card
from baggie.errors import BaggieError, CalibrationError
from baggie.geometry import PlanarPose
from baggie.options.values import CARD_COLOR
from baggie.types import Goal
from baggie.vision.draw import paint_goal
from baggie.vision.goal_card import find_card, measure_color
from helpers.synthetic import intrinsics, to_pixels

WOOD, RED, GREEN_BAG = (150, 112, 78), (190, 40, 35), (60, 150, 40)
SIZE = (640, 360)


def table(color=WOOD):
    return np.full((SIZE[1], SIZE[0], 3), color, np.uint8)


def ring(points, center, yaw=0.0):
    c, s = np.cos(yaw), np.sin(yaw)
    return np.asarray(points, float) @ np.array([[c, s], [-s, c]]) + center


def square(center, yaw=0.0, side=56.0, ratio=1.0):
    return ring(np.array([[1, ratio], [-1, ratio], [-1, -ratio], [1, -ratio]]) * side / 2, center, yaw)


def disk(center, radius):
    angle = np.linspace(0, 2 * np.pi, 90, endpoint=False)
    return ring(radius * np.c_[np.cos(angle), np.sin(angle)], center)


def pillow(center, side=60.0):
    """A bag's outline: sides that bulge, round corners."""
    angle = np.linspace(0, 2 * np.pi, 90, endpoint=False)
    c, s = np.cos(angle), np.sin(angle)
    return ring(side / 2 * (np.abs(c) ** 3 + np.abs(s) ** 3)[:, None] ** (-1 / 3) * np.c_[c, s], center, 0.4)


def draw(image, *shapes):
    for corners, color in shapes:
        image = paint_goal(image, Goal(corners, "solid", color))
    return image


def in_light(image, light=(1.0, 1.0, 1.0), seed=0):
    """With another exposure of each channel, and noise."""
    noise = np.random.default_rng(seed).normal(0, 2, image.shape)
    return np.clip(image * np.array(light) + noise, 0, 255).astype(np.uint8)


def worst_corner(found, corners):
    """Pixels from each true corner to the nearest found one, the greatest."""
    return np.linalg.norm(found.corners[:, None] - corners, axis=2).min(axis=0).max()


@settings(max_examples=30, deadline=None)
@given(
    st.tuples(st.floats(70, 570), st.floats(70, 290)),
    st.floats(-np.pi, np.pi),
    st.floats(40, 90),
    st.tuples(st.floats(0.6, 1.3), *3 * [st.floats(0.86, 1.14)]).map(lambda lit: lit[0] * np.array(lit[1:])),
    st.sampled_from([WOOD, (120, 120, 118), (190, 180, 160)]),
)
def test_center_and_corners_are_sub_pixel_in_any_light(center, yaw, side, light, ground):
    corners = square(center, yaw, side)
    found = find_card(in_light(draw(table(ground), (corners, CARD_COLOR)), light))
    assert found is not None
    assert np.linalg.norm(found.corners.mean(axis=0) - center) < 0.2
    assert worst_corner(found, corners) < 0.35
    assert np.allclose(found.color, np.array(CARD_COLOR) * light, atol=3)


def test_a_bag_that_covers_a_corner_or_lies_right_beside_it_spoils_nothing():
    corners = square((300, 180), 0.2, 70)
    for bag in (square((300, 222), 0.2, 28), square((343, 208), 0.5, 34)):
        found = find_card(in_light(draw(table(), (corners, CARD_COLOR), (bag, RED))))
        assert found is not None
        assert worst_corner(found, corners) < 0.6
        assert np.allclose(found.color, CARD_COLOR, atol=4)


def test_the_card_is_told_from_other_green_things():
    corners = square((450, 120), 0.3, 60)
    leaf = ring([[-60, 0], [0, 14], [60, 0], [0, -14]], (120, 300), 0.3)
    clutter = [(disk((150, 120), 45), CARD_COLOR), (pillow((300, 240), 70), GREEN_BAG), (leaf, (40, 130, 30))]
    found = find_card(in_light(draw(table(), (corners, CARD_COLOR), *clutter)))
    assert found is not None
    assert worst_corner(found, corners) < 0.4
    assert find_card(in_light(draw(table(), *clutter))) is None
    strip = (square((300, 180), 0.1, 120, ratio=0.2), CARD_COLOR)
    speck = (square((500, 180), 0.1, 6), CARD_COLOR)
    checks = [(square((80 + 12 * i, 80 + 12 * j), 0.0, 12), (26, 140, 51) if (i + j) % 2 else (60, 60, 120))
              for i in range(5) for j in range(5)]  # fmt: skip
    assert find_card(in_light(draw(table(), strip, speck, *checks))) is None
    assert find_card(in_light(table())) is None


def test_the_same_card_in_a_picture_twice_the_size_is_found_at_the_same_place():
    corners = square((301.3, 170.6), 0.35, 60)
    large = paint_goal(np.full((720, 1280, 3), WOOD, np.uint8), Goal(corners, color=CARD_COLOR).scaled(2, 2))
    small, twice = find_card(draw(table(), (corners, CARD_COLOR))), find_card(large)
    assert small is not None
    assert twice is not None
    back = Goal(twice.corners).scaled(0.5, 0.5).corners
    assert np.abs(back.mean(axis=0) - small.corners.mean(axis=0)).max() < 0.1


def test_any_colour_with_a_hue_will_do_and_grey_will_not():
    blue = (30, 60, 190)
    image = draw(table(), (square((300, 180)), blue), (square((450, 180)), CARD_COLOR))
    found = find_card(image, blue)
    assert found is not None
    assert np.allclose(found.corners.mean(axis=0), [300, 180], atol=0.2)
    with pytest.raises(BaggieError, match="grey"):
        find_card(image, (120, 121, 119))


@settings(max_examples=20, deadline=None)
@given(st.floats(0.0, 0.45), st.integers(0, 255), st.integers(1, 3), st.integers(0, 2**16))
def test_measured_colour_is_that_of_most_of_the_card(covered, shade, pictures, seed):
    corners = np.array([[100.0, 100], [200, 100], [200, 200], [100, 200]])
    over = np.array([[80.0, 80], [100 + 100 * covered, 80], [100 + 100 * covered, 220], [80, 220]])
    image = draw(table(), (corners, CARD_COLOR), (over, (shade, shade, shade)))
    seen = [in_light(image, seed=seed + k) for k in range(pictures)]
    assert np.abs(np.array(measure_color(seen, corners)) - CARD_COLOR).max() <= 4


def test_what_cannot_be_measured_is_told():
    corners = square((300, 180))
    with pytest.raises(BaggieError, match="at least one picture"):
        measure_color([], corners)
    with pytest.raises(BaggieError, match="inside the picture"):
        measure_color([table()], corners + np.array([400, 0]))
    with pytest.raises(BaggieError, match="inside the picture"):
        measure_color([table()], corners * np.nan)


def fitted_map(heights):
    """The drawn camera's map, from points the robot could have been at."""
    x, y, z = np.meshgrid(np.linspace(0.3, 0.7, 5), np.linspace(-0.3, 0.3, 5), heights)
    robot = np.c_[x.ravel(), y.ravel(), z.ravel()]
    camera = CameraIdentity("drawn", 1280, 720)
    return ImageToRobot.fit(
        to_pixels(robot), robot, camera, intrinsics=intrinsics() if len(heights) > 1 else None
    )


@settings(max_examples=15, deadline=None)
@given(st.floats(0.35, 0.65), st.floats(-0.28, 0.28), st.floats(-np.pi, np.pi), st.floats(0.0, 0.05))
def test_raised_corners_are_where_the_same_square_is_seen_higher_up(x, y, yaw, height):
    to_robot = fitted_map((0.07, 0.17))
    flat = ring(np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * 0.065, PlanarPose(x, y).xy, yaw)
    on_table, higher = (to_pixels(np.c_[flat, np.full(4, z)]) for z in (0.0, height))
    raised = raise_card(on_table, to_robot, height)
    assert np.abs(raised - higher).max() < 0.05
    assert np.abs(raise_card(on_table, to_robot, 0.0) - on_table).max() < 1e-6


def test_a_map_of_one_height_cannot_raise_a_card():
    with pytest.raises(CalibrationError, match="one height only"):
        raise_card(square((640, 360)), fitted_map((0.015,)), 0.015)


@pytest.mark.parametrize("number", [1, 4])
def test_a_card_in_the_simulator_is_found_where_it_truly_is(number):
    from baggie.workcell.simulated import open_simulated

    cell = open_simulated(number)
    rng = np.random.default_rng(number)
    try:
        cell.reset((0xCA4D, number))
        for _ in range(4):
            x, y = cell.settings.workspace.sample(rng, 0.03)
            pose = PlanarPose(float(x), float(y), float(rng.uniform(-np.pi, np.pi)))
            if pose.distance(cell.truth()) < 0.2:
                continue
            cell.lay_card(pose)
            found = find_card(cell.look().color)
            assert found is not None
            flat = ring(np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * 0.065, pose.xy, pose.yaw)
            corners = cell.world.cell.project(np.c_[flat, np.full(4, 0.001)])
            assert np.linalg.norm(found.corners.mean(axis=0) - corners.mean(axis=0)) < 0.3
            assert worst_corner(found, corners) < 0.8
    finally:
        cell.close()
