"""A pattern is built from what a policy sees alone, whatever lands beside, slides, falls or is missed."""

from dataclasses import replace

import numpy as np
import pytest

from baggie.errors import BaggieError
from baggie.evaluation.builder import MOST_ANEW, Builder, Care, build
from baggie.geometry import PlanarPose
from baggie.tasks.pattern import LAYER_M, Pattern, PatternSlot
from baggie.types import Outcome
from helpers.seen_bags import AREA, BagTable, Eye

SITE = PlanarPose(0.48, 0.1)
LOOSE = [PlanarPose(x, y) for y in (-0.16, -0.3) for x in (0.3, 0.43, 0.56, 0.68)]
SMALL_M = 0.002
"""What a camera of 640 pixels, and a map fitted to it, may be off together."""


def built(cell: BagTable, words: str, care: Care | None = None, policy: Eye | None = None, most: int = 30):
    """The steps of a pattern at `SITE`; it ends."""
    steps = []
    for step in build(cell, policy or Eye(cell), Pattern.parse(words), SITE, care=care):
        steps.append(step)
        assert len(steps) <= most
    return steps


def off(cell: BagTable, words: str) -> list[float]:
    """How far from each slot the nearest bag of its layer lies, metres."""
    return [
        min(
            (pose.distance(slot.pose) for pose, layer in cell.bags.values() if layer == slot.layer),
            default=9.0,
        )
        for slot in Pattern.parse(words).at(SITE).slots
    ]


@pytest.mark.parametrize(
    "words", ["tower:4", "pyramid:2-1", "pyramid:3-2-1", "layers:1x2,1x1", "layers:2x2,2x2 turned"]
)
def test_what_lands_where_it_is_let_go_is_built_bag_by_bag(words: str) -> None:
    cell, pattern = BagTable(LOOSE), Pattern.parse(words)
    steps = built(cell, words)
    assert [step.slot for step in steps] == list(range(len(pattern.slots)))
    assert max(off(cell, words)) < SMALL_M
    layers = [slot.layer for slot in pattern.slots]
    assert [step.plan.action.place_on_m for step in steps] == [layer * LAYER_M for layer in layers]
    # As high as what stands there by then, whatever layer the next one is of.
    tallest = [0, *(layer + 1 for layer in layers[:-1])]
    assert [step.plan.action.tallest_m for step in steps] == [most * LAYER_M for most in tallest]
    assert all(step.plan.action.pick_on_m == 0.0 for step in steps)


def test_a_bag_that_landed_beside_is_laid_anew_before_another_is_laid_on_it() -> None:
    cell = BagTable(LOOSE, [(0.0, 0.02), (0.0, 0.0), (0.02, 0.0)])
    steps = built(cell, "tower:3")
    assert [step.slot for step in steps] == [0, 0, 1, 1, 2]
    assert max(off(cell, "tower:3")) < SMALL_M
    assert [action.pick_on_m for action in cell.done] == [0.0, 0.0, 0.0, LAYER_M, 0.0]
    again = cell.done[1].pick
    assert np.hypot(again.x - SITE.x, again.y - SITE.y - 0.02) < SMALL_M


def test_less_than_a_centimetre_is_left_and_aimed_at() -> None:
    cell = BagTable(LOOSE, [(0.0, 0.008)])
    assert [step.slot for step in built(cell, "tower:3")] == [0, 1, 2]
    places = [action.place.y - SITE.y for action in cell.done]
    assert places == pytest.approx([0.0, 0.008, 0.008], abs=SMALL_M)


def test_a_bag_is_laid_anew_so_often_and_then_it_goes_on() -> None:
    cell = BagTable(LOOSE, [(0.0, 0.02)] * (1 + MOST_ANEW))
    steps = built(cell, "tower:2")
    assert [step.slot for step in steps] == [0] * (1 + MOST_ANEW) + [1]
    assert cell.done[-1].place.y == pytest.approx(SITE.y + 0.02, abs=SMALL_M)


def test_each_care_can_be_left_out() -> None:
    lands = [(0.0, 0.02), (0.0, 0.0)]
    for care, last_y in (
        (Care(lay_anew=False), 0.02),
        (Care(lay_anew=False, aim_anew=False), 0.0),
    ):
        cell = BagTable(LOOSE, lands)
        assert [step.slot for step in built(cell, "tower:2", care)] == [0, 1]
        assert cell.done[-1].place.y - SITE.y == pytest.approx(last_y, abs=SMALL_M)


def test_over_a_gap_bags_go_by_the_mean_of_what_carries_them() -> None:
    cell = BagTable(LOOSE, [(0.02, 0.0), (0.0, 0.01)])
    built(cell, "pyramid:2-1", Care(lay_anew=False))
    place = cell.done[-1].place
    assert (place.x - SITE.x, place.y - SITE.y) == pytest.approx((0.01, 0.005), abs=SMALL_M)


def test_what_slides_off_leaves_its_slot_open_and_is_laid_again() -> None:
    cell = BagTable(LOOSE, [(0.0, 0.0), (0.0, 0.12)])
    steps = built(cell, "tower:3")
    assert [step.slot for step in steps] == [0, 1, 1, 2]
    assert max(off(cell, "tower:3")) < SMALL_M


