"""One camera's picture from straight above: what lies on the map's plane comes to lie where the robot has it."""

import math
from functools import lru_cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from baggie.calibration.image_to_robot.map import ImageToRobot
from baggie.calibration.image_to_robot.rectify import Leaning, Rectifier
from baggie.errors import BaggieError, CalibrationError
from baggie.geometry import Grid, PlanarPose
from baggie.types import Goal, middle_of_layer_m
from baggie.vision.draw import paint_goal
from helpers.synthetic import BAG_HEIGHT_M, BAG_SIDE_M, box_corners, image_to_robot, to_pixels

SIZE = (640, 360)
GRID = Grid(x=(0.3, 0.7), y=(-0.3, 0.3), pixel_m=0.003125)
"""128 x 192 pixels."""
MAP = image_to_robot()
places = st.tuples(st.floats(0.32, 0.68), st.floats(-0.28, 0.28))
poses = st.builds(PlanarPose, st.floats(0.4, 0.6), st.floats(-0.2, 0.2), st.floats(-math.pi, math.pi))


@lru_cache
def rectifier(size):
    return Rectifier.of(MAP.for_size(size), GRID)


RECTIFIER = rectifier(SIZE)


def seen_at(xy, size=SIZE):
    """Pixels of places `(N, 2)` on the plane of the map."""
    xy = np.reshape(xy, (-1, 2))
    return to_pixels(np.c_[xy, np.full(len(xy), BAG_HEIGHT_M / 2)], size)


@settings(deadline=None)
@given(places)
def test_robot_to_picture_to_grid_and_back(xy):
    there = RECTIFIER.to_grid(seen_at(xy))
    assert there == pytest.approx(GRID.to_pixels(xy), abs=0.01)
    assert RECTIFIER.from_grid(there) == pytest.approx(seen_at(xy), abs=1e-4)
    assert RECTIFIER.contains(seen_at(xy))


@pytest.mark.parametrize("times", [0.5, 1, 2])
@settings(deadline=None, max_examples=20)
@given(places)
def test_what_the_camera_sees_at_a_place_is_in_its_pixel(times, xy):
    """A dot of 16 mm, in pictures coarser, as fine and finer than the grid."""
    size = (round(640 * times), round(360 * times))
    around = 0.008 * np.exp(1j * np.linspace(0, 2 * math.pi, 40, endpoint=False))
    outline = seen_at(np.array(xy) + np.c_[around.real, around.imag], size)
    picture = paint_goal(np.zeros((size[1], size[0], 3), np.uint8), Goal(outline, "solid", (255, 255, 255)))
    light = rectifier(size).observation(picture).color[..., 0].astype(float)
    v, u = np.mgrid[: light.shape[0], : light.shape[1]]
    found = np.array([(u * light).sum(), (v * light).sum()]) / light.sum()
    assert found == pytest.approx(GRID.to_pixels(xy)[0], abs=0.25)
    area_px = light.sum() / 255
    assert area_px == pytest.approx(math.pi * (0.008 / GRID.pixel_m) ** 2, rel=0.15)


def test_fine_patterns_become_grey_rather_than_coarse_ones():
    size = (2560, 1440)
    stripes = np.zeros((size[1], size[0], 3), np.uint8)
    stripes[:, ::2] = 255
    assert rectifier(size).observation(stripes).color.std() < 20  # of 127


@settings(deadline=None)
@given(poses)
def test_a_goal_is_painted_where_the_robot_has_it(pose):
    half = BAG_SIDE_M / 2
    corners = np.array([[-half, -half], [half, -half], [half, half], [-half, half]])
    on_table = (np.c_[corners, np.ones(4)] @ pose.matrix().T)[:, :2]
    blank = np.zeros((*GRID.shape, 3), np.uint8)
    mapped = paint_goal(blank, RECTIFIER.goal(Goal(box_corners(pose, SIZE))))
    drawn = paint_goal(blank, Goal(GRID.to_pixels(on_table)))
    assert np.abs(mapped.astype(int) - drawn).max() <= 10  # of 200, along the edges
    assert mapped.any()


@settings(deadline=None)
@given(places)
def test_what_is_hot_at_a_place_is_hot_where_the_camera_sees_it(xy):
    heat = np.zeros(GRID.shape, np.float32)
    u, v = np.round(GRID.to_pixels(xy)[0]).astype(int)
    heat[v, u] = 0.7
    over = RECTIFIER.over_picture(heat)
    (row,), (column,) = np.nonzero(over)
    scale = np.array(SIZE) / over.shape[::-1]
    assert over[row, column] == np.float32(0.7)
    shown = (np.array([column, row]) + 0.5) * scale - 0.5
    assert (np.abs(shown - RECTIFIER.from_grid(np.array([[u, v]]))[0]) <= scale / 2 + 1e-3).all()


