"""What demonstrations carry, whoever shows them: the thing is taught, wherever on it somebody happened to pick it."""

import math
import warnings
from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from baggie.errors import BaggieWarning
from baggie.geometry import Grid, PlanarPose, rotation
from baggie.learning.demonstrations import Demonstrations, carried_in
from baggie.learning.moved_maps import MovedMaps, Moves
from baggie.learning.symmetry import check_symmetries, found_symmetries
from baggie.learning.transporter import TransporterOptions, TransporterRecipe
from baggie.policies.transporter.config import TransporterConfig
from baggie.types import Observation, PickPlace
from baggie.vision.carried import Carried, ObjectMap, middle_of, place_belongs_to, place_of, with_turn
from helpers.box_scenes import GRID, TABLE, box_attempts
from helpers.outlines import after, drawn, shape

L_SHAPE = np.array([[0, 0], [26, 0], [26, 12], [12, 12], [12, 26], [0, 26]], float) - [9.3, 9.3]
angles, shares = st.floats(-math.pi, math.pi), st.floats(0, 1)


def as_far(outline: np.ndarray, other: np.ndarray) -> float:
    """Pixels by which two closed outlines differ, at most."""
    apart = np.linalg.norm(outline[:, None] - other[None], axis=2)
    return float(max(apart.min(axis=0).max(), apart.min(axis=1).max()))


@given(st.integers(0, 6), shares, angles, st.tuples(shares, angles), angles)
def test_whichever_of_the_turns_that_look_alike_is_taken_the_thing_ends_the_same(
    symmetry, wave, turn, at, other
):
    """The law: outline, turn and place together, for any pick on the thing."""
    middle = np.array([40.0, 50.0])
    outline = shape(symmetry, 8.0, 0.3 * wave) + middle
    pick = middle + 6 * at[0] * np.array([math.cos(at[1]), math.sin(at[1])])
    places = np.array([pick, [80.0, 70.0]])
    if symmetry:
        other = turn + round(other) * 2 * math.pi / symmetry
    again = np.array([pick, with_turn(places, turn, other, middle)])
    assert as_far(after(outline, places, turn), after(outline, again, other)) < 0.2
    assert place_of(middle, places, turn) == pytest.approx(place_of(middle, again, other))


@given(st.sampled_from([0, 2, 3, 4]), angles, angles, shares, angles)
def test_a_thing_is_told_from_what_it_stands_on(symmetry, yaw, turn, off, way):
    """On a pedestal of its own colour and height, touching a neighbour: the maps before and after tell."""
    middle = np.array([38.0, 40.0])
    outline = shape(symmetry, 8.0, 0.25) @ rotation(yaw).T + middle
    pick = middle + 5 * off * np.array([math.cos(way), math.sin(way)])
    ground = drawn(shape(4, 16.0, 0.0) + middle + [9, 0])
    before = drawn(outline, onto=ground)
    places = np.array([pick, [90.0, 85.0]])
    carried = Carried.between(before, drawn(after(outline, places, turn), onto=ground), places, turn)
    assert carried is not None
    assert carried.middle == pytest.approx(middle, abs=0.5)
    assert as_far(np.argwhere(carried.moved(places, turn))[:, ::-1], after(outline, places, turn)) < 9
    assert middle_of(carried.moved(places, turn)) == pytest.approx(place_of(middle, places, turn), abs=0.6)


@given(angles, st.floats(-0.5, 0.5), st.floats(6.0, 20.0))
def test_what_moved_by_less_than_its_size_is_found_whole(yaw, turn, by):
    """Where it lay before and after alike, the maps are the same."""
    middle = np.array([50.0, 60.0])
    outline = (np.array([[-14, -9], [14, -9], [14, 9], [-14, 9]]) @ rotation(yaw).T) + middle
    places = middle + np.array([[3.0, -2.0], [3.0 + by, -2.0]])
    carried = Carried.between(drawn(outline), drawn(after(outline, places, turn)), places, turn)
    assert carried is not None
    assert carried.middle == pytest.approx(middle, abs=1.0)


