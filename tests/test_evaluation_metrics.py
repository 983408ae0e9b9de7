"""Laws of the numbers we report."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from baggie.geometry import PlanarPose
from baggie.metrics import position_error_cm, success_rate, summary, within_stated, yaw_error_deg

counts = st.integers(1, 5000).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n)))
numbers = st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=50)


@given(counts)
def test_interval_lies_in_unit_range_and_holds_the_rate(count):
    rate = success_rate(*count)
    assert 0 <= rate["low"] <= rate["rate"] <= rate["high"] <= 1
    assert rate["low"] < rate["high"]


@given(counts)
def test_interval_bounds_solve_the_score_equation(count):
    successes, n = count
    rate = success_rate(successes, n)
    for p in (rate["low"], rate["high"]):
        assert (successes / n - p) ** 2 == pytest.approx(1.959964**2 * p * (1 - p) / n, rel=1e-6, abs=1e-9)


@given(counts, st.integers(2, 10))
def test_interval_shrinks_with_more_trials(count, factor):
    successes, n = count
    few, many = success_rate(successes, n), success_rate(successes * factor, n * factor)
    assert many["high"] - many["low"] < few["high"] - few["low"]


@given(counts)
def test_failures_mirror_successes(count):
    successes, n = count
    a, b = success_rate(successes, n), success_rate(n - successes, n)
    assert a["low"] == pytest.approx(1 - b["high"], abs=1e-12)


@pytest.mark.parametrize(("successes", "n"), [(1, 0), (-1, 3), (4, 3)])
def test_impossible_counts_are_refused(successes, n):
    with pytest.raises(ValueError, match="successes must be between"):
        success_rate(successes, n)


@given(numbers, st.randoms())
def test_summary_is_ordered_and_blind_to_order(values, random):
    result = summary(values)
    shuffled = list(values)
    random.shuffle(shuffled)
    assert summary(shuffled) == pytest.approx(result, rel=1e-6, abs=1e-6)
    assert min(values) <= result["median"] <= result["p95"] <= result["max"] == max(values)
    assert result["n"] == len(values)


def test_summary_refuses_what_is_no_measurement():
    for bad in ([], [1.0, math.nan], [math.inf]):
        with pytest.raises(ValueError, match="at least one number"):
            summary(bad)


@given(st.floats(-1, 1), st.floats(-1, 1), st.floats(-4, 4))
def test_position_error_is_in_centimetres(dx, dy, yaw):
    a, b = PlanarPose(0.4, 0.1), PlanarPose(0.4 + dx, 0.1 + dy, yaw)
    assert position_error_cm(a, b) == pytest.approx(100 * np.hypot(dx, dy), abs=1e-9)


@given(st.floats(-4, 4), st.floats(-0.7, 0.7), st.integers(-4, 4))
def test_yaw_error_forgets_quarter_turns(yaw, turn, quarters):
    a = PlanarPose(0, 0, yaw)
    b = PlanarPose(0, 0, yaw + turn + quarters * math.pi / 2)
    assert yaw_error_deg(a, b) == pytest.approx(abs(math.degrees(turn)), abs=1e-6)


def test_a_round_object_has_no_wrong_angle():
    assert yaw_error_deg(PlanarPose(0, 0, 1.0), PlanarPose(0, 0, -2.0), symmetry=0) == 0.0


@given(st.lists(st.tuples(st.floats(0, 5), st.one_of(st.none(), st.floats(0, 0.05))), max_size=30))
def test_only_stated_radii_count_and_wider_ones_hold_no_less(stated):
    errors, radii = [error for error, _ in stated], [radius for _, radius in stated]
    found = within_stated("pick", errors, radii)
    told = [radius for radius in radii if radius is not None]
    if not told:
        assert found == {}
        return
    assert found["pick_within"]["n"] == found["pick_radius_cm"]["n"] == len(told)
    wider = within_stated("pick", errors, [None if radius is None else radius + 0.01 for radius in radii])
    assert wider["pick_within"]["rate"] >= found["pick_within"]["rate"]
    all_of_them = within_stated("pick", errors, [None if radius is None else 0.06 for radius in radii])
    assert all_of_them["pick_within"]["rate"] == 1.0