def test_a_warm_grid_has_no_cold_spots_over_the_picture():
    over = RECTIFIER.over_picture(np.ones(GRID.shape, np.float32))
    inside = np.mgrid[0 : over.shape[0], 0 : over.shape[1]].reshape(2, -1).T[:, ::-1]
    scale = np.array(SIZE) / over.shape[::-1]
    there = RECTIFIER.to_grid((inside + 0.5) * scale - 0.5)
    well_inside = ((there > 4) & (there < np.array(GRID.shape[::-1]) - 5)).all(axis=1)
    assert well_inside.sum() > 1000
    assert (over.ravel()[well_inside] == 1).all()


def test_an_object_that_is_pointed_at_is_pointed_at_from_above():
    u, v = seen_at([0.5, 0.1])[0]
    corners = seen_at([[0.4, 0.0], [0.5, 0.0], [0.5, 0.1]])
    goal = RECTIFIER.goal(Goal(corners, object_at=(float(u), float(v))))
    assert goal.object_at == pytest.approx(GRID.to_pixels([0.5, 0.1])[0], abs=0.01)


def test_its_config_gives_the_same_to_the_bit():
    again = Rectifier.from_config(RECTIFIER.config(), SIZE, GRID)
    picture = np.random.default_rng(0).integers(0, 256, (360, 640, 3)).astype(np.uint8)
    assert np.array_equal(again.observation(picture).color, RECTIFIER.observation(picture).color)
    assert again.config() == RECTIFIER.config()
    assert again.leaning is None
    stacked = Rectifier.of(MAP.for_size(SIZE), GRID, Leaning.of(MAP))
    again = Rectifier.from_config(stacked.config(), SIZE, GRID)
    pose = PlanarPose(0.4, 0.1, 0.2)
    assert again.leaning is not None
    assert stacked.leaning is not None
    assert again.leaning.seen(pose, 3) == stacked.leaning.seen(pose, 3)


def test_a_map_that_knows_one_height_only_does_as_well():
    xy = np.stack(np.meshgrid(np.linspace(0.3, 0.7, 4), np.linspace(-0.3, 0.3, 4)), axis=-1).reshape(-1, 2)
    full = (1280, 720)
    points = np.c_[xy, np.full(len(xy), BAG_HEIGHT_M / 2)]
    flat = ImageToRobot.fit(to_pixels(points), points, MAP.camera)
    assert not flat.height_aware
    assert Rectifier.of(flat.for_size(full), GRID).to_grid(seen_at(xy, full)) == pytest.approx(
        GRID.to_pixels(xy), abs=0.5
    )
    with pytest.raises(CalibrationError, match="fitted at one height only"):
        Leaning.of(flat)


LEANING = Leaning.of(MAP)
layers = st.integers(0, 8)


@given(poses, layers)
def test_robot_to_where_a_bag_in_a_layer_appears_and_back(pose, layer):
    seen = LEANING.seen(pose, layer)
    back = LEANING.there(seen, layer)
    assert back.xy == pytest.approx(pose.xy, abs=1e-12)
    assert seen.yaw == back.yaw == pose.yaw


@settings(deadline=None)
@given(poses, st.integers(1, 8))
def test_a_bag_in_a_layer_appears_where_the_camera_sees_it(pose, layer):
    """In the very pixel in which the map, carried to the height of the layer's middle, has it."""
    pixel = MAP.for_size(SIZE).at_height(middle_of_layer_m(layer)).to_pixels(pose.xy)
    assert RECTIFIER.from_grid(GRID.to_pixels(LEANING.seen(pose, layer).xy)) == pytest.approx(pixel, abs=1e-6)


@given(poses, st.integers(1, 8))
def test_it_appears_further_from_the_camera_s_foot_by_its_height(pose, layer):
    """By similar triangles: as its height above the plane to what is left up to the camera, which is 1 m up."""
    foot, up = LEANING.camera[:2], LEANING.camera[2]
    assert LEANING.camera == pytest.approx([0.33, 0.08, 1.0], abs=1e-3)
    higher = middle_of_layer_m(layer) - BAG_HEIGHT_M / 2
    shift = LEANING.seen(pose, layer).xy - pose.xy
    assert shift == pytest.approx((pose.xy - foot) * higher / (up - middle_of_layer_m(layer)), abs=1e-12)
    assert LEANING.seen(pose, 0).xy == pytest.approx(pose.xy, abs=1e-12)


def test_no_layer_is_as_high_as_the_camera():
    LEANING.seen(PlanarPose(0.5, 0.0), 44)
    with pytest.raises(BaggieError, match=r"below the camera, 1\.00 m above the table, got layer 45; .* 44$"):
        LEANING.seen(PlanarPose(0.5, 0.0), 45)
