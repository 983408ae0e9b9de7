import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from baggie.errors import BaggieError
from baggie.geometry import wrap_angle
from baggie.types import Image
from baggie.vision.color_mask import find_bag
from helpers.fake_workcell import FakeCell, draw_polygon

RED = (190, 40, 35)
WOOD = (150, 110, 75)


def table(color: tuple[int, int, int] = WOOD) -> Image:
    return np.full((360, 640, 3), color, np.uint8)


def square(center: tuple[float, float], yaw: float, side: float = 50.0) -> np.ndarray:
    corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * side / 2
    c, s = np.cos(yaw), np.sin(yaw)
    return corners @ np.array([[c, s], [-s, c]]) + center


@settings(max_examples=25, deadline=None)
@given(
    st.tuples(st.floats(60, 580), st.floats(60, 300)),
    st.floats(-0.7, 0.7),
    st.floats(0.5, 1.2),
    st.integers(0, 2**16),
)
def test_center_and_yaw_of_a_drawn_square_are_sub_pixel_in_any_light(center, yaw, light, seed):
    image = table()
    draw_polygon(image, square(center, yaw), RED)
    noise = np.random.default_rng(seed).normal(0, 2, image.shape)
    image = np.clip(image * light * [1.0, 0.97, 1.04] + noise, 0, 255).astype(np.uint8)
    found = find_bag(image, RED)
    assert found is not None
    assert np.linalg.norm(found.center - center) < 0.35
    assert abs(wrap_angle(found.yaw - yaw, np.pi / 2)) < np.deg2rad(2)
    assert found.confidence > 0.8
    assert found.area_px == found.mask.sum() == pytest.approx(51**2, rel=0.06)  # outlines are drawn inclusive


@given(st.integers(-80, 80), st.integers(-80, 80))
@settings(max_examples=15, deadline=None)
def test_shifting_the_picture_shifts_the_detection(du, dv):
    image = table()
    draw_polygon(image, square((320.3, 180.6), 0.3), RED)
    moved = np.roll(image, (dv, du), axis=(0, 1))
    here, there = find_bag(image, RED), find_bag(moved, RED)
    assert here is not None
    assert there is not None
    assert np.allclose(there.center - here.center, [du, dv], atol=0.2)
    assert abs(wrap_angle(there.yaw - here.yaw, np.pi / 2)) < 0.01


def test_nothing_is_found_on_a_wooden_table_or_a_speck_or_a_long_strip():
    noise = np.random.default_rng(0).normal(0, 4, (360, 640, 3))
    assert find_bag(np.clip(table() + noise, 0, 255).astype(np.uint8), RED) is None
    speck = table()
    cv2.circle(speck, (300, 200), 3, RED, -1)
    assert find_bag(speck, RED) is None
    strip = table()
    cv2.rectangle(strip, (100, 100), (500, 130), RED, -1)
    assert find_bag(strip, RED) is None


def test_the_largest_plausible_blob_wins_over_smaller_and_other_colours():
    image = table()
    draw_polygon(image, square((150, 150), 0.2, side=20), RED)
    draw_polygon(image, square((450, 200), 0.2, side=50), RED)
    draw_polygon(image, square((300, 300), 0.0, side=90), (40, 160, 60))
    found = find_bag(image, RED)
    assert found is not None
    assert np.allclose(found.center, [450, 200], atol=0.5)
    green = find_bag(image, (40, 160, 60))
    assert green is not None
    assert np.allclose(green.center, [300, 300], atol=0.5)


def test_a_bag_cut_off_by_the_edge_is_trusted_less():
    whole, cut = table(), table()
    draw_polygon(whole, square((300, 200), 0.0), RED)
    draw_polygon(cut, square((5, 200), 0.0), RED)
    inside, edge = find_bag(whole, RED), find_bag(cut, RED)
    assert inside is not None
    assert edge is not None
    assert edge.confidence < 0.6 * inside.confidence


def test_a_grey_reference_is_refused():
    with pytest.raises(BaggieError, match="grey"):
        find_bag(table(), (120, 120, 118))


def test_the_bag_of_a_fake_cell_is_found_in_every_scene():
    cell = FakeCell(size=(640, 360))
    for scene in range(5):
        cell.reset((scene,))
        found = find_bag(cell.look().color, cell.settings.object_color)
        assert found is not None
        top = cell.camera.project(np.array([[cell.bag.x, cell.bag.y, 0.015]]))[0]
        assert np.linalg.norm(found.center - top) < 3
