"""Decisions about turned maps mean the same in the map itself: places, angles and what every look says."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from baggie.geometry import rotation, wrap_angle
from baggie.policies.transporter.network import Decision
from baggie.policies.transporter.policy import quarter_turned, turned_back
from baggie.policies.transporter.scores import PlaceAngle, Scores

ROWS, COLUMNS = 24, 16
YAW = Scores(torch.zeros(1, 12, 1, 1), torch.zeros(1, 2), 1, 1)
"""A look at the yaw at one place."""
quarters = st.integers(0, 3)


def decision_at(place: tuple[float, float], angle: float = 0.0, looks: tuple[Scores, ...] = ()) -> Decision:
    there = PlaceAngle(torch.tensor([place], dtype=torch.float64), torch.tensor([angle]))
    return Decision(there, there, list(looks), list(looks))


@given(quarters, st.integers(0, 1000))
def test_what_is_at_a_place_of_the_turned_map_is_at_the_place_turned_back(quarter, seed):
    pixels = np.random.default_rng(seed).normal(size=(ROWS, COLUMNS))
    there = quarter_turned(pixels, quarter)
    v, u = np.unravel_index(int(there.argmax()), there.shape)
    back = turned_back(decision_at((float(u), float(v))), quarter, (ROWS, COLUMNS))
    column, row = back.place.place[0].int().tolist()
    assert pixels[row, column] == pixels.max()


@given(quarters, st.floats(-math.pi, math.pi), st.floats(3, 12), st.floats(3, 12))
def test_a_yaw_is_turned_along_and_a_turn_is_not(quarter, angle, u, v):
    """The way from one place to another, at some yaw, is at the yaw turned back between both turned back."""
    ahead = np.array([u, v]) + rotation(angle)[:, 0]
    back = turned_back(decision_at((u, v), angle, (YAW,)), quarter, (ROWS, COLUMNS))
    further = turned_back(decision_at((float(ahead[0]), float(ahead[1]))), quarter, (ROWS, COLUMNS))
    way = (further.pick.place - back.pick.place)[0].numpy()
    assert wrap_angle(math.atan2(way[1], way[0]) - float(back.pick.angle)) == pytest.approx(0, abs=1e-5)
    assert float(back.place.angle) == pytest.approx(angle)
    half = turned_back(decision_at((u, v), angle, (YAW._replace(fold=2),)), quarter, (ROWS, COLUMNS)).pick
    assert abs(half.angle) <= math.pi / 2 + 1e-6  # fingers change places after half a turn
    assert wrap_angle(float(half.angle - back.pick.angle), math.pi) == pytest.approx(0, abs=1e-5)
    assert turned_back(decision_at((u, v)), quarter, (ROWS, COLUMNS)).pick.angle == 0  # a cup's


@given(quarters, st.sampled_from([1, 4]), st.integers(0, 1000))
def test_a_look_says_the_same_of_the_same_pixels(quarter, stride, seed):
    rng = np.random.default_rng(seed)
    rows, columns = quarter_turned(np.zeros((ROWS, COLUMNS)), quarter).shape
    logits = torch.from_numpy(rng.normal(size=(1, 3, rows // stride, columns // stride)))
    first = torch.full((1, 2), (stride - 1) / 2, dtype=torch.float64)
    look = Scores(logits, first, stride, 1)
    best = look.read(PlaceAngle(first, torch.zeros(1)))
    back = turned_back(decision_at((0.0, 0.0), 0.0, (look,)), quarter, (ROWS, COLUMNS)).places[0]
    assert back.logits.shape[-2:] == (ROWS // stride, COLUMNS // stride)
    assert back.share() == pytest.approx(look.share())
    expected = turned_back(decision_at(tuple(best.place[0].tolist())), quarter, (ROWS, COLUMNS)).place.place
    assert back.read(best).place == pytest.approx(expected, abs=1e-5)
    assert back.read(best).angle == pytest.approx(best.angle)
