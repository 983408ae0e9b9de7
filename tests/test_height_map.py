"""Height maps of a table and boxes that are known exactly, as ideal cameras see them."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from baggie.errors import BaggieError
from baggie.geometry import FloatArray, Grid, invert_transform, rigid, transform_points
from baggie.types import Observation
from baggie.vision.height_map import HeightMap, fuse, sees_past
from helpers.ray_caster import Box, look, overhead_pose, pinhole, ravens_poses

RAVENS = Grid()
COARSE = Grid(pixel_m=0.00625)
"""For cameras of half Ravens' resolution."""
SMALL = pinhole(320, 240, 225.0)
BENT = pinhole(320, 240, 225.0, (0.12, -0.08, 0.002, -0.001, 0.01))
RED, BLUE = (200, 40, 40), (30, 60, 220)


def above(x: float = 0.5, y: float = 0.0, z: float = 1.0) -> FloatArray:
    return overhead_pose(x, y, z)


def oblique(x: float, y: float, z: float, tilt_deg: float) -> FloatArray:
    """Looks down and, by the tilt, forward."""
    turn = Rotation.from_euler("y", -tilt_deg, degrees=True).as_matrix()
    return rigid(turn @ above()[:3, :3], [x, y, z])


def pixel_centers(grid: Grid) -> FloatArray:
    """`(rows, columns, 2)` metres, written down anew."""
    x = grid.x[0] + grid.pixel_m * (np.arange(grid.shape[1]) + 0.5)
    y = grid.y[0] + grid.pixel_m * (np.arange(grid.shape[0]) + 0.5)
    return np.stack(np.meshgrid(x, y), axis=-1)


def touched(grid: Grid, box: Box) -> np.ndarray:
    """The pixels that a box reaches into."""
    from_center = np.maximum(
        np.subtract(box.low[:2], pixel_centers(grid)), pixel_centers(grid) - box.high[:2]
    )
    return (from_center < grid.pixel_m / 2).all(axis=-1)


@pytest.fixture(scope="module")
def two_boxes() -> tuple[list[Box], list[Observation]]:
    # Every side ends well inside a pixel of the coarse grid: where one ends on a border, rounding decides.
    boxes = [
        Box((0.3525, -0.2400, 0.0), (0.4285, -0.1400, 0.04), RED),
        Box((0.5490, 0.1535, 0.0), (0.6530, 0.2340, 0.11), BLUE),
    ]
    return boxes, [look(SMALL, pose, boxes) for pose in ravens_poses()]


# The grid


def test_the_grid_of_ravens() -> None:
    assert RAVENS.shape == (320, 160)
    np.testing.assert_allclose(RAVENS.to_robot([[0, 0]]), [[0.2515625, -0.4984375]])  # half a pixel inside
    np.testing.assert_allclose(RAVENS.to_pixels([[0.25, -0.5], [0.75, 0.5]]), [[-0.5, -0.5], [159.5, 319.5]])
    assert RAVENS.to_pixels([[0.6, -0.5]])[0, 0] > RAVENS.to_pixels([[0.5, -0.5]])[0, 0]  # u along x


grids = st.builds(
    lambda x, y, columns, rows, pixel: Grid((x, x + columns * pixel), (y, y + rows * pixel), pixel_m=pixel),
    st.floats(-1, 1),
    st.floats(-1, 1),
    st.integers(1, 400),
    st.integers(1, 400),
    st.floats(0.001, 0.02),
)


@given(grids, st.integers(0, 2**31))
def test_pixels_and_metres_are_each_others_inverse(grid: Grid, seed: int) -> None:
    rng = np.random.default_rng(seed)
    xy, pixels = rng.uniform(-2, 2, (20, 2)), rng.uniform(-50, 500, (20, 2))
    np.testing.assert_allclose(grid.to_robot(grid.to_pixels(xy)), xy, atol=1e-12)
    np.testing.assert_allclose(grid.to_pixels(grid.to_robot(pixels)), pixels, atol=1e-9)