def test_what_was_not_carried_is_none():
    outline = shape(4, 8.0, 0.2, [38.0, 40.0])
    before, places = drawn(outline), np.array([[38.0, 40.0], [90.0, 85.0]])
    there = drawn(after(outline, places, 0.0))
    assert Carried.between(before, there, places, 0.0) is not None
    assert Carried.between(before, before, places, 0.0) is None  # missed
    assert (
        Carried.between(before, drawn(outline + np.array([30.0, -10.0])), places, 0.0) is None
    )  # dropped on the way
    assert Carried.between(before, np.zeros_like(before), places, 0.0) is None  # gone
    assert Carried.between(before, there, places + np.array([20.0, 0.0]), 0.0) is None  # picked beside it
    flat = drawn(outline, 0.002), drawn(after(outline, places, 0.0), 0.002)
    assert Carried.between(*flat, places, 0.0) is None


def test_maps_of_different_grids_do_not_tell():
    outline = shape(4, 9, 0.1, (50, 60))
    places = np.array([[50.0, 60.0], [80.0, 70.0]])
    heights = drawn(outline), drawn(after(outline, places, 0.0))
    before, then = (
        Observation(np.zeros((*GRID.shape, 3), np.uint8), grid=GRID, height=height) for height in heights
    )
    attempt = replace(
        box_attempts(1, 0)[0],
        before=before,
        after=then,
        commanded=PickPlace(*(PlanarPose(*xy, 0.0) for xy in GRID.to_robot(places).tolist())),
    )
    assert carried_in(attempt) is not None
    smaller = Grid(x=GRID.x, y=(-0.2, 0.1), pixel_m=GRID.pixel_m)
    shifted = Grid(x=(0.25 + 0.025, 0.65 + 0.025), y=GRID.y, pixel_m=GRID.pixel_m)
    for grid in (smaller, shifted):
        rows = grid.shape[0]
        other = Observation(then.color[:rows], grid=grid, height=then.height[:rows])
        assert carried_in(replace(attempt, after=other)) is None


def carried_at(outline, pick, heights=None):
    places = np.array([pick, [90.0, 85.0]])
    before = drawn(outline) if heights is None else heights
    carried = Carried.between(before, drawn(after(outline, places, 0.0)), places, 0.0)
    assert carried is not None
    return carried, before


@given(angles, st.integers(0, 10**6))
def test_a_cup_holds_a_thing_at_one_point_wherever_it_was_shown(yaw, seed):
    outline = L_SHAPE @ rotation(yaw).T + [40.0, 40.0]
    inside = np.argwhere(drawn(outline) > 0)[:, ::-1]
    picks = inside[np.random.default_rng(seed).integers(0, len(inside), 2)].astype(float)
    points = []
    for pick in picks:
        carried, before = carried_at(outline, pick)
        points.append(carried.cup_point(before))
    assert points[0] == pytest.approx(points[1])
    inner = cv2.pointPolygonTest(outline.astype(np.float32), tuple(map(float, points[0])), measureDist=True)
    assert inner > 2


def test_what_has_a_hole_or_is_level_nowhere_is_picked_as_it_was_shown():
    disc, hole = shape(0, 12.0, 0.0, [40.0, 40.0]), shape(0, 5.0, 0.0, [40.0, 40.0])
    ring = drawn(disc)
    ring[drawn(hole) > 0] = 0
    carried, _ = carried_at(disc, [31.0, 40.0])
    assert Carried(ring > 0, ring > 0).cup_point(ring) is None
    assert carried.cup_point(drawn(disc)) == pytest.approx(carried.middle)
    v, u = np.mgrid[:128, :128]
    dome = np.maximum(0, 0.06 - 0.004 * np.hypot(u - 40, v - 40)).astype(np.float32)
    assert Carried(dome > 0.004, dome > 0.004).cup_point(dome) is None


