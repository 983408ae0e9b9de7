"""Bags of other shapes and cloths, and sceneries in the simulator."""

import hashlib
from collections.abc import Iterator
from contextlib import closing
from typing import Any

import cv2
import mujoco
import numpy as np
import pytest

from baggie.errors import BaggieError
from baggie.geometry import PlanarPose, wrap_angle
from baggie.options.values import Scenery
from baggie.sim.bag import Bag, cloth, pillow
from baggie.sim.cell import draw_cell
from baggie.sim.scene import build_model
from baggie.sim.variety import Distractor
from baggie.sim.world import World
from baggie.types import PickPlace
from baggie.vision.color_mask import find_bag
from baggie.workcell.simulated import SimulatedWorkcell, open_simulated

CUP = Distractor("cup", PlanarPose(0.5, 0.2), (0.07, 0.07, 0.07), (30, 60, 200))
COASTER = Distractor("coaster", PlanarPose(0.5, 0.0), (0.1, 0.1, 0.0), (30, 60, 200))


@pytest.fixture(scope="module")
def unseen() -> Iterator[SimulatedWorkcell]:
    cell = open_simulated(0, scenery="unseen")
    yield cell
    cell.close()


@pytest.fixture(scope="module")
def two_bags() -> Iterator[SimulatedWorkcell]:
    cell = open_simulated(0, scenery="two-bags")
    yield cell
    cell.close()


# what recordings made before depend on


def test_the_default_bag_is_to_the_letter_what_it_was() -> None:
    written = hashlib.sha256(Bag().xml().replace("bag_cloth", "cloth").encode()).hexdigest()
    assert written.startswith("b653cad32ba05f8a")


def test_the_default_cloth_is_to_the_byte_what_it_was() -> None:
    v, u = np.mgrid[:128, :128]
    threads = np.sin(u * 2 * np.pi / 8) * np.sin(v * 2 * np.pi / 8)
    mottle = cv2.resize(
        np.random.default_rng(1).normal(size=(8, 8)), (128, 128), interpolation=cv2.INTER_CUBIC
    )
    edge = np.minimum(np.minimum(u, v), np.minimum(127 - u, 127 - v))
    seam = -1.5 * np.exp(-(((edge - 8) / 2.0) ** 2))
    shade = 1 + 0.12 * (0.5 * threads + 0.3 * mottle + seam)
    expected = np.clip(np.array((196, 40, 44)) * shade[..., None], 0, 255).astype(np.uint8)
    np.testing.assert_array_equal(cloth(np.random.default_rng(1), Bag()), expected)


def test_what_is_not_asked_for_is_not_in_the_model() -> None:
    plain = build_model(draw_cell(0), [Bag()])
    assert plain.nflex == 1
    everything = build_model(draw_cell(0), [Bag(), Bag(name="second")], distractors=[CUP, COASTER])
    assert everything.nflex == 2
    assert everything.nv - plain.nv == plain.nv - 9  # the arm's seven joints and two fingers are not doubled
    assert everything.ngeom == plain.ngeom + 3  # a cup is two: what is in it has another colour
    collide = everything.geom_contype != 0
    assert collide.sum() == (plain.geom_contype != 0).sum() + 2  # and a coaster touches nothing


# bags of other shapes


def test_a_round_pillow_is_closed_and_round() -> None:
    points, tetrahedra = pillow(Bag(shape="round"))
    edges = points[tetrahedra[:, 1:]] - points[tetrahedra[:, :1]]
    assert (np.linalg.det(edges) > 0).all()
    assert set(tetrahedra.ravel()) == set(range(len(points)))
    radius = np.hypot(*points[:, :2].T)
    seam = np.abs(points[:, 2]) < 1e-9
    np.testing.assert_allclose(radius[seam], 0.06)
    assert (radius[~seam] < 0.06).all()


@pytest.mark.parametrize("fabric", ["stripes", "checks", "dots"])
def test_a_print_shows_both_colours_and_repeats(fabric: str) -> None:
    bag = Bag(fabric=fabric, accent=(0, 0, 250), repeat_m=0.03, weave=0.0)
    picture = cloth(np.random.default_rng(0), bag)
    blue = (picture == (0, 0, 250)).all(axis=2)
    assert ((picture == bag.color).all(axis=2) | blue).all()
    assert 0.15 < blue.mean() < 0.6
    np.testing.assert_array_equal(blue[32:], blue[:-32])  # 128 pixels are 12 cm


@pytest.mark.parametrize(
    "bag",
    [
        pytest.param(Bag(length_m=0.14, width_m=0.14, shape="round"), marks=pytest.mark.slow),
        Bag(length_m=0.16, width_m=0.1, shape="long"),
    ],
)
def test_a_bag_of_another_shape_is_gripped_and_lands_where_it_is_put(bag: Bag) -> None:
    with closing(SimulatedWorkcell(0, things=[bag])) as cell:
        assert cell.settings.object_symmetry == bag.symmetry
        assert cell.world.bodies["bag"].points[:, 2].max() == pytest.approx(bag.size_m[2], abs=0.004)
        start = cell.truth()
        pick = PlanarPose(start.x, start.y, wrap_angle(start.yaw, np.pi))
        goal = PlanarPose(0.5, -0.15 if start.y > 0 else 0.15, 0.0)
        assert cell.execute(PickPlace(pick, goal)).success
        assert cell.truth().distance(goal) < 0.03


# sceneries