@settings(deadline=None)
@given(grids)
def test_a_grid_has_as_many_pixels_as_it_was_made_of_and_contains_their_centres(grid: Grid) -> None:
    rows, columns = grid.shape
    assert (rows, columns) == tuple(round((b - a) / grid.pixel_m) for a, b in (grid.y, grid.x))
    corners = np.array([[0, 0], [columns - 1, 0], [0, rows - 1], [columns - 1, rows - 1]])
    assert grid.contains(grid.to_robot(corners)).all()
    outside = np.array([[-1, 0], [columns, 0], [0, -1], [0, rows]])
    assert not grid.contains(grid.to_robot(outside)).any()
    np.testing.assert_allclose(pixel_centers(grid)[-1, -1], grid.to_robot(corners[-1:])[0], atol=1e-9)


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        (
            {"x": (0.25, 0.751)},
            r"bounds of x a whole number of 0.003125 m pixels.*160.32 pixels.*end at 0.75$",
        ),
        ({"y": (0.0, 0.001)}, "end at 0.003125"),
        ({"y": (0.5, -0.5)}, "bounds of y from low to high, metres, got 0.5 to -0.5"),
        ({"z": (0.0, 0.0)}, "bounds of z from low"),
        ({"x": (0.0, float("nan"))}, "bounds of x from low"),
        ({"pixel_m": 0.0}, "positive size"),
        ({"pixel_m": float("nan")}, "positive size"),
    ],
)
def test_what_is_no_grid_is_one_line(wrong: dict, says: str) -> None:
    with pytest.raises(BaggieError, match=says) as caught:
        Grid(**wrong)
    assert "\n" not in str(caught.value)


# Where things come out


def test_boxes_end_in_the_pixels_that_their_sides_are_in_and_are_as_high_as_they_are(two_boxes) -> None:
    boxes, observations = two_boxes
    fused = fuse(observations, ravens_poses(), COARSE)
    for box in boxes:
        mask = (fused.color == box.color).all(axis=-1)
        # A pixel in which no point fell is filled from beside it; an edge may miss one here and there.
        expected = touched(COARSE, box)
        assert (mask != expected)[fused.seen].sum() <= 0.02 * expected.sum()
        for axis, along in ((0, 1), (1, 0)):
            found = np.flatnonzero(mask.sum(axis=along) > 3)
            low, high = COARSE.to_pixels([box.low[:2], box.high[:2]])[:, 1 - axis]
            assert abs(found[0] - low) <= 0.5
            assert abs(found[-1] - high) <= 0.5
        inside = expected & np.roll(expected, (1, 1), (0, 1)) & np.roll(expected, (-1, -1), (0, 1))
        assert np.abs(fused.height[inside] - box.high[2]).max() < 1e-3
    free = ~touched(COARSE, boxes[0]) & ~touched(COARSE, boxes[1])
    assert np.abs(fused.height[free & fused.seen]).max() < 1e-3


HEIGHTS = st.floats(0.01, 0.25)


@settings(max_examples=15, deadline=None)
@given(
    st.tuples(st.floats(0.36, 0.6), st.floats(-0.2, 0.15)), st.tuples(HEIGHTS, HEIGHTS), st.floats(-25, 25)
)
def test_an_edge_is_right_to_half_a_pixel_for_any_camera(corner, sizes, tilt) -> None:
    (x, y), (height, side) = corner, sizes
    box = Box((x, y, 0.0), (x + 0.03 + side / 3, y + 0.03 + side / 2, height), BLUE)
    camera, pose = pinhole(400, 400, 300.0), oblique(0.5 + np.tan(np.deg2rad(tilt)), 0.0, 1.0, -tilt)
    grid = Grid((0.25, 0.75), (-0.4, 0.4), (0.0, 0.3), 0.005)
    fused = fuse([look(camera, pose, [box])], [pose], grid)
    blue = (fused.color == BLUE).all(axis=-1) & fused.seen
    v, u = np.nonzero(blue)
    found = np.array([[u.min(), v.min()], [u.max(), v.max()]])
    # Points lie a little apart, so that a sliver of the box in a pixel may go unseen: no more than their distance.
    apart = 1.2 / 300 / grid.pixel_m
    off = (found - grid.to_pixels([box.low[:2], box.high[:2]])) * [[-1], [1]]
    assert off.max() <= 0.5 + 1e-3
    assert off.min() >= -0.5 - apart
    assert fused.height.max() == pytest.approx(height, abs=1e-3)


FINE = 0.064
"""Metres over which the paint below goes once from dark to bright: a grey level is a quarter of a millimetre."""


def position(points: FloatArray) -> FloatArray:
    """Red and green tell x and y, modulo `FINE`."""
    wrapped = np.nan_to_num(points[:, :2]) % FINE
    return np.c_[np.floor(wrapped / FINE * 256), np.full(len(points), 77)]