# --- what a place belongs to


def test_a_place_belongs_to_what_encloses_or_touches_the_thing_there_or_to_a_mark_or_to_nobody():
    ring = drawn(shape(0, 20.0, 0.0, [80.0, 80.0]), 0.01)
    ring[drawn(shape(0, 11.0, 0.0, [80.0, 80.0])) > 0] = 0
    heights = drawn(shape(4, 7.0, 0.1, [30.0, 30.0]), onto=ring)
    things, color = ObjectMap.on(heights), np.full((*GRID.shape, 3), TABLE, np.uint8)
    enclosing = things.footprints[80, 95]
    assert enclosing > 0
    assert things.at(np.array([[80.0, 80.0]]))[0] == 0  # the place itself is bare table
    for radius in (3.0, 9.0):  # with room, and snugly
        lies = drawn(shape(0, radius, 0.0, [80.0, 80.0])) > 0
        assert place_belongs_to(things, color, lies) == enclosing
    elsewhere = drawn(shape(0, 7.0, 0.0, [30.0, 100.0])) > 0
    assert place_belongs_to(things, color, elsewhere) is None
    marked = color.copy()
    marked[98:103, 22:40] = (250, 240, 240)
    assert place_belongs_to(things, marked, elsewhere) == 0


# --- how often it looks the same


ELLIPSE = shape(0, 9.0, 0.0) * [1.0, 0.7]


@pytest.mark.parametrize(
    ("outline", "times"),
    [
        (shape(4, 8.0, 0.15), 4),
        (shape(3, 9.0, 0.25), 3),
        (shape(0, 9.0, 0.0), 0),
        (ELLIPSE, 2),
        (L_SHAPE, 1),
    ],
    ids=["square", "triangle", "disc", "ellipse", "L"],
)
def test_how_often_a_thing_looks_the_same_is_seen(outline, times):
    rng = np.random.default_rng(times)
    carried, colors = [], []
    for _ in range(6):
        found, _ = carried_at(outline @ rotation(rng.uniform(-3, 3)).T + rng.uniform(38, 44, 2), [40.0, 40.0])
        carried.append(found)
        colors.append(np.full((*GRID.shape, 3), TABLE, np.uint8))
    symmetry = found_symmetries(np.stack(colors), carried)
    assert symmetry.tolist() == [times] * 6
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_symmetries(symmetry, np.stack(colors), carried, "recorded")
    if times == 1:
        with pytest.warns(
            BaggieWarning, match="look the same 4 times a turn, as the symmetry given says, got one"
        ):
            check_symmetries(np.full(6, 4), np.stack(colors), carried, "given")


def test_a_mark_in_its_colours_makes_a_thing_look_another_way():
    square = shape(4, 10.0, 0.15, [40.0, 40.0])
    carried, _ = carried_at(square, [40.0, 40.0])
    color = np.full((*GRID.shape, 3), TABLE, np.uint8)
    assert found_symmetries(color[None], [carried]).tolist() == [4]
    color[34:47, 34:39] = (250, 240, 30)
    assert found_symmetries(color[None], [carried]).tolist() == [1]
    assert found_symmetries(color[None], [None]).tolist() == [1]


# --- what is taught


