"""What is drawn at random: always the same with the same seed, and one line instead of a search without end."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from baggie.collect.machine import random_place
from baggie.commissioning.poses import lead_to_random_pose
from baggie.commissioning.simulated_assistant import board_in_view
from baggie.errors import BaggieError, ReachError
from baggie.geometry import FloatArray, PlanarPose, Rectangle
from baggie.seeds import first_fit
from baggie.sim.cell import ALL_HUES, RESERVED_APART, draw_cell, random_hue
from baggie.sim.variety import STRANGE, draw_distractors, lay_bags
from baggie.tasks.layout import REACH, scatter
from baggie.vision.targets import parse_target

Rng = np.random.Generator
WORKSPACE = Rectangle(0.35, 0.65, -0.3, 0.3)
MIDDLE = PlanarPose(0.5, 0.0)


@given(st.lists(st.integers(0, 9)), st.integers(0, 9), st.integers(0, 20))
def test_the_first_that_fits_is_taken_and_no_more_are_drawn(
    numbers: list[int], least: int, tries: int
) -> None:
    rest = iter(numbers + [9] * tries)
    among = (numbers + [9] * tries)[:tries]
    fitting = [number for number in among if number >= least]
    assert first_fit(lambda: next(rest), lambda number: number >= least, tries) == (
        fitting[0] if fitting else None
    )
    drawn = among.index(fitting[0]) + 1 if fitting else tries
    assert list(rest) == (numbers + [9] * tries)[drawn:]


@pytest.mark.parametrize(
    ("draw", "then"),
    [
        (lambda rng: scatter({str(number): 0.08 for number in range(6)}, rng), (0.990744718, 0.106743949)),
        (lambda rng: random_hue(rng, ALL_HUES, unlike=200.0), (0.040973524, 0.144159613)),
        (lambda rng: random_place(WORKSPACE, MIDDLE, rng), (0.813270239, 0.144159613)),
        (lambda rng: lay_bags(WORKSPACE, [MIDDLE], two=True, rng=rng), (0.299711891, 0.516068586)),
        (
            lambda rng: draw_distractors(STRANGE, draw_cell(0), WORKSPACE, 10.0, rng),
            (0.927423929, 0.802364161),
        ),
    ],
    ids=["blocks", "hue", "place", "bags", "clutter"],
)
def test_a_seed_draws_what_it_always_drew(draw: Callable[[Rng], object], then: tuple[float, float]) -> None:
    """As many numbers of the stream as ever: so what is drawn next, and all after it, is the same."""
    for seed, expected in enumerate(then):
        rng = np.random.default_rng(seed)
        draw(rng)
        assert rng.random() == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(
    ("draw", "line"),
    [
        (lambda rng: scatter({"a": 0.17, "b": 0.17, "c": 0.17}, rng), "fewer or smaller ones"),
        (lambda rng: scatter({"a": 0.2}, rng), "0.20 m from all its edges"),
        (
            lambda rng: random_hue(rng, ((0.0, 1.0),), unlike=0.5),
            r"60 degrees from 0.5 .* got \(\(0.0, 1.0\),\)",
        ),
        (lambda rng: random_hue(rng, ((0.0, RESERVED_APART),), reserved=(0.0,)), "widen them"),
        (lambda rng: random_place(Rectangle(0.4, 0.6, 0.0, 0.05), MIDDLE, rng), "make it larger"),
        (lambda rng: lay_bags(Rectangle(0.4, 0.43, 0.0, 0.3), [], two=False, rng=rng), "make it larger"),
        (
            lambda rng: board_in_view(
                draw_cell(0), parse_target("charuco:50x40:0.042:0.030:DICT_4X4_1000"), 0, rng
            ),
            "take a smaller board",
        ),
    ],
)
def test_what_does_not_fit_is_one_line(draw: Callable[[Rng], object], line: str) -> None:
    with pytest.raises(BaggieError, match=line) as error:
        draw(np.random.default_rng(0))
    assert "\n" not in str(error.value)


def test_things_are_laid_as_long_as_there_is_room() -> None:
    radius = REACH.x_max - REACH.x_min
    assert scatter({"only": radius / 2 - 1e-9}, np.random.default_rng(0))["only"].x == pytest.approx(0.475)


def times_asked(unreached: int) -> int:
    """How often an arm that refuses so many poses is asked for one."""
    asked = 0

    class Assistant:
        def lead_to(self, T_base_hand: FloatArray, words: str) -> None:
            nonlocal asked
            asked += 1
            if asked <= unreached:
                raise ReachError("too far")

    session: Any = SimpleNamespace(assistant=Assistant())
    lead_to_random_pose(session, WORKSPACE, np.random.default_rng(0), "there")
    return asked


def test_a_hand_is_led_elsewhere_where_it_does_not_reach_but_not_for_ever() -> None:
    assert times_asked(unreached=3) == 4
    with pytest.raises(ReachError, match="put it where the arm reaches"):
        times_asked(unreached=10**6)