@pytest.mark.parametrize("camera", [SMALL, BENT], ids=["pinhole", "bent"])
def test_every_colour_is_that_of_a_point_in_its_pixel(camera) -> None:
    # Half a pixel of depth, 3 mm on this table, would move most points into other pixels than their own.
    poses = [*ravens_poses(), above()]
    fused = fuse([look(camera, pose, table=position) for pose in poses], poses, COARSE)
    assert fused.seen.mean() > 0.8
    stated = (fused.color[..., :2] + 0.5) / 256 * FINE
    off = (stated - pixel_centers(COARSE) + FINE / 2) % FINE - FINE / 2
    assert np.abs(off[fused.seen]).max() <= COARSE.pixel_m / 2 + FINE / 512 + 1e-5
    assert np.abs(off[fused.seen].mean(axis=0)).max() < 1e-4


def test_the_highest_surface_gives_height_and_colour_whichever_camera_sees_it() -> None:
    table = Box((0.4, -0.2, 0.0), (0.6, 0.2, 0.02), RED)
    roof = Box((0.4, -0.2, 0.15), (0.6, 0.2, 0.16), BLUE)
    # One camera is under the roof: it sees what the roof hides from above.
    poses = [above(), oblique(0.05, 0.0, 0.12, 75)]
    observations = [look(SMALL, pose, [table, roof]) for pose in poses]
    inside = touched(COARSE, Box((0.41, -0.1, 0.0), (0.59, 0.1, 0.0)))
    under = fuse(observations[1:], poses[1:], replace(COARSE, z=(0.0, 0.14)))
    assert (under.color[inside & under.seen] == RED).all(axis=-1).mean() > 0.9
    for order in ((0, 1), (1, 0)):
        both = fuse([observations[i] for i in order], [poses[i] for i in order], COARSE)
        assert (both.color[inside] == BLUE).all()
        np.testing.assert_allclose(both.height[inside], 0.16, atol=1e-3)


def test_the_order_of_the_cameras_does_not_matter_to_the_bit(two_boxes) -> None:
    _, observations = two_boxes
    # Each camera has a light of its own, and the plane has points of equal height: colours differ, ties are many.
    tinted = [replace(o, color=o.color + np.uint8(9 * i)) for i, o in enumerate(observations)]
    maps = []
    for order in permutations(range(3)):
        maps.append(fuse([tinted[i] for i in order], [ravens_poses()[i] for i in order], COARSE))
    for other in maps[1:]:
        assert_equal(other, maps[0])


