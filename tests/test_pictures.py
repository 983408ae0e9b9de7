"""Pictures and goals as people have them: the same is seen in all of them, or one line says what is wrong."""

from __future__ import annotations

from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image as Pillow

from baggie.errors import BaggieError
from baggie.pictures import as_outline, as_picture, read_picture
from baggie.types import Goal, Observation
from baggie.vision.draw import region_mask

RNG = np.random.default_rng(0)
COLOR = RNG.integers(0, 256, (12, 20, 3), np.uint8)
GREY = RNG.integers(0, 256, (12, 20), np.uint8)
ALPHA = RNG.integers(0, 256, (12, 20), np.uint8)
SQUARE = np.array([[20.0, 30], [60, 32], [58, 72], [18, 70]])


@pytest.mark.parametrize(
    "form",
    [
        COLOR.tolist(),
        COLOR.astype(int),
        COLOR.astype(np.uint16),
        COLOR.astype(np.uint16) * 257,
        COLOR.astype(">u2") * 257,
        COLOR / 255,
        (COLOR / 255).astype(np.float32),
        COLOR / 255 + 1e-6,
        np.dstack([COLOR, ALPHA]),
        np.asfortranarray(COLOR),
        Pillow.fromarray(COLOR),
        Pillow.fromarray(np.dstack([COLOR, ALPHA]), "RGBA"),
        torch.from_numpy(COLOR),
        torch.from_numpy(COLOR).permute(2, 0, 1) / 255,
    ],
)
def test_the_same_picture_in_any_form(form: Any) -> None:
    seen = Observation(form)
    assert seen.color.dtype == np.uint8
    np.testing.assert_array_equal(seen.color, COLOR)


@pytest.mark.parametrize(
    "form",
    [GREY, GREY[..., None], GREY.astype(np.uint16) << 8, GREY / 255, Pillow.fromarray(GREY), GREY[None]],
    ids=range(6),
)
def test_grey_is_a_colour_too(form: Any) -> None:
    np.testing.assert_array_equal(as_picture(form), np.dstack([GREY] * 3))


def test_black_and_white_and_a_palette() -> None:
    np.testing.assert_array_equal(as_picture(GREY > 99)[..., 0], np.where(GREY > 99, 255, 0))
    np.testing.assert_array_equal(
        as_picture(Pillow.fromarray(GREY > 99))[..., 2], np.where(GREY > 99, 255, 0)
    )
    few = Pillow.fromarray(COLOR).quantize(4)
    np.testing.assert_array_equal(as_picture(few), np.asarray(few.convert("RGB")))


def test_a_picture_that_is_one_already_is_not_copied() -> None:
    assert Observation(COLOR).color is COLOR


@pytest.mark.parametrize(
    ("form", "line"),
    [
        (COLOR[None], "of shape (1, 12, 20, 3)"),
        (COLOR[..., :2], "of shape (12, 20, 2)"),
        (COLOR[:0], "of shape (0, 20, 3)"),
        (COLOR.astype(float), "got float64 from 0 to 255"),
        (np.full((4, 4, 3), np.nan), "got float64 from nan"),
        (COLOR.astype(int) * 300, "got int64 from"),
        (COLOR - 300.0, "fractions from 0 to 1"),
        ("photo.png", "got str photo.png"),
        (Path("photo.png"), "photo.png"),
        (None, "got NoneType"),
        ([[1, 2], [3]], "got list"),
        (np.full((4, 4, 3), "x"), "picture of numbers"),
        (torch.zeros(4, 4, 3, requires_grad=True), "got Tensor of shape (4, 4, 3)"),
    ],
)
def test_what_is_no_picture_is_one_line(form: Any, line: str) -> None:
    with pytest.raises(BaggieError, match="expected a picture") as error:
        Observation(form)
    assert line in str(error.value)
    assert "\n" not in str(error.value)


def test_files_are_read_by_the_same_rule(tmp_path: Path) -> None:
    for name, picture in (
        ("color.png", Pillow.fromarray(COLOR)),
        ("alpha.png", Pillow.fromarray(np.dstack([COLOR, ALPHA]), "RGBA")),
        ("deep.png", Pillow.fromarray(GREY.astype(np.uint16) << 8)),
        ("fractions.tiff", Pillow.fromarray((GREY / 255).astype(np.float32))),
    ):
        picture.save(tmp_path / name)
        expected = COLOR if name in {"color.png", "alpha.png"} else np.dstack([GREY] * 3)
        np.testing.assert_array_equal(read_picture(tmp_path / name), expected)


def test_depth_in_millimetres_is_one_line() -> None:
    millimetres = np.full(GREY.shape, 800, np.uint16)
    for name in ("depth", "height"):
        with pytest.raises(
            BaggieError, match=f"expected the {name} in metres, .*got uint16; divide millimetres by 1000"
        ):
            Observation(COLOR, **{name: millimetres})  # type: ignore[arg-type]
    depth = Observation(COLOR, millimetres / 1000).depth  # type: ignore[arg-type]
    assert depth is not None
    assert depth.dtype == np.float32