def test_at_yaw_0_the_fingers_close_along_y_which_is_across_a_long_bag_at_yaw_0(
    two_bags: SimulatedWorkcell,
) -> None:
    two_bags.reset((2,))
    two_bags.arm.move_to(PlanarPose(0.5, 0.0, 0.0).at_height(0.3), 0.8)
    data = two_bags.world.data
    apart = data.body("arm_left_finger").xpos - data.body("arm_right_finger").xpos
    assert abs(apart[1]) > 0.05
    assert np.abs(apart[[0, 2]]).max() < 0.003
    assert np.ptp(pillow(Bag(length_m=0.15, shape="long"))[0], axis=0)[:2] == pytest.approx([0.15, 0.12])


def test_a_scene_is_the_same_to_the_byte_whatever_came_before(unseen: SimulatedWorkcell) -> None:
    def scene(seed: int) -> tuple[np.ndarray, PlanarPose, object]:
        unseen.reset((7, seed))
        return unseen.look().color, unseen.truth(), unseen.settings

    first, other, again = scene(0), scene(1), scene(0)
    np.testing.assert_array_equal(first[0], again[0])
    assert first[1:] == again[1:]
    assert first[2] != other[2]


@pytest.mark.parametrize("scenery", ["plain", "two-bags"])
def test_opening_builds_one_world_and_shows_its_first_scene(
    scenery: Scenery, monkeypatch: pytest.MonkeyPatch
) -> None:
    built = []

    def counted(*args: Any, **named: Any) -> World:
        built.append(World(*args, **named))
        return built[-1]

    monkeypatch.setattr("baggie.workcell.simulated.World", counted)
    with closing(open_simulated(0, scenery=scenery)) as cell:
        assert built == [cell.world]
        opened = cell.look().color
        cell.reset((0,))
        assert len(built) == (1 if scenery == "plain" else 2)
        np.testing.assert_array_equal(cell.look().color, opened)


def test_settings_arm_and_outline_follow_the_bag_at_hand(unseen: SimulatedWorkcell) -> None:
    for seed in range(2):
        unseen.reset((8, seed))
        settings, bag = unseen.settings, unseen.world.things["bag"]
        assert settings.object_color == bag.color
        assert settings.object_size_m == bag.size_m
        assert settings.object_symmetry == bag.symmetry
        assert all(unseen.truth().distance(thing) >= 0.16 for thing in unseen.state().obstacles)
        found = find_bag(unseen.look().color, bag.color)
        assert found is not None
        corners = unseen.outline(unseen.truth())
        assert np.linalg.norm(found.center - corners.mean(axis=0)) < 4.0
        sides = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1)
        filled = found.area_px / (sides[0] * sides[1])
        assert 0.65 < filled < 1.1
    before = unseen.world.time
    unseen.arm.move_to(PlanarPose(0.5, 0.0).at_height(0.3), 0.5)
    assert unseen.world.time > before  # it moves in this world, and not in one before
    assert unseen.arm.pose().z == pytest.approx(0.3, abs=0.003)


def second_of(cell: SimulatedWorkcell) -> PlanarPose:
    (second,) = cell.scene.staying
    return cell.state().places[second]


def test_a_lost_bag_is_laid_back_clear_of_the_second(two_bags: SimulatedWorkcell) -> None:
    two_bags.reset((1,))
    second = second_of(two_bags)
    assert two_bags.truth().distance(second) > 0.175  # laid 18 cm apart, and settled
    two_bags.world.bodies["bag"].put(PlanarPose(0.0, 0.6), height_m=0.1, undented=True)
    assert two_bags.rescue()
    assert two_bags.truth().distance(second) > 0.15


def test_laid_as_new_a_bag_leaves_the_other_its_dents(two_bags: SimulatedWorkcell) -> None:
    two_bags.reset((2,))
    dents = two_bags.world.data.plastic
    dents[:] = 0.3
    two_bags.world.put("bag", PlanarPose(0.0, 0.6), undented=True)
    assert (np.count_nonzero(dents), len(dents)) == (96, 192)


def test_the_second_bag_stays_when_the_first_is_moved(two_bags: SimulatedWorkcell) -> None:
    two_bags.reset((3,))
    start, second = two_bags.truth(), second_of(two_bags)
    places = [PlanarPose(x, y) for x in (0.4, 0.5, 0.6) for y in (-0.2, 0.0, 0.2)]
    goal = max(places, key=lambda pose: min(pose.distance(second), pose.distance(start)))
    pick = PlanarPose(start.x, start.y, wrap_angle(start.yaw, np.pi / 2))
    assert two_bags.execute(PickPlace(pick, goal)).success
    assert two_bags.truth().distance(goal) < 0.03
    now = second_of(two_bags)
    assert now.distance(second) < 0.003
    seen = find_bag(two_bags.look().color, two_bags.world.things["bag"].color)
    assert seen is not None
    middle = two_bags.outline(two_bags.truth()).mean(axis=0)
    assert np.linalg.norm(seen.center - middle) < 6.0  # of the two, the one to be moved


def test_a_plain_cell_has_nothing_else_on_it_and_can_be_bumped_as_no_other(
    two_bags: SimulatedWorkcell,
) -> None:
    with pytest.raises(BaggieError, match="scenery='plain'"):
        two_bags.bump_camera([0.01, 0, 0], [0, 0, 0])
    with pytest.raises(BaggieError, match="got the scenery 'two-bags'"):
        two_bags.bump_table(0.01, 0.0, 0.0)


def test_what_stands_stops_a_bag_and_what_lies_does_not() -> None:
    def height_of_a_bag_laid_on(thing: Distractor) -> float:
        world = World(draw_cell(0), distractors=[thing])
        world.bodies["bag"].put(thing.pose, height_m=0.12, undented=True)
        world.advance(1.0)
        mujoco.mj_forward(world.model, world.data)
        return float(world.bodies["bag"].points[:, 2].max())

    assert height_of_a_bag_laid_on(CUP) > 0.06
    assert height_of_a_bag_laid_on(COASTER) < 0.04
