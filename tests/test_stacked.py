"""What counts of stacked bags, in states made to order, and what a demonstrator does about it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from baggie.geometry import PlanarPose
from baggie.tasks.bag_stacks import WORKSPACE
from baggie.tasks.pattern import Pattern
from baggie.tasks.stacked import NEAR_M, Stacked, Unstacked, height_below
from helpers.stacks import ON_TABLE_M, carried, loose, lying

SITE = PlanarPose(0.45, 0.1, 0.4)
A, B, C = BAGS = ("a", "b", "c")
HEIGHTS = (0.009, 0.030, 0.054)
TOWER = Stacked(BAGS, Pattern.parse("tower:3").at(SITE), WORKSPACE)
PYRAMID = Stacked(tuple("abcdef"), Pattern.parse("pyramid:3-2-1").at(SITE), WORKSPACE)
FREE = (PlanarPose(0.6, 0.25), PlanarPose(0.6, -0.2))
APART = Unstacked(BAGS, TOWER.pattern, FREE, WORKSPACE)


def beside(pose: PlanarPose, off_m: float, towards: float = 0.0) -> PlanarPose:
    return PlanarPose(pose.x + off_m * np.cos(towards), pose.y + off_m * np.sin(towards), pose.yaw)


def tower(*offs_m: float, heights=HEIGHTS) -> dict[str, tuple[PlanarPose, float]]:
    """Each bag so far beside the one below it."""
    at, pose = {}, SITE
    for bag, off_m, height in zip(BAGS, offs_m, heights, strict=False):
        pose = beside(pose, off_m, 1.0)
        at[bag] = (pose, height)
    return at


def test_a_tower_counts_wherever_each_bag_lies_within_two_centimetres_of_the_one_below() -> None:
    assert TOWER.holds(lying(tower(0.0, 0.0, 0.0)))
    assert TOWER.holds(lying(tower(0.015, 0.015, -0.015)))
    leaning = lying(tower(0.019, 0.019, 0.019))  # its top 5.7 cm beside the site
    assert TOWER.holds(leaning)
    assert TOWER.share(leaning) == 1.0


@pytest.mark.parametrize(
    ("wrong", "right"), [((0.025, 0.0, 0.0), 0), ((0.0, 0.025, 0.0), 1), ((0.0, 0.0, 0.025), 2)]
)
def test_of_a_tower_those_layers_count_that_are_right_from_below(wrong, right: int) -> None:
    state = lying(tower(*wrong))
    assert TOWER.share(state) == pytest.approx(right / 3)
    assert not TOWER.holds(state)


def test_a_bag_that_is_right_is_so_far_from_its_slot_and_the_others_are_nowhere() -> None:
    leaning = lying(tower(0.004, 0.015, 0.025))  # the last one does not stand on the one below it
    assert TOWER.offsets_m(leaning) == (pytest.approx(0.004), pytest.approx(0.019), None)


@given(st.permutations(BAGS), st.lists(st.floats(-3.0, 3.0), min_size=3, max_size=3))
def test_any_bag_may_be_in_any_slot_at_any_angle(names, yaws) -> None:
    stood = tower(0.0, 0.005, 0.005).values()
    state = lying(
        {n: (PlanarPose(p.x, p.y, yaw), z) for n, (p, z), yaw in zip(names, stood, yaws, strict=True)}
    )
    assert TOWER.filled(state) == dict(enumerate(names))


def test_heights_tell_the_layers() -> None:
    for heights, right in (
        ((0.009, 0.0, 0.0), 1),  # all on the table at one place, which no bags can be
        ((0.018, 0.040, 0.064), 0),  # the lowest lies on something
        ((0.007, 0.023, 0.043), 3),  # the lower bags of a taller tower
        ((0.009, 0.030, 0.076), 2),  # one is missing in between
    ):
        assert TOWER.share(lying(tower(0.0, 0.0, 0.0, heights=heights))) == pytest.approx(right / 3)


def test_a_bag_that_has_sunk_into_another_does_not_count_nor_what_lies_on_it() -> None:
    sunk = lying(tower(0.0, 0.0, 0.0, heights=(0.009, 0.018, 0.040)))  # even by 15 mm of the highest layers
    assert TOWER.share(sunk) == pytest.approx(1 / 3)
    assert TOWER.filled(sunk) == {0: "a"}
    between = [slot.pose for slot in PYRAMID.pattern.slots]
    at = {bag: (pose, 0.011) for bag, pose in zip("abc", between[:3], strict=True)}
    at |= {bag: (pose, 0.031) for bag, pose in zip("de", between[3:5], strict=True)}
    assert PYRAMID.holds(lying(at | {"f": (between[5], 0.053)}))
    assert PYRAMID.share(lying(at | {"f": (between[5], 0.038)})) == pytest.approx(2 / 3)


def test_heights_are_by_the_fill() -> None:
    thin = Stacked(BAGS, TOWER.pattern, WORKSPACE, fill=0.5)
    low = lying(tower(0.0, 0.0, 0.0, heights=(0.0045, 0.014, 0.026)))
    assert thin.holds(low)
    assert not TOWER.holds(low)
    assert not thin.holds(lying(tower(0.0, 0.0, 0.0)))


def test_a_fallen_tower_counts_as_far_as_it_stands() -> None:
    fallen = tower(0.0, 0.0, 0.0) | {"c": (beside(SITE, 0.13), 0.012)}
    assert TOWER.share(lying(fallen)) == pytest.approx(2 / 3)


@given(st.floats(0.0, 0.04), st.floats(-3.0, 3.0), st.integers(0, 5))
def test_in_a_pyramid_each_bag_is_within_two_centimetres_of_its_slot(off_m, towards, which) -> None:
    at = {
        bag: (slot.pose, (0.011, 0.031, 0.053)[slot.layer])
        for bag, slot in zip(PYRAMID.bags, PYRAMID.pattern.slots, strict=True)
    }
    bag = PYRAMID.bags[which]
    at[bag] = (beside(at[bag][0], off_m, towards), at[bag][1])
    if abs(off_m - NEAR_M) > 1e-6:
        assert PYRAMID.holds(lying(at)) == (off_m < NEAR_M)


@given(
    st.sampled_from(["tower:3", "pyramid:3-2-1", "layers:2x2,2x2 turned", "tower:1", "pyramid:4-3"]),
    st.integers(0, 2**32),
)
def test_a_hand_that_never_errs_fills_slot_after_slot(words: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    pattern = Pattern.parse(words).at(PlanarPose(0.45, 0.1, float(rng.uniform(-3, 3))))
    bags = tuple(f"bag {number}" for number in rng.permutation(len(pattern.slots)))
    condition = Stacked(bags, pattern, WORKSPACE)
    state = loose(
        {bag: PlanarPose(1.0, 0.2 * n - 0.8, float(rng.uniform(-3, 3))) for n, bag in enumerate(bags)}
    )
    for number, slot in enumerate(pattern.slots):
        action = condition.next_action(state)
        assert action is not None
        assert (action.pick_on_m, action.place_on_m == 0.0) == (0.0, slot.layer == 0)
        np.testing.assert_allclose([*action.place.xy, action.place.yaw], [*slot.pose.xy, slot.pose.yaw])
        assert abs(action.place.yaw - action.pick.yaw) <= np.pi / 4 + 1e-9  # never turned further than needed
        before, state = condition.share(state), carried(action, state)
        assert sorted(condition.filled(state)) == list(range(number + 1))
        assert condition.share(state) >= before
    assert condition.holds(state)
    assert condition.next_action(state) is None


def test_the_next_bag_goes_where_the_one_below_truly_lies() -> None:
    state = lying(
        {"a": (beside(SITE, 0.009), 0.009)} | {b: (free, 0.009) for b, free in zip("bc", FREE, strict=True)}
    )
    action = TOWER.next_action(state)
    assert action is not None
    np.testing.assert_allclose(action.place.xy, state.places["a"].xy)
    assert action.place.yaw == pytest.approx(SITE.yaw)  # as the pattern says, not the bag
    np.testing.assert_allclose(action.pick.xy, FREE[0].xy)  # the nearest
    assert action.place_on_m == pytest.approx(0.009 + 0.016, abs=1e-3)


def test_what_landed_more_than_a_centimetre_off_is_laid_anew_before_another_is_laid_on_it() -> None:
    waiting = {"c": (FREE[1], ON_TABLE_M)}
    off = lying(tower(0.0, 0.012) | waiting)
    action = TOWER.next_action(off)
    assert action is not None
    np.testing.assert_allclose(action.pick.xy, off.places["b"].xy)
    np.testing.assert_allclose(action.place.xy, SITE.xy)
    assert action.pick_on_m == action.place_on_m == pytest.approx(0.009 + 0.016, abs=1e-3)
    near = TOWER.next_action(lying(tower(0.0, 0.008) | waiting))
    assert near is not None
    np.testing.assert_allclose(near.pick.xy, FREE[1].xy)
    assert TOWER.next_action(lying(tower(0.0, 0.012, 0.0))) is None  # nothing is to be laid on it any more


def test_what_lies_in_the_way_goes_aside_from_the_top() -> None:
    pile = {"a": (beside(SITE, 0.04), 0.009), "b": (beside(SITE, 0.05), 0.030), "c": (FREE[1], 0.009)}
    state = lying(pile)
    action = TOWER.next_action(state)
    assert action is not None
    np.testing.assert_allclose(action.pick.xy, pile["b"][0].xy)
    assert action.pick_on_m == pytest.approx(0.009 + 0.016, abs=2e-3)
    assert action.place_on_m == 0.0
    assert WORKSPACE.contains(action.place.x, action.place.y)
    assert all(action.place.distance(pose) > 0.15 for pose in (SITE, pile["a"][0], pile["c"][0]))
    steps = 0
    while (action := TOWER.next_action(state)) is not None:
        state, steps = carried(action, state), steps + 1
    assert TOWER.holds(state)
    assert steps == 4


def test_what_is_under_a_place_is_the_highest_within_four_and_a_half_centimetres() -> None:
    state = lying({"a": (SITE, 0.009), "b": (SITE, 0.030), "c": (FREE[0], 0.009)})
    x, y = SITE.xy
    assert height_below(state, x, y, "b") == pytest.approx(0.025, abs=1e-3)
    assert height_below(state, x, y, "a") == pytest.approx(0.046, abs=1e-3)
    assert height_below(state, x + 0.12, y, "c") == 0.0
    assert height_below(loose({}), x, y, "a") == 0.0


def test_a_tower_is_taken_apart_from_the_top() -> None:
    state, shares = lying(tower(0.0, 0.005, 0.005)), []
    for picked, on_m in (("c", 0.046), ("b", 0.025)):
        action = APART.next_action(state)
        assert action is not None
        np.testing.assert_allclose(action.pick.xy, state.places[picked].xy)
        assert action.pick_on_m == pytest.approx(on_m, abs=1e-3)
        state = carried(action, state)
        shares.append(APART.share(state))
    assert shares == [0.5, 1.0]
    assert APART.holds(state)
    assert APART.next_action(state) is None


def test_a_tower_whose_lower_bags_were_pulled_along_is_not_taken_apart() -> None:
    laid = {"c": (FREE[0], 0.009), "b": (SITE, 0.030), "a": (SITE, 0.009)}
    assert APART.share(lying(laid)) == 0.5
    for wrong in ({"b": (beside(SITE, 0.025), 0.030)}, {"a": (beside(SITE, 0.025), 0.009)}):
        assert APART.share(lying(laid | wrong)) == 0.0
    done = {"c": (FREE[0], 0.009), "b": (FREE[1], 0.009), "a": (SITE, 0.009)}
    assert APART.holds(lying(done))
    assert not APART.holds(lying(done | {"a": (beside(SITE, 0.025), 0.009)}))
    assert not APART.holds(lying(done | {"b": (FREE[0], 0.030)}))  # on another
