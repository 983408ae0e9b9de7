import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from baggie.errors import BaggieError
from baggie.geometry import apply_homography
from baggie.learning.augmentation import random_warp
from baggie.types import Goal
from baggie.vision.draw import check_goal, paint_goal, region_mask, without_card

GREY = np.full((180, 320, 3), 90, np.uint8)
SQUARE = np.array([[100.3, 60.2], [150.3, 64.2], [146.3, 114.2], [96.3, 110.2]])


def area(corners):
    u, v = corners.T
    return abs(u @ np.roll(v, -1) - v @ np.roll(u, -1)) / 2


def test_solid_goal_covers_its_area_in_its_color_and_nothing_else():
    painted = paint_goal(GREY, Goal(SQUARE, "solid", (10, 200, 30)))
    changed = (painted != GREY).any(axis=2)
    assert tuple(painted[87, 123]) == (10, 200, 30)
    assert changed.sum() == pytest.approx(area(SQUARE), rel=0.1)
    assert region_mask(SQUARE, (320, 180)).sum() / 255 == pytest.approx(area(SQUARE), rel=0.01)
    assert not changed[:55].any()
    assert not changed[:, 160:].any()


def test_outline_leaves_the_inside_visible_and_scales_with_the_picture():
    goal = Goal(SQUARE, "outline", (255, 0, 0))
    painted = paint_goal(GREY, goal)
    assert tuple(painted[87, 123]) == (90, 90, 90)
    large = paint_goal(cv2.resize(GREY, (1280, 720)), goal.scaled(4, 4))
    share = [(p[..., 0] > 172).mean() for p in (painted, large)]
    assert share[0] == pytest.approx(share[1], rel=0.1)
    assert share[1] > 0


def test_painting_leaves_the_picture_given_alone():
    before = GREY.copy()
    paint_goal(GREY, Goal(SQUARE))
    assert np.array_equal(GREY, before)


@given(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5))
def test_drawn_to_a_fraction_of_a_pixel(du, dv):
    mask = region_mask(SQUARE + np.array([du, dv]), (320, 180)).astype(float)
    v, u = np.mgrid[:180, :320]
    centroid = np.array([(mask * u).sum(), (mask * v).sum()]) / mask.sum()
    assert np.abs(centroid - (SQUARE + np.array([du, dv])).mean(axis=0)).max() < 0.08


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 10**6), st.sampled_from(["solid", "outline"]))
def test_painting_then_warping_is_warping_then_painting(seed, style):
    warp = random_warp(np.random.default_rng(seed), (320, 180), SQUARE)
    goal = Goal(SQUARE, style, (0, 250, 0))
    first = cv2.warpPerspective(paint_goal(GREY, goal), warp, (320, 180), borderMode=cv2.BORDER_REPLICATE)
    second = paint_goal(GREY, Goal(apply_homography(warp, SQUARE), style, (0, 250, 0)))
    differs = np.abs(first.astype(int) - second).max(axis=2)
    # An edge or line may be wider by the warp's scale and softer by its resampling, but nowhere else.
    border = np.zeros((180, 320), np.uint8)
    cv2.polylines(border, [apply_homography(warp, SQUARE).round().astype(np.int32)], True, 1, 8)
    assert differs[border == 0].max() <= 1


@pytest.mark.parametrize(
    "corners",
    [
        SQUARE + np.array([220, 0]),
        SQUARE - np.array([120, 0]),
        SQUARE + np.array([0, 500]),
        SQUARE * np.nan,
        SQUARE[:2],
        SQUARE[0],
    ],
)
def test_goal_outside_the_picture_is_one_clear_line(corners):
    for refuse in (lambda g: paint_goal(GREY, g), lambda g: check_goal(g, (320, 180))):
        with pytest.raises(BaggieError, match="goal") as error:
            refuse(Goal(corners))
        assert "\n" not in str(error.value)


def test_goal_in_the_very_corner_is_inside():
    check_goal(Goal(np.array([[-0.5, -0.5], [319.5, -0.5], [319.5, 179.5]])), (320, 180))


def test_a_card_taken_out_leaves_the_table_and_touches_nothing_else():
    rng = np.random.default_rng(0)
    slope = np.linspace(90, 160, 120)[None, :, None] + np.linspace(0, 20, 80)[:, None, None]
    table = np.clip(slope + rng.normal(0, 2, (80, 120, 3)), 0, 255).astype(np.uint8)
    corners = np.array([[40.0, 30.0], [70.0, 26.0], [74.0, 52.0], [43.0, 55.0]])
    with_card = paint_goal(table, Goal(corners, "solid", (20, 110, 40)))
    taken_out = without_card(with_card, corners)
    near = region_mask(corners, (120, 80)) > 0
    assert np.abs(taken_out.astype(float) - table)[near].max() < 20  # the card is 100 away in red and blue
    far = cv2.dilate(near.astype(np.uint8), np.ones((11, 11))) == 0
    assert (taken_out == table)[far].all()
    other = paint_goal(table, Goal(corners, "solid", (250, 240, 10)))
    assert (without_card(other, corners) == taken_out).all()