def test_what_a_falling_bag_takes_along_is_laid_anew_too() -> None:
    class Dragging(BagTable):
        """The second bag slides off, and takes the first along by 3 cm."""

        def carry_out(self, plan):
            outcome = super().carry_out(plan)
            if len(self.done) == 2:
                (first,) = [n for n, (pose, _) in self.bags.items() if pose.distance(SITE) < 0.01]
                pose, layer = self.bags[first]
                self.bags[first] = (replace(pose, y=pose.y + 0.03), layer)
            return outcome

    cell = Dragging(LOOSE, [(0.0, 0.0), (0.0, 0.14)])
    steps = built(cell, "tower:2")
    assert [step.slot for step in steps] == [0, 1, 0, 1]
    assert max(off(cell, "tower:2")) < SMALL_M


def test_neither_a_missed_grasp_nor_a_bag_that_was_dropped_fills_a_slot() -> None:
    cell = BagTable(LOOSE, [(0.0, 0.0), "miss", "drop", (0.0, 0.0)])
    steps = built(cell, "tower:2")
    assert [step.slot for step in steps] == [0, 1, 1, 1]
    assert max(off(cell, "tower:2")) < SMALL_M


def test_a_bag_that_only_seemed_to_be_dropped_is_found_where_it_lies_and_laid_anew() -> None:
    cell = BagTable(LOOSE[:2], [(0.0, 0.0), "thin"])
    assert [step.slot for step in built(cell, "tower:2")] == [0, 1, 1]
    assert [action.pick_on_m for action in cell.done] == [0.0, 0.0, LAYER_M]
    assert max(off(cell, "tower:2")) < SMALL_M


def test_a_bag_that_is_lost_when_it_is_laid_anew_opens_its_slot() -> None:
    cell = BagTable(LOOSE, [(0.0, 0.02), "drop"])
    assert [step.slot for step in built(cell, "tower:2")] == [0, 0, 0, 1]


def test_what_is_built_is_never_taken_though_it_is_seen_best() -> None:
    class Greedy(Eye):
        """Best of all it sees what lies highest, then what was there last."""

        def seen(self):
            return sorted(super().seen(), key=lambda each: -each[1] - 0.1 * (each[0].y > -0.1))

    cell = BagTable(LOOSE)
    built(cell, "pyramid:3-2-1", policy=Greedy(cell))
    assert max(off(cell, "pyramid:3-2-1")) < SMALL_M
    assert all(action.pick.y < -0.1 for action in cell.done)


def test_a_person_may_say_which_bag_is_next() -> None:
    cell = BagTable(LOOSE, [(0.0, 0.0), (0.0, 0.02)])
    wanted = iter([LOOSE[5], LOOSE[2]])  # and nobody is asked for one that is laid anew
    steps = build(
        cell,
        Eye(cell),
        Pattern.parse("tower:2"),
        SITE,
        click=lambda _seen, _goal: tuple(cell.outline(next(wanted)).mean(axis=0)),
    )
    assert [step.slot for step in steps] == [0, 1, 1]
    picked = [LOOSE[5], LOOSE[2]]
    assert all(action.pick.distance(pose) < SMALL_M for action, pose in zip(cell.done, picked, strict=False))


def test_what_stands_is_taken_apart_from_above() -> None:
    cell = BagTable([])
    standing = Pattern.parse("pyramid:2-1").at(SITE)
    cell.bags = {name: (slot.pose, slot.layer) for name, slot in enumerate(standing.slots)}
    free = Pattern((PatternSlot(PlanarPose(0.4, -0.2), 0),))
    steps = list(build(cell, Eye(cell), free, PlanarPose(0.0, 0.0), standing=standing))
    (action,) = cell.done
    assert [step.slot for step in steps] == [0]
    assert action.pick.distance(standing.slots[-1].pose) < SMALL_M
    assert (action.pick_on_m, action.place_on_m, action.tallest_m) == (LAYER_M, 0.0, 2 * LAYER_M)


def test_where_no_bag_is_left_one_line_says_so() -> None:
    cell = BagTable(LOOSE[:2])
    with pytest.raises(
        BaggieError, match="a bag for slot 3 of 3 beside what is built, found none; put one into view"
    ):
        built(cell, "tower:3")
    assert len(cell.done) == 2


def test_a_policy_without_a_heat_map_takes_what_it_would_pick_unless_that_is_built() -> None:
    class Dull(Eye):
        """Has no heat map, and picks what lies highest."""

        def seen(self):
            return sorted(super().seen(), key=lambda each: -each[1])

        def plan(self, observation, goal=None):
            return replace(super().plan(observation, goal), views={})

    cell = BagTable(LOOSE)
    with pytest.raises(BaggieError, match="a bag for slot 3 of 3 beside what is built"):
        built(cell, "tower:3", policy=Dull(cell))
    assert len(cell.done) == 2


def test_what_the_policy_is_not_sure_of_has_fallen() -> None:
    cell = BagTable(LOOSE)
    eye = Eye(cell)
    builder = Builder(cell, eye, Pattern.parse("tower:2").at(SITE))
    goal = builder.look(cell.look())
    builder.note(cell.carry_out(builder.plan(cell.look(), goal)))
    eye.pick_within_m = 2 * cell.settings.sure_within_m
    builder.look(cell.look())
    assert (builder.slot, builder.lies) == (0, {})
    eye.pick_within_m = cell.settings.sure_within_m / 2
    builder.note(Outcome(cell.done[-1]))  # as if it had been laid once more
    builder.look(cell.look())
    assert builder.slot == 1
    assert builder.lies.keys() == {0}


def test_a_pattern_that_leaves_the_workspace_is_refused_before_anything_moves() -> None:
    cell = BagTable(LOOSE)
    with pytest.raises(BaggieError, match="expected all of the pattern within"):
        next(build(cell, Eye(cell), Pattern.parse("pyramid:3-2-1"), PlanarPose(0.5, AREA.y_max)))
    assert not cell.done
