"""Patterns of stacked bags: what is said is what is meant, and nothing is built on nothing."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from baggie.errors import BaggieError, DataError
from baggie.geometry import PlanarPose, Rectangle
from baggie.tasks.pattern import LAYER_M, MOST_BAGS, PITCH_M, SUPPORT_M, Pattern, PatternSlot
from baggie.vision.draw import paint_layers

towers = st.integers(1, MOST_BAGS).map(lambda count: f"tower:{count}")
pyramids = (
    st.lists(st.integers(1, 6), min_size=1, unique=True)
    .map(lambda rows: sorted(rows, reverse=True))
    .filter(lambda rows: sum(rows) <= MOST_BAGS)
    .map(lambda rows: "pyramid:" + "-".join(map(str, rows)))
)
layers = st.sampled_from(
    [
        "layers:1x1",
        "layers:2x3",
        "layers:2x2,2x2",
        "layers:2x2,2x2 turned",
        "layers:2x1 turned,2x1 turned,1x1",
    ]
)
words = st.one_of(towers, pyramids, layers)
sites = st.builds(PlanarPose, st.floats(0.3, 0.7), st.floats(-0.3, 0.3), st.floats(-3.0, 3.0))


def numbers(pattern: Pattern) -> np.ndarray:
    return np.array([[s.pose.x, s.pose.y, s.pose.yaw, s.layer] for s in pattern.slots])


@given(words)
def test_a_pattern_written_down_slot_by_slot_is_read_again(text: str) -> None:
    pattern = Pattern.parse(text)
    np.testing.assert_allclose(numbers(Pattern.parse(pattern.to_yaml())), numbers(pattern), atol=2e-6)


def test_a_file_holds_the_words_or_all_slots(tmp_path: Path) -> None:
    file = tmp_path / "pattern.yaml"
    file.write_text("pyramid:3-2-1\n")
    assert Pattern.read(file) == Pattern.parse("pyramid:3-2-1")
    file.write_text("slots:\n- {x: 0, y: 0.0, layer: 1, yaw_deg: 90}\n- {x: 0.01, y: -0.02, layer: 0}\n")
    low, high = Pattern.read(file).slots
    assert low == PatternSlot(PlanarPose(0.01, -0.02), 0)
    assert high == PatternSlot(PlanarPose(0.0, 0.0, np.pi / 2), 1)


@given(words, st.randoms())
def test_the_order_of_building_never_puts_a_slot_before_those_that_carry_it(text: str, random) -> None:
    shuffled = list(Pattern.parse(text).slots)
    random.shuffle(shuffled)
    pattern = Pattern(tuple(shuffled))
    assert [number for layer in pattern.layers for number in layer] == list(range(len(shuffled)))
    for number, slot in enumerate(pattern.slots):
        supports = pattern.supports(number)
        assert all(below < number for below in supports)
        assert bool(supports) == (slot.layer > 0)
        assert all(pattern.slots[below].layer == slot.layer - 1 for below in supports)


@given(words, sites)
def test_who_carries_whom_is_the_same_at_every_site(text: str, site: PlanarPose) -> None:
    pattern = Pattern.parse(text)
    moved = pattern.at(site)
    for number, slot in enumerate(moved.slots):
        assert moved.supports(number) == pattern.supports(number)
        assert moved.straight_on(number) == pattern.straight_on(number)
        np.testing.assert_allclose((site.inverse() @ slot.pose).xy, pattern.slots[number].pose.xy, atol=1e-9)


def test_towers_stand_on_one_and_pyramids_and_turned_layers_on_two() -> None:
    tower, pyramid, turned = map(Pattern.parse, ("tower:3", "pyramid:3-2-1", "layers:2x2,2x2 turned"))
    assert [tower.supports(slot) for slot in range(3)] == [(), (0,), (1,)]
    assert [tower.straight_on(slot) for slot in range(3)] == [None, 0, 1]
    assert [pyramid.supports(slot) for slot in range(6)] == [(), (), (), (0, 1), (1, 2), (3, 4)]
    assert {len(turned.supports(slot)) for slot in range(4, 8)} == {2}
    assert not any(each.straight_on(slot) for each in (pyramid, turned) for slot in range(6))


def test_rows_run_along_y_with_fingers_that_open_across() -> None:
    pyramid = Pattern.parse("pyramid:3-2-1")
    np.testing.assert_allclose(
        [slot.pose.y for slot in pyramid.slots], PITCH_M * np.array([1, 0, -1, 0.5, -0.5, 0]), atol=1e-12
    )
    assert {slot.pose.yaw for slot in pyramid.slots} == {np.pi / 2}


def test_a_turned_layer_is_turned_about_its_middle_and_its_bags_with_it() -> None:
    straight, turned = Pattern.parse("layers:2x2").slots, Pattern.parse("layers:2x2 turned").slots
    quarter = PlanarPose(0.0, 0.0, np.pi / 4)
    for one, other in zip(straight, turned, strict=True):
        assert other.pose == quarter @ one.pose


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("house", r"a pattern such as tower:3, .* got 'house'; write it so"),
        ("3", r"got '3'"),
        ("tower:0", r"got 'tower:0'"),
        ("tower:three", r"got 'tower:three'"),
        ("tower:9", r"1 to 8 bags in all, got 9; take fewer layers"),
        ("layers:3x3", r"1 to 8 bags in all, got 9"),
        ("pyramid:2-3", r"got 'pyramid:2-3'; .* each row of a pyramid shorter"),
        ("layers:2x2,", r"got 'layers:2x2,'"),
        ("layers:2x2 upside down", r"got 'layers:2x2 upside down'"),
        ("layers:1x1,3x1", r"layer 1 at x -0\.130, y 0\.000 m on nothing; put a slot of layer 0 there"),
        ("slots: []", r"1 to 8 bags in all, got 0"),
        ("{slots: [{x: 0.0, y: 0.0, layer: 0}], name: mine}", r"a pattern such as"),
        (
            "slots: [{x: 0.0, y: 0.0}]",
            r"slots such as \{x: .* in the pattern, .* got \{'x': 0\.0, 'y': 0\.0\}",
        ),
        ("slots: [{x: 0.0, y: .nan, layer: 0}]", r"slots such as"),
        ("slots: [{x: 0.0, y: 0.0, layer: -1}]", r"a layer from 0 on"),
        ("slots: [{x: 0.0, y: 0.0, layer: 0, z: 1.0}]", r"slots such as"),
        ("slots: [{x: 0.0, y: 0.0, layer: 1}]", r"layer 1 at .* on nothing"),
        (
            "slots: [{x: 0.0, y: 0.0, layer: 0}, {x: 0.0, y: 0.1, layer: 0}]",
            r"at least 12 cm apart, .* got layer 0 at x 0\.000, y 0\.000 m and layer 0 at x 0\.000, y 0\.100 m",
        ),
    ],
)
def test_what_is_no_pattern_is_one_line(text: str, said: str) -> None:
    with pytest.raises(BaggieError, match=said) as error:
        Pattern.parse(text)
    assert len(str(error.value).splitlines()) == 1


def test_what_is_no_yaml_names_its_file(tmp_path: Path) -> None:
    file = tmp_path / "pattern.yaml"
    file.write_text("slots: [\n")
    with pytest.raises(DataError, match=r"pattern\.yaml is no YAML"):
        Pattern.read(file)


@given(words, sites, st.floats(0.0, 0.05))
def test_a_pattern_fits_where_all_its_middles_are_inside(
    text: str, site: PlanarPose, margin_m: float
) -> None:
    area, pattern = Rectangle(0.3, 0.7, -0.3, 0.3), Pattern.parse(text).at(site)
    inside = all(area.contains(slot.pose.x, slot.pose.y, margin_m) for slot in pattern.slots)
    if inside:
        pattern.check_fits(area, margin_m)
    else:
        with pytest.raises(BaggieError, match=r"cm outside; move the site, turn it, or take a smaller"):
            pattern.check_fits(area, margin_m)


def test_it_says_by_how_much_a_pattern_does_not_fit() -> None:
    with pytest.raises(BaggieError, match=r"layer 0 at x 0\.500, y 0\.380 m, which is 8\.0 cm outside"):
        Pattern.parse("pyramid:3-2-1").at(PlanarPose(0.5, 0.25)).check_fits(Rectangle(0.3, 0.7, -0.3, 0.3))


@given(words, sites)
def test_outlines_are_those_of_bags_in_the_slots_a_layer_apart(text: str, site: PlanarPose) -> None:
    pattern = Pattern.parse(text).at(site)
    outlines = pattern.outlines(0.12, 0.10)
    for slot, corners in zip(pattern.slots, outlines, strict=True):
        np.testing.assert_allclose(corners[:, :2], slot.pose.outline(0.12, 0.10))
        np.testing.assert_allclose(corners[:, 2], outlines[0, 0, 2] + slot.layer * LAYER_M)


@given(st.floats(0.0, 2 * np.pi), st.floats(0.0, 0.12))
def test_a_slot_rests_on_what_is_within_nine_centimetres(towards: float, away: float) -> None:
    assume(abs(away - SUPPORT_M) > 1e-6)
    over = PatternSlot(PlanarPose(away * np.cos(towards), away * np.sin(towards)), 1)
    slots = (PatternSlot(PlanarPose(0.0, 0.0), 0), over)
    if away < SUPPORT_M:
        assert Pattern(slots).supports(1) == (0,)
    else:
        with pytest.raises(BaggieError, match="on nothing"):
            Pattern(slots)


def test_layers_are_drawn_in_shades_with_numbers_in_their_slots_and_nothing_else() -> None:
    grey = np.full((180, 320, 3), 90, np.uint8)
    pattern = Pattern.parse("layers:1x2,1x1")

    def project(points: np.ndarray) -> np.ndarray:
        return np.c_[160 - 400 * points[:, 1], 90 - 400 * points[:, 0]]

    painted = pattern.paint(grey, lambda pose, _layer: project(pose.outline(0.12, 0.12)))
    assert not (grey != 90).any()
    assert (painted != grey).any(axis=2).sum() > 0
    outlines = np.concatenate(pattern.outlines(0.12, 0.12))
    low, high = project(outlines).min(axis=0) - 4, project(outlines).max(axis=0) + 4
    changed = np.argwhere((painted != grey).any(axis=2))[:, ::-1]
    assert (changed >= low).all()
    assert (changed <= high).all()
    plain = [
        paint_layers(grey, project(pattern.outlines(0.12, 0.12)[2]).reshape(1, 4, 2), [layer])[100, 145]
        for layer in (0, 1)
    ]
    assert not np.array_equal(*plain)


def test_the_numbers_of_a_tower_are_above_each_other() -> None:
    grey = np.full((720, 1280, 3), 90, np.uint8)
    square = np.array([[600.0, 300.0], [700, 300], [700, 400], [600, 400]])
    white = [(paint_layers(grey, np.array([square] * n), [0] * n) > 240).all(axis=2) for n in (1, 2, 3)]
    rows = [int(each.any(axis=1).sum()) for each in white]
    assert rows[0] < rows[1] < rows[2]
