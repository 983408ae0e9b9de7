"""The laws of sceneries, without a simulator."""

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from baggie.errors import BaggieError
from baggie.geometry import PlanarPose
from baggie.options.values import Scenery
from baggie.sim.bag import Bag, Shape
from baggie.sim.cell import APART, GOAL_CARD_HUE, PADDLE_HUE, PICTURE_SIZE, draw_cell, hue_distance, hue_of
from baggie.sim.variety import (
    BAGS_M,
    OBSTACLE_M,
    UNSEEN_HUES,
    VARIED_HUES,
    Variety,
    draw_variety,
    lay_bags,
    random_pose,
)
from baggie.workcell.workcell import WorkcellSettings

CELL, BAG, WORKSPACE = draw_cell(0), Bag(), WorkcellSettings().workspace
seeds = st.integers(0, 10**6)


def drawn(scenery: Scenery, seed: int) -> Variety:
    return draw_variety(scenery, CELL, BAG, WORKSPACE, (9, seed))


def size_of(bag: Bag) -> float:
    return float(np.sqrt(bag.length_m * bag.width_m))


def in_bands(hue: float, bands: tuple[tuple[float, float], ...]) -> bool:
    # Colours are whole numbers: a degree either way.
    return any(low - 1 <= hue + turn <= high + 1 for low, high in bands for turn in (0, 360))


def test_plain_is_the_cell_as_it_is() -> None:
    plain = drawn("plain", 3)
    assert plain == Variety(CELL, BAG)
    assert plain.cell is CELL


@pytest.mark.parametrize("scenery", get_args(Scenery))
def test_a_scene_is_always_the_same_and_keeps_camera_and_lens(scenery: Scenery) -> None:
    one, again = drawn(scenery, 5), drawn(scenery, 5)
    assert repr(one) == repr(again)
    assert one.cell.lens is CELL.lens
    assert one.cell.camera_position is CELL.camera_position
    assert one.cell.camera_rotation is CELL.camera_rotation
    assert (repr(one) == repr(drawn(scenery, 6))) == (scenery == "plain")


@given(seeds)
def test_other_light_changes_nothing_but_the_light(seed: int) -> None:
    light = drawn("light", seed)
    assert light.bag == BAG
    assert not light.distractors
    assert light.second is None
    assert light.cell.table_color == CELL.table_color
    assert light.cell.table_pattern == CELL.table_pattern == 0
    assert all(1.0 <= lamp.position[2] <= 1.5 for lamp in light.cell.lights)  # the cell's: 1.6 m and more
    assert max(abs(gain - 1) for gain in light.exposure.cast) >= 0.07


@given(seeds)
def test_a_varied_bag_is_one_that_the_table_allows(seed: int) -> None:
    bag = drawn("varied", seed).bag
    assert in_bands(hue_of(bag.color), VARIED_HUES)
    assert 0.105 <= size_of(bag) <= 0.13
    assert bag.shape in ("square", "long")
    assert bag.length_m <= 1.5 * bag.width_m + 1e-9
    assert bag.fabric in ("plain", "weave", "stripes")
    assert hue_distance(hue_of(bag.accent), hue_of(bag.color)) < 3  # a shade: the colour mask sees one bag


@given(st.sampled_from(["unseen", "unseen-bag"]), seeds)
def test_an_unseen_bag_is_none_that_a_varied_collection_shows(scenery: Scenery, seed: int) -> None:
    bag = drawn(scenery, seed).bag
    assert in_bands(hue_of(bag.color), UNSEEN_HUES)
    assert not in_bands(hue_of(bag.color), VARIED_HUES)
    assert 0.095 <= size_of(bag) <= 0.105 or 0.13 <= size_of(bag) <= 0.145
    assert bag.shape != "long" or 1.5 <= bag.length_m / bag.width_m <= 1.8 + 1e-9


@given(seeds)
def test_nothing_but_the_bag_is_new_about_an_unseen_bag(seed: int) -> None:
    scene, plain = drawn("unseen-bag", seed), drawn("plain", seed)
    assert replace(scene, bag=plain.bag) == plain


def is_grey(color: tuple[int, int, int]) -> bool:
    return max(color) - min(color) <= 0.1 * max(color)


@given(st.sampled_from(["varied", "unseen"]), seeds)
def test_no_distractor_has_a_colour_that_means_something(scenery: Scenery, seed: int) -> None:
    scene = drawn(scenery, seed)
    for thing in scene.distractors:
        for color in (thing.color, thing.accent):
            if is_grey(color):
                continue
            assert hue_distance(hue_of(color), hue_of(scene.bag.color)) > APART - 3
            assert hue_distance(hue_of(color), GOAL_CARD_HUE) > 30
            assert hue_distance(hue_of(color), PADDLE_HUE) > 30