@pytest.mark.parametrize("order", list(permutations(range(4))), ids=str)
def test_four_corners_are_one_goal_in_any_order(order: tuple[int, ...]) -> None:
    shuffled = SQUARE[list(order)]
    corners = Goal(shuffled).corners
    assert {tuple(corner) for corner in corners} == {tuple(corner) for corner in SQUARE}
    assert tuple(corners[0]) == tuple(shuffled[0])
    np.testing.assert_array_equal(region_mask(corners, (100, 100)), region_mask(SQUARE, (100, 100)))


@pytest.mark.parametrize(
    "form",
    [
        SQUARE.tolist(),
        [tuple(corner) for corner in SQUARE],
        SQUARE[:, None],
        SQUARE[None],
        [*SQUARE, SQUARE[0]],
    ],
    ids=range(5),
)
def test_corners_in_any_form(form: Any) -> None:
    corners = as_outline(form)
    assert corners.dtype == np.float64
    np.testing.assert_array_equal(np.sort(corners, axis=0), np.sort(SQUARE, axis=0))
    np.testing.assert_array_equal(region_mask(corners, (100, 100)), region_mask(SQUARE, (100, 100)))


@given(st.integers(3, 12), st.floats(0, 6), st.integers(0, 11), st.booleans())
def test_corners_in_order_stay_as_they_are(count: int, phase: float, first: int, back: bool) -> None:
    angles = phase + 2 * np.pi * np.arange(count) / count
    radii = np.where(np.arange(count) % 2 == 0, 40.0, 25.0)  # a star is no convex polygon
    star = np.roll(50 + radii[:, None] * np.c_[np.cos(angles), np.sin(angles)], first, axis=0)
    star = star[::-1] if back else star
    np.testing.assert_array_equal(as_outline(star), star)


def test_a_goal_does_not_change_with_the_array_it_was_made_of() -> None:
    mine = SQUARE.copy()
    goal = Goal(mine)
    mine[:] = 0
    np.testing.assert_array_equal(goal.corners, SQUARE)


@pytest.mark.parametrize(
    ("form", "line"),
    [
        ([[10, 10]] * 4, "an area of a pixel or more"),
        ([[10, 10], [40, 10], [40, 10], [10, 10]], "an area of a pixel or more"),
        ([[10, 10], [20, 20], [30, 30], [40, 40]], "an area of a pixel or more"),
        (SQUARE / 640, "in pixels of the picture"),
        (SQUARE[:2], "at least three corners"),
        (SQUARE * np.nan, "to be finite pixels"),
        (SQUARE * np.inf, "to be finite pixels"),
        (SQUARE[0], "shape (N, 2)"),
        ([[1, 2, 3]] * 4, "shape (N, 2)"),
        ("here", "shape (N, 2), got str here"),
        ([[1, 2], [3]], "shape (N, 2)"),
        (None, "shape (N, 2), got NoneType"),
        ([[0, 0], [40, 40], [40, 0], [0, 40], [20, 20.5], [30, 20]], "does not cross itself"),
    ],
)
def test_corners_that_are_no_goal_are_one_line(form: Any, line: str) -> None:
    with pytest.raises(BaggieError, match="expected a goal") as error:
        Goal(form)
    assert line in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("asked", "line"),
    [
        ({"style": "dotted"}, "style among outline, solid, card, got 'dotted'"),
        ({"color": (300, 0, 0)}, "from 0 to 255, RGB, got (300, 0, 0)"),
        ({"color": "green"}, "got 'green'"),
        ({"color": (0, 200)}, "got (0, 200)"),
        ({"object_at": (1, 2, 3)}, "two numbers (u, v), got (1, 2, 3)"),
        ({"object_at": (np.nan, 2)}, "two numbers (u, v)"),
    ],
)
def test_what_else_a_goal_may_not_be_is_one_line(asked: dict[str, Any], line: str) -> None:
    with pytest.raises(BaggieError) as error:
        Goal(SQUARE, **asked)
    assert line in str(error.value)
    assert "\n" not in str(error.value)


def test_a_point_may_be_an_array() -> None:
    assert Goal(SQUARE, object_at=np.array([3, 4])).object_at == (3.0, 4.0)  # type: ignore[arg-type]


@pytest.mark.parametrize("bits", [10, 12, 14, 16])
def test_a_sensor_of_more_bits_shows_the_same_in_eight(bits: int, tmp_path: Path) -> None:
    grey = RNG.integers(0, 256, (12, 20), np.uint8)
    grey[0, 0] = 255
    deep = (grey.astype(np.uint16) << (bits - 8)) | RNG.integers(0, 1 << (bits - 8), grey.shape, np.uint16)
    Pillow.fromarray(deep).save(tmp_path / "deep.png")
    Pillow.fromarray(deep).save(tmp_path / "deep.tif")
    Pillow.fromarray((grey / 255).astype(np.float32)).save(tmp_path / "fractions.tif")
    for name in ("deep.png", "deep.tif", "fractions.tif"):
        np.testing.assert_array_equal(read_picture(tmp_path / name), np.dstack([grey] * 3), err_msg=name)