def assert_equal(a: HeightMap, b: HeightMap) -> None:
    for name in ("color", "height", "seen"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


def test_moving_the_cameras_and_the_grid_moves_the_map_with_them(two_boxes) -> None:
    _, observations = two_boxes
    shift = np.array([0.25, -0.5, 0.125])
    moved = [rigid(pose[:3, :3], pose[:3, 3] + shift) for pose in ravens_poses()]
    grid = Grid((0.5, 1.0), (-1.0, 0.0), (0.125, 0.405), COARSE.pixel_m)
    here, there = fuse(observations, ravens_poses(), COARSE), fuse(observations, moved, grid)
    assert (
        np.abs(there.height - here.height) > 1e-5
    ).mean() < 0.01  # but for points on the border of two pixels


def test_heights_are_above_the_lower_bound_and_what_is_out_of_bounds_is_dropped() -> None:
    box = Box((0.4, -0.3, 0.0), (0.6, -0.1, 0.2), RED)
    lid = Box((0.4, 0.1, 0.26), (0.6, 0.3, 0.27), BLUE)
    fused = fuse([look(SMALL, above(), [box, lid])], [above()], replace(COARSE, z=(0.05, 0.25)))
    top = (fused.color == RED).all(axis=-1)
    np.testing.assert_array_equal(top, fused.color.any(axis=-1))
    assert top.sum() == pytest.approx(touched(COARSE, box).sum(), rel=0.05)
    assert fused.height[touched(COARSE, box)].max() == pytest.approx(0.15, abs=1e-5)


def test_a_table_at_the_lower_bound_is_seen_whole_although_noise_spreads_it_to_both_sides() -> None:
    observation = look(pinhole(640, 480, 450.0), above())
    noise = np.random.default_rng(0).normal(0, 0.002, (480, 640)).astype(np.float32)
    noisy = replace(observation, depth=observation.depth + noise)
    fused = fuse([noisy], [above()], replace(COARSE, y=(-0.3, 0.3)))
    assert fused.seen.all()
    assert fused.height.min() >= 0
    assert fused.height.max() < 0.01
    sunk = rigid(above()[:3, :3], [0.5, 0.0, 0.98])  # the floor beside a table, say
    assert not fuse([observation], [sunk], COARSE).seen.any()


# Holes

HIGH = pinhole(640, 480, 450.0)
"""Sees every pixel of `TABLE` from 1 m above."""
TABLE = Grid((0.3, 0.7), (-0.3, 0.3), (-0.05, 0.23), 0.004)
WOOD = (120, 110, 90)


def without(observation: Observation, *parts: Box, unknown: float = 0.0) -> Observation:
    """What `HIGH` saw from `above()`, with the depth of these parts of the table unknown."""
    v, u = np.mgrid[:480, :640]
    x, y = 0.5 - (v - 239.5) / 450, (319.5 - u) / 450
    depth = observation.depth.copy()
    for part in parts:
        depth[(x > part.low[0]) & (x < part.high[0]) & (y > part.low[1]) & (y < part.high[1])] = unknown
    return replace(observation, depth=depth)


@pytest.mark.parametrize("unknown", [0.0, np.nan, np.inf, -1.0])
@pytest.mark.filterwarnings("error")
def test_small_holes_are_filled_and_large_ones_keep_their_outline(unknown: float) -> None:
    speck, slit = Box((0.40, 0.1, 0), (0.42, 0.12, 0)), Box((0.5, -0.25, 0), (0.512, -0.05, 0))
    large = Box((0.56, -0.2, 0), (0.66, 0.2, 0))
    whole = look(HIGH, above(), table=WOOD)
    fused = fuse([without(whole, speck, slit, large, unknown=unknown)], [above()], TABLE)
    assert fuse([whole], [above()], TABLE).seen.all()
    for part, width in ((speck, 4), (slit, 2), (large, 24)):
        assert touched(TABLE, part)[~fused.seen].sum() >= width**2
    empty = ~fused.seen & touched(TABLE, large)
    assert not fused.height[empty].any()
    assert not fused.color[empty].any()
    np.testing.assert_allclose(fused.height[~empty], 0.05, atol=1e-5)
    assert (fused.color[~empty] == WOOD).all()


def test_a_hole_takes_height_and_colour_of_one_pixel_near_by() -> None:
    rng = np.random.default_rng(0)
    rough = look(HIGH, above(), table=position)
    rough = replace(rough, depth=rough.depth - rng.uniform(0, 0.004, rough.depth.shape).astype(np.float32))
    specks = [
        Box((x, y, 0), (x + 0.015, y + 0.015, 0))
        for x, y in rng.uniform([0.32, -0.28], [0.66, 0.26], (25, 2))
    ]
    fused = fuse([without(rough, *specks)], [above()], TABLE)
    holes = np.argwhere(~fused.seen)
    assert len(holes) > 100
    for row, column in holes:
        near = np.s_[max(row - 6, 0) : row + 7, max(column - 6, 0) : column + 7]
        same = (fused.color[near] == fused.color[row, column]).all(axis=-1)
        assert (same & (fused.height[near] == fused.height[row, column]) & fused.seen[near]).any()


@pytest.mark.parametrize("tilt", [-20, 20])
@pytest.mark.parametrize("table_z", [0.0, 0.5])
def test_the_floor_that_a_box_hides_does_not_become_box(tilt: float, table_z: float) -> None:
    box = Box((0.4535, -0.0705, 0.0), (0.5305, 0.0705, 0.05), BLUE)
    pose = oblique(0.5 + np.tan(np.deg2rad(tilt)), 0.0, 1.0, -tilt)
    grid = Grid((0.4, 0.6), (-0.1, 0.1), (table_z, table_z + 0.3), 0.004)
    raised = rigid(pose[:3, :3], pose[:3, 3] + [0, 0, table_z])
    fused = fuse([look(HIGH, pose, [box])], [raised], grid)
    expected = touched(grid, box)
    assert (~fused.seen & ~expected).sum() > 60  # the shadow
    assert not fused.height[~expected & ~fused.seen].any()
    assert (fused.color[~expected] == WOOD).all()
    assert (fused.color[expected] == BLUE).all(axis=-1).mean() > 0.97


def test_a_camera_sees_past_points_in_free_space_and_no_others() -> None:
    table = look(HIGH, above())
    free = np.array([[0.5, 0.0, 0.5], [0.6, -0.2, 0.03]])
    not_free = np.array(
        [[0.5, 0.0, 0.0], [0.6, -0.2, 0.005], [0.6, -0.2, -0.1], [5.0, 5.0, 0.5], [0.5, 0.0, 1.5]]
    )
    np.testing.assert_array_equal(
        sees_past(table, above(), np.vstack([free, not_free])), [True] * 2 + [False] * 5
    )
    for unknown in (0.0, np.nan, np.inf):
        blind = replace(table, depth=np.full_like(table.depth, unknown))
        assert not sees_past(blind, above(), free).any()
    assert not sees_past(table, above(), np.array([[0.5, 0.0, 1.5]])).any()


def test_which_pixel_tells_what_a_camera_sees_past_is_right_to_half_a_pixel() -> None:
    # From 90 cm the pixels of `HIGH` are 2 mm apart, and the sides of this box lie half way between two of them.
    observation = look(HIGH, above(), [Box((0.46, -0.04, 0.0), (0.54, 0.04, 0.1))])
    for off, expected in ((0.0408, True), (0.0392, False)):
        points = [0.5, 0.0, 0.1] + off * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
        np.testing.assert_array_equal(sees_past(observation, above(), points), expected)


def test_what_a_bent_lens_would_fold_into_its_picture_is_not_seen_past() -> None:
    lens = pinhole(640, 480, 450.0, (-0.25, 0.0, 0.0, 0.0, 0.0))
    aside = np.array([[0.5, 1.9, 0.001], [0.5, -1.9, 0.001]])
    local = transform_points(invert_transform(above()), aside)
    assert (np.abs(lens.project(local) - [319.5, 239.5]) < [300, 200]).all()  # so says the polynomial
    flat = replace(look(HIGH, above()), intrinsics=lens, depth=np.full((480, 640), 9, np.float32))
    assert not sees_past(flat, above(), aside).any()
    assert sees_past(flat, above(), aside * [1, 0.1, 1]).all()


def test_points_further_apart_than_pixels_neither_widen_a_box_nor_eat_into_it(two_boxes) -> None:
    boxes, observations = two_boxes
    fused = fuse(observations, ravens_poses(), RAVENS)
    assert (~fused.seen).sum() > 5000
    for box in boxes:
        mask, expected = (fused.color == box.color).all(axis=-1), touched(RAVENS, box)
        assert mask[expected].mean() > 0.98
        assert (mask & ~expected).sum() < 0.01 * expected.sum()


def test_where_no_camera_knows_anything_the_map_is_empty() -> None:
    blind = look(SMALL, above())
    blind.depth[:] = 0
    fused = fuse([blind], [above()], COARSE)
    assert not fused.seen.any()
    assert not fused.height.any()
    assert not fused.color.any()


# What is refused

GOOD = look(pinhole(32, 24, 22.0), above())


@pytest.mark.parametrize(
    ("observations", "poses", "says"),
    [
        ([replace(GOOD, depth=None)], [above()], "expected depth, got observation 0 without any"),
        ([GOOD, replace(GOOD, intrinsics=None)], [above()] * 2, "expected intrinsics, got observation 1"),
        ([replace(GOOD, depth=GOOD.depth[1:])], [above()], "32 x 24 pixels.* got depth of 32 x 23 and"),
        ([replace(GOOD, intrinsics=SMALL)], [above()], "intrinsics of 320 x 240"),
        ([GOOD], [above()] * 2, "got 2 poses for 1 observations"),
        ([], [], "got 0 poses for 0 observations"),
        ([GOOD], [above() * [[1], [1], [-1], [1]]], "pose 0 to be a rigid transform"),  # mirrored
        ([GOOD], [above() * 1.001], "rigid"),
        ([GOOD], [above()[:3]], "rigid"),
        ([GOOD], [above().T], "rigid"),
        ([GOOD], [above() * np.nan], "rigid"),
    ],
)
def test_what_cannot_be_fused_is_one_line(observations, poses, says) -> None:
    with pytest.raises(BaggieError, match=says) as caught:
        fuse(observations, poses)
    assert "\n" not in str(caught.value)