@pytest.mark.parametrize("scenery", ["varied", "unseen"])
def test_most_scenes_have_distractors_of_a_colour(scenery: Scenery) -> None:
    coloured = [
        any(
            not is_grey(color)
            for thing in drawn(scenery, seed).distractors
            for color in (thing.color, thing.accent)
        )
        for seed in range(40)
    ]
    assert sum(coloured) > 20


@given(st.sampled_from(["varied", "unseen"]), seeds)
def test_what_stands_is_in_view_and_where_it_may(scenery: Scenery, seed: int) -> None:
    scene = drawn(scenery, seed)
    standing = [thing for thing in scene.distractors if thing.standing]
    inside = [thing for thing in standing if WORKSPACE.contains(thing.pose.x, thing.pose.y, -0.14)]
    assert len(inside) <= (1 if scenery == "unseen" else 0)
    for thing in standing:
        assert 0.04 <= thing.size_m[2] <= 0.08
        pixel = scene.cell.project(np.array([[thing.pose.x, thing.pose.y, thing.size_m[2]]]))[0]
        assert (pixel > 0).all()
        assert (pixel < PICTURE_SIZE).all()


def test_something_stands_in_the_workspace_of_some_unseen_scenes_and_kinds_are_new() -> None:
    varied = {thing.kind for seed in range(60) for thing in drawn("varied", seed).distractors}
    unseen = [drawn("unseen", seed) for seed in range(60)]
    assert not varied & {thing.kind for scene in unseen for thing in scene.distractors}
    assert any(
        thing.standing and WORKSPACE.contains(thing.pose.x, thing.pose.y)
        for scene in unseen
        for thing in scene.distractors
    )


@given(seeds)
def test_the_second_bag_is_the_same_but_for_its_colour(seed: int) -> None:
    second = drawn("two-bags", seed).second
    assert second is not None
    assert hue_distance(hue_of(second.color), hue_of(BAG.color)) > APART - 3
    assert (second.size_m, second.mass_kg, second.young_pa) == (BAG.size_m, BAG.mass_kg, BAG.young_pa)


@settings(max_examples=40)
@given(seeds, st.booleans(), st.lists(st.tuples(st.floats(0.35, 0.65), st.floats(-0.3, 0.3)), max_size=1))
def test_bags_are_laid_clear_of_everything(seed: int, two: bool, things: list[tuple[float, float]]) -> None:
    obstacles = [PlanarPose(*xy) for xy in things]
    bag, second = lay_bags(WORKSPACE, obstacles, two, np.random.default_rng(seed))
    assert (second is not None) == two
    for pose in [bag, *([second] if second else [])]:
        assert WORKSPACE.contains(pose.x, pose.y)
        assert all(pose.distance(other) >= OBSTACLE_M for other in obstacles)
    assert second is None or bag.distance(second) >= BAGS_M


@given(seeds)
def test_with_nothing_in_the_way_the_first_place_is_taken(seed: int) -> None:
    bag, _ = lay_bags(WORKSPACE, [], two=False, rng=np.random.default_rng(seed))
    assert bag == random_pose(WORKSPACE, np.random.default_rng(seed))


def test_a_crowded_workspace_is_refused() -> None:
    crowd = [PlanarPose(x, y) for x in (0.4, 0.6) for y in (-0.2, 0.0, 0.2)]
    with pytest.raises(BaggieError, match="make it larger"):
        lay_bags(WORKSPACE, crowd, two=False, rng=np.random.default_rng(0))


@pytest.mark.parametrize(
    ("shape", "length", "symmetry"), [("square", 0.12, 4), ("long", 0.15, 2), ("round", 0.12, 0)]
)
def test_a_bag_looks_the_same_as_often_as_its_shape_says(shape: Shape, length: float, symmetry: int) -> None:
    assert Bag(length_m=length, shape=shape).symmetry == symmetry


@pytest.mark.parametrize(("shape", "length"), [("long", 0.13), ("round", 0.13)])
def test_a_shape_that_is_not_what_it_is_called_is_refused(shape: Shape, length: float) -> None:
    with pytest.raises(BaggieError, match=rf"expected a {shape} bag .* got 0\.130 x 0\.120 m"):
        Bag(length_m=length, shape=shape)