def demonstrations(picks_off: float, seed: int, symmetry: int = 4, count: int = 4) -> Demonstrations:
    """Squares picked off their middles and put into a ring, as anybody may show it; symmetry said."""
    rng = np.random.default_rng(seed)
    heights, poses, carried = [], [], []
    ring = drawn(shape(0, 22.0, 0.0, [85.0, 85.0]), 0.01)
    ring[drawn(shape(0, 15.0, 0.0, [85.0, 85.0])) > 0] = 0
    for _ in range(count):
        middle = rng.uniform(30, 45, 2)
        outline = shape(4, 8.0, 0.15) @ rotation(rng.uniform(-3, 3)).T + middle
        turn, way = rng.uniform(-3, 3), rng.uniform(-3, 3)
        pick = middle + picks_off * np.array([math.cos(way), math.sin(way)])
        places = np.array([pick, [85.0, 85.0] + rotation(turn) @ (pick - middle)])
        before = drawn(outline, onto=ring)
        found = Carried.between(before, drawn(after(outline, places, turn), onto=ring), places, turn)
        (px, py), (qx, qy) = GRID.to_robot(places)
        heights.append(before)
        poses.append([px, py, 0.0, qx, qy, turn])
        carried.append(found)
    colors = np.full((count, *GRID.shape, 3), TABLE, np.uint8)
    return Demonstrations(
        colors, np.stack(heights), np.array(poses), np.full(count, symmetry), GRID, carried=carried
    )


@given(st.integers(0, 10**6))
def test_shown_at_the_rim_the_same_is_taught_as_at_the_middle(seed):
    at_rim, at_middle = (demonstrations(off, seed).by_the_thing().poses for off in (6.0, 0.0))
    assert at_rim == pytest.approx(at_middle, abs=1.5 * GRID.pixel_m)


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 10**6), st.booleans())
def test_what_is_learned_puts_the_thing_where_it_was_shown(seed, by_the_thing):
    """For the cup and for the hand: pick, least turn and place of a sample put the middle where it was put."""
    shown = demonstrations(5.0, seed)
    recipe = TransporterRecipe(shown)
    if not by_the_thing:  # picked where it was shown, as fingers pick
        recipe._maps = MovedMaps(shown, Moves(), 0.5)
    rng = np.random.default_rng(seed)
    for number in range(len(recipe._maps)):
        moved = recipe._maps.draw(rng, [number])[0]
        u, v, turn = recipe._target(moved, np.zeros(2))
        assert abs(turn) <= math.pi / 4 + 1e-9
        ends = place_of(moved.middle, np.array([moved.places[0], [u, v]]), turn)
        right = place_of(moved.middle, moved.places, float(moved.yaws[1] - moved.yaws[0]))
        assume(((np.array([u, v]) > 0) & (np.array([u, v]) < 127)).all())
        assert ends == pytest.approx(right, abs=1e-6)
        things = ObjectMap.on(moved.height)
        assert things.at(moved.places[:1])[0] > 0
        if ((right > 24) & (right < 104)).all():  # the ring is on the map, too
            lies = np.hypot(*(np.mgrid[:128, :128][::-1] - right[:, None, None])) < 8
            assert place_belongs_to(things, moved.color, lies)  # it came along


@pytest.mark.parametrize(("off", "fold", "alike"), [(0.0, 4, [4, 4]), (5.0, 2, [2, 2])])
def test_a_square_held_beside_its_middle_by_fingers_is_held_otherwise_after_a_quarter_turn(off, fold, alike):
    shown = demonstrations(off, 1)
    turned = replace(shown, poses=shown.poses + np.array([0, 0, 0.4, 0, 0, 0.4]))
    recipe = TransporterRecipe(turned, TransporterOptions(batch=2))
    config = recipe.policy.network.config
    assert config.pick_yaw
    assert (config.symmetry, config.pick_fold) == (4, fold)
    assert TransporterConfig.of(config.config()) == config
    batch = recipe.batch(np.random.default_rng(0))
    assert batch["grasps"].tolist() == alike
    assert batch["symmetry"].tolist() == [4, 4]
    loss, _ = recipe.loss(recipe.policy.network, batch)
    assert torch.isfinite(loss)


@given(st.integers(0, 10**6), st.integers(0, 3))
def test_every_label_stays_on_the_map(seed, number):
    maps = MovedMaps(demonstrations(7.0, 3), Moves(), 1.0)
    moved = maps.draw(np.random.default_rng(seed), [number])[0]
    assert ((moved.places >= 2) & (moved.places <= 125)).all()
