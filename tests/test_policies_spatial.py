"""The geometry inside the keypoint policy: points from heat maps, the map to the robot, angles as phases."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from baggie.collect.machine import detect
from baggie.commissioning.image_to_robot import calibrate
from baggie.errors import DataError
from baggie.geometry import PlanarPose, apply_homography
from baggie.policies.keypoint import heads as phase
from baggie.policies.keypoint import heads as planar_map
from baggie.policies.keypoint.heads import (
    PlanarMap,
    gaussians,
    heat_maps,
    local_soft_argmax,
    near_only,
    soft_argmax,
)
from baggie.policies.planning import CELLS_TO_INPUT, GoalInput, Reading, View, keypoint_plan, place_yaw
from baggie.sim.variety import BAGS_M
from baggie.types import LAYER_M, Goal, Observation
from baggie.workcell.workcell import WorkcellSettings
from helpers import fake_workcell
from helpers.synthetic import BAG_HEIGHT_M, BAG_SIDE_M, WORKSPACE, box_corners, to_pixels

numbers = st.floats(-0.25, 0.25)


@given(st.floats(12, 28), st.floats(10, 18), st.floats(0.7, 2.0))
def test_soft_argmax_recovers_a_gaussians_centre(u, v, sigma):
    centre = torch.tensor([[[u, v]]])
    for heat in (
        gaussians(centre, sigma, 28, 40),
        heat_maps(gaussians(centre, sigma, 28, 40).clamp_min(1e-30).log()),
    ):
        assert heat.sum().item() == pytest.approx(1, abs=1e-4)
        assert soft_argmax(heat)[0, 0].tolist() == pytest.approx([u, v], abs=0.01)


@given(st.floats(10, 16), st.floats(10, 16), st.floats(28, 34), st.floats(8, 20))
def test_something_alike_further_away_does_not_pull(u, v, other_u, other_v):
    centre, other = torch.tensor([[[u, v]]]), torch.tensor([[[other_u, other_v]]])
    logits = (gaussians(centre, 1.5, 28, 40) + 0.6 * gaussians(other, 1.5, 28, 40)).clamp_min(1e-30).log()
    assert local_soft_argmax(logits, 6.0)[0, 0].tolist() == pytest.approx([u, v], abs=0.1)
    pointed_at = near_only(logits, other + torch.tensor([2.0, -1.0]), 8.0)
    assert local_soft_argmax(pointed_at, 6.0)[0, 0].tolist() == pytest.approx([other_u, other_v], abs=0.1)


def rectangle(yaw: float, length: float, width: float) -> np.ndarray:
    corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * [length / 2, width / 2]
    c, s = math.cos(yaw), math.sin(yaw)
    return corners @ np.array([[c, s], [-s, c]]) + [0.5, 0.1]


@given(st.floats(-math.pi, math.pi), st.floats(-math.pi / 4, math.pi / 4), st.integers(0, 3))
def test_a_place_lies_along_the_goal_and_turns_the_hand_least(goal_yaw, pick_yaw, first_corner):
    square = np.roll(rectangle(goal_yaw, 0.12, 0.12), first_corner, axis=0)
    yaw = place_yaw(square, 4, pick_yaw)
    assert math.remainder(yaw - goal_yaw, math.pi / 2) == pytest.approx(0, abs=1e-6)
    assert abs(yaw - pick_yaw) <= math.pi / 4 + 1e-6
    long = np.roll(rectangle(goal_yaw, 0.18, 0.11), first_corner, axis=0)
    yaw = place_yaw(long, 2, pick_yaw)
    assert math.remainder(yaw - goal_yaw, math.pi) == pytest.approx(0, abs=1e-6)
    assert abs(yaw - pick_yaw) <= math.pi / 2 + 1e-6


def sheared(corners: np.ndarray, shear_deg: float, towards: float) -> np.ndarray:
    """Corners moved along the direction `towards`, radians, the farther the more they lie to its left."""
    ahead = np.array([math.cos(towards), math.sin(towards)])
    left = (corners - corners.mean(axis=0)) @ [-ahead[1], ahead[0]]
    return np.asarray(corners + math.tan(math.radians(shear_deg)) * left[:, None] * ahead)


@given(
    st.floats(-math.pi, math.pi),
    st.floats(-10, 10),
    st.floats(-math.pi, math.pi),
    st.floats(0.9, 1.1),
    st.sampled_from([2, 4]),
)
def test_a_sheared_outline_is_no_long_one_and_turns_little(
    goal_yaw: float, shear_deg: float, towards: float, ratio: float, symmetry: int
) -> None:
    """A tall thing's outline on the table is; a network may take it for long."""
    seen = sheared(rectangle(goal_yaw, 0.065 * ratio, 0.065), shear_deg, towards)
    off = math.remainder(place_yaw(seen, symmetry, 0.0) - goal_yaw, math.pi / 2)
    assert abs(math.degrees(off)) < 6.5


@given(st.floats(-math.pi, math.pi), st.floats(-10, 10), st.floats(-math.pi, math.pi))
def test_a_sheared_long_outline_stays_along_its_long_side(
    goal_yaw: float, shear_deg: float, towards: float
) -> None:
    seen = sheared(rectangle(goal_yaw, 0.18, 0.11), shear_deg, towards)
    off = math.remainder(place_yaw(seen, 2, 0.0) - goal_yaw, math.pi)
    assert abs(math.degrees(off)) < 10


def test_a_tall_thing_from_aslant_is_put_down_as_straight_as_the_colour_mask_does(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Its outline shows a side of it, too: on the table, a sheared square."""
    intrinsics, _ = fake_workcell.tilted_camera((640, 360))
    position, aim = np.array([1.0, -0.5, 1.2]), np.array([0.5, 0.0, 0.0])
    forward = (aim - position) / np.linalg.norm(aim - position)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    transform = np.r_[np.c_[rotation, -rotation @ position], [[0.0, 0.0, 0.0, 1.0]]]
    monkeypatch.setattr(fake_workcell, "tilted_camera", lambda size: (intrinsics, transform))
    cell = fake_workcell.FakeCell(WorkcellSettings(object_size_m=(0.065, 0.065, 0.065)))
    to_robot = calibrate(cell, 0)
    off = []
    for seed in range(30):
        cell.reset((seed,))
        found, pose = detect(cell.look(), to_robot, cell.settings) or pytest.fail("not seen")
        yaws = place_yaw(to_robot.to_robot(found.corners), 2, 0.0), pose.yaw
        off.append([abs(math.degrees(math.remainder(yaw - cell.bag.yaw, math.pi / 2))) for yaw in yaws])
    ours, colour_mask = np.mean(off, axis=0)
    assert ours < 4
    assert ours < colour_mask + 1


def drawn_pairs(count: int, noise_m: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Points of a tilted, distorted camera, normalised, and where they are on a plane, noisy."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform([0.35, -0.25], [0.65, 0.25], (count, 2))
    pixels = to_pixels(np.c_[xy, np.full(count, BAG_HEIGHT_M / 2)], (640, 360))
    view = View((640, 360), 0, 0, 640, 360, (160, 88))
    return apply_homography(view.normalize(), pixels), xy + rng.normal(0, noise_m / math.sqrt(2), (count, 2))


def test_fit_sees_through_label_noise():
    points, noisy = drawn_pairs(200, 0.005)
    noisy[:5] += 0.1  # five bags that were dropped on the way
    to_robot = PlanarMap()
    to_robot.fit(points, noisy)
    fresh, xy = drawn_pairs(200, 0.0, seed=1)
    with torch.no_grad():
        error_m = (to_robot(torch.from_numpy(fresh).float()).numpy() - xy) ** 2
    assert np.sqrt(error_m.sum(axis=1)).mean() < 0.0015  # of 5 mm of noise


def test_fit_without_noise_is_exact_to_a_tenth_of_a_millimetre():
    points, xy = drawn_pairs(100, 0.0)
    assert np.linalg.norm(PlanarMap().fit(points, xy, noise_m=1e-5), axis=1).max() < 1e-4


@pytest.mark.parametrize("count", [6, 7])
def test_few_places_said_twice_give_a_plain_map_rather_than_nonsense(count):
    """As in a short recording, where an object is picked up where it was put down before."""
    fresh, truth = drawn_pairs(100, 0.0, seed=1)
    for seed in range(20):
        points, noisy = drawn_pairs(count, 0.002, seed + 2)
        twice = np.r_[np.arange(count), np.arange(1, count - 1)]
        to_robot = PlanarMap()
        to_robot.fit(points[twice], noisy[twice], noise_m=0.002)
        with torch.no_grad():
            off = np.linalg.norm(to_robot(torch.from_numpy(fresh).float()).numpy() - truth, axis=1)
        assert np.median(off) < 0.02, seed


@given(
    st.floats(0.2, 0.8), st.floats(-0.4, 0.4), st.floats(0.7, 1.5), st.floats(-0.15, 0.15), st.floats(-3, 3)
)
@settings(deadline=None, max_examples=20)
def test_labels_of_stacks_tell_where_the_camera_stands_and_a_layer_s_share_of_its_height(
    x: float, y: float, height: float, aside: float, roll: float
) -> None:
    """Of any pinhole camera, which looks about straight down: all layers are right that it was fitted to."""
    foot, table_m = np.array([x, y]), BAG_HEIGHT_M / 2
    forward = np.array([0.5 + aside, -aside, 0.0]) - [x, y, height]
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [math.cos(roll), math.sin(roll), 0.0])
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(forward, right), forward])

    def seen(xy: np.ndarray, layer: np.ndarray) -> np.ndarray:
        """Normalised."""
        rays = (np.c_[xy, table_m + layer * LAYER_M] - [x, y, height]) @ axes.T
        return rays[:, :2] / rays[:, 2:]

    rng = np.random.default_rng(0)
    xy, fresh = rng.uniform([0.3, -0.3], [0.7, 0.3], (2, 200, 2))
    layer = rng.integers(0, 4, 200).astype(float)
    to_robot = PlanarMap().double()
    to_robot.fit(seen(xy, layer), xy, noise_m=1e-5, layer=layer)
    points, above = torch.from_numpy(seen(fresh, layer)), torch.from_numpy(layer)
    with torch.no_grad():
        assert np.linalg.norm(to_robot(points, above).numpy() - fresh, axis=1).max() < 2e-4
        assert torch.allclose(to_robot.inverse(torch.from_numpy(fresh), above), points, atol=1e-3)
        k_foot, k = to_robot.lift[:2].numpy(), to_robot.lift[2].item()
    assert k == pytest.approx(LAYER_M / (height - table_m), rel=0.02)
    np.testing.assert_allclose(k_foot / k, foot, atol=0.01)
    assert to_robot.knows_layers
    assert to_robot.lift.requires_grad


def test_noisy_labels_of_stacks_are_seen_through_and_without_stacks_a_map_is_as_it_was():
    rng = np.random.default_rng(3)
    xy = rng.uniform([0.35, -0.25], [0.65, 0.25], (300, 2))
    layer = rng.choice([0.0, 0.0, 1.0, 2.0], 200)
    noisy = xy[:200] + rng.normal(0, 0.003 / math.sqrt(2), (200, 2))
    view = View((640, 360), 0, 0, 640, 360, (160, 88))

    def seen(xy: np.ndarray, layer: np.ndarray | float) -> np.ndarray:
        pixels = to_pixels(np.c_[xy, BAG_HEIGHT_M / 2 + layer * LAYER_M * np.ones(len(xy))], (640, 360))
        return apply_homography(view.normalize(), pixels)

    stacked, flat, plain = PlanarMap(), PlanarMap(), PlanarMap()
    stacked.fit(seen(xy[:200], layer), noisy, 0.003, layer)
    for number in range(4):
        fresh = torch.from_numpy(seen(xy[200:], number)).float()
        with torch.no_grad():
            off = stacked(fresh, torch.full((100,), float(number))).numpy() - xy[200:]
        assert np.sqrt((off**2).sum(axis=1)).mean() < 0.0015, number
    flat.fit(seen(xy[:200], 0.0), noisy, 0.003, np.zeros(200))
    plain.fit(seen(xy[:200], 0.0), noisy, 0.003)
    assert not flat.knows_layers
    assert not flat.lift.requires_grad
    assert all(torch.equal(value, plain.state_dict()[name]) for name, value in flat.state_dict().items())
    stacked.fit(seen(xy[:200], 0.0), noisy, 0.003)
    assert not stacked.knows_layers, "what was learned from stacks is forgotten with them"


def test_a_map_of_an_older_version_knows_the_table():
    old = bent_map(0)
    state = old.state_dict()
    del state["lift"]
    loaded = PlanarMap().double()
    with torch.no_grad():
        loaded.lift.fill_(0.1)
    loaded.load_state_dict(state)
    assert not loaded.knows_layers
    assert torch.equal(loaded.homography, old.homography)


@pytest.mark.parametrize("count", [0, 3])
def test_too_few_points_for_a_map(count):
    with pytest.raises(DataError, match="at least 4"):
        PlanarMap().fit(np.zeros((count, 2)), np.zeros((count, 2)))


def bent_map(seed: int) -> PlanarMap:
    torch.manual_seed(seed)
    to_robot = PlanarMap().double()
    with torch.no_grad():
        for parameter, spread in (
            (to_robot.homography, 0.1),
            (to_robot.distortion, 0.1),
            (to_robot.center, 0.1),
            (to_robot.lift, 0.05),
        ):
            parameter.add_(spread * torch.randn_like(parameter).clamp(-2, 2))
    return to_robot


@settings(deadline=None)
@given(st.integers(0, 1000), numbers, numbers, st.integers(0, 4))
def test_map_and_its_inverse_undo_each_other(seed, u, v, layer):
    to_robot, point = bent_map(seed), torch.tensor([[u, v]], dtype=torch.float64)
    above = torch.tensor([float(layer)], dtype=torch.float64)
    with torch.no_grad():
        assert torch.allclose(to_robot.inverse(to_robot(point)), point, atol=1e-6)
        assert torch.allclose(to_robot.inverse(to_robot(point, above), above), point, atol=1e-6)
        moved = to_robot(point, above) - to_robot(point)
        # By the same step for each layer, and nothing for none.
        assert torch.allclose(layer * (to_robot(point, torch.ones(1)) - to_robot(point)), moved, atol=1e-12)


@settings(deadline=None)
@given(st.integers(0, 1000), numbers, numbers, st.integers(0, 4))
def test_jacobians_agree_with_automatic_differentiation(seed, u, v, layer):
    to_robot, point = bent_map(seed), torch.tensor([u, v], dtype=torch.float64)
    exact = torch.autograd.functional.jacobian(to_robot, point)
    assert torch.allclose(to_robot.jacobian(point), exact, atol=1e-9)
    above = torch.tensor(float(layer), dtype=torch.float64)
    exact = torch.autograd.functional.jacobian(lambda p: to_robot(p, above), point)
    assert torch.allclose(to_robot.jacobian(point, above), exact, atol=1e-9)
    matrix = to_robot.matrix().detach()
    exact = torch.autograd.functional.jacobian(lambda p: planar_map.apply_homographies(matrix, p), point)
    assert torch.allclose(planar_map.homography_jacobian(matrix, point), exact, atol=1e-9)


@settings(deadline=None)
@given(
    st.floats(-math.pi / 4, math.pi / 4 - 1e-3),
    st.floats(-math.pi, math.pi),
    st.floats(0.75, 1.3),
    st.booleans(),
    st.sampled_from([phase.SQUARE, phase.LONG]),
)
def test_yaw_survives_any_view(yaw, turn, stretch, mirrored, symmetry):
    c, s = math.cos(turn), math.sin(turn)
    rotation = np.array([[c, -s], [s, c]]) @ np.diag([stretch, -1.0 if mirrored else 1.0])
    jacobian = torch.from_numpy(0.004 * rotation)
    angle = torch.tensor(yaw, dtype=torch.float64)
    there = phase.phase_of(angle, jacobian, symmetry)
    assert there.norm().item() == pytest.approx(1)
    back = phase.yaw_of_phase(there, jacobian, symmetry).item()
    assert math.remainder(back - yaw, 2 * math.pi / symmetry) == pytest.approx(0, abs=1e-3)


@given(st.floats(-math.pi, math.pi), st.floats(-math.pi, math.pi))
def test_phase_has_no_seam_and_follows_rotation(yaw, turn):
    c, s = math.cos(turn), math.sin(turn)
    identity, turned = torch.eye(2, dtype=torch.float64), torch.tensor([[c, -s], [s, c]], dtype=torch.float64)
    angle = torch.tensor(yaw, dtype=torch.float64)
    assert torch.allclose(
        phase.phase_of(angle, identity), phase.phase_of(angle + math.pi / 2, identity), atol=1e-6
    )
    # A view turned by some angle shows a yaw as the plain view shows that yaw less the angle.
    assert torch.allclose(phase.phase_of(angle, turned), phase.phase_of(angle - turn, identity), atol=1e-6)


def test_view_coordinates_agree_with_its_pictures():
    view = View.around(np.array([[100.0, 80.0], [420.0, 300.0]]), (640, 360))
    picture = np.zeros((360, 640, 3), np.uint8)
    picture[196:204, 246:254] = 255  # centred at (249.5, 199.5)
    cut = view.cut(picture)[..., 0].astype(float)
    v, u = np.mgrid[: cut.shape[0], : cut.shape[1]]
    centre = np.array([[(cut * u).sum(), (cut * v).sum()]]) / cut.sum()
    assert view.to_input(np.array([[249.5, 199.5]])) == pytest.approx(centre, abs=0.05)
    assert apply_homography(view.from_input(), centre) == pytest.approx(np.array([[249.5, 199.5]]), abs=0.1)
    assert apply_homography(view.normalize(), [[-0.5, 179.5], [639.5, 179.5]]) == pytest.approx(
        np.array([[-1.0, 0.0], [1.0, 0.0]])
    )
    assert view.contains(np.array([[100.0, 80.0]]))
    assert not view.contains(np.array([[10.0, 80.0]]))


@given(st.floats(0.40, 0.60), st.floats(-0.20, 0.20), st.floats(-math.pi, math.pi))
def test_what_is_pointed_at_is_looked_for_as_far_as_its_middle_and_no_further_than_the_next_bag(x, y, way):
    size = (640, 360)
    edges = [[u, v] for u in (WORKSPACE.x_min, WORKSPACE.x_max) for v in (WORKSPACE.y_min, WORKSPACE.y_max)]
    view = View.around(to_pixels(np.c_[edges, np.full(4, BAG_HEIGHT_M)], size), size)
    asked = []

    def read(images, near, corners, layers):
        asked.append(near)
        share = np.ones(2, np.float32)
        return Reading(np.zeros((2, 2)), 0.0, 4.0, share, share, np.ones((2, 4, 4), np.float32), corners)

    def cell_of(dx, dy):
        pixel = to_pixels(np.array([[x + dx, y + dy, BAG_HEIGHT_M / 2]]), size)
        return apply_homography(np.linalg.inv(view.from_input() @ CELLS_TO_INPUT), pixel)[0]

    goal = Goal(box_corners(PlanarPose(0.5, 0.0), size))
    pointed = to_pixels(np.array([[x, y, BAG_HEIGHT_M / 2]]), size)[0]
    picture = Observation(np.zeros((360, 640, 3), np.uint8))
    keypoint_plan(
        read, view, GoalInput(), picture, Goal(goal.corners, object_at=tuple(pointed)), camera_size=size
    )
    keypoint_plan(read, view, GoalInput(), picture, goal, camera_size=size)
    (u, v, radius), (_, _, anywhere) = asked
    np.testing.assert_allclose([u, v], cell_of(0.0, 0.0), atol=1e-3)
    towards = np.array([math.cos(way), math.sin(way)])
    assert np.linalg.norm(cell_of(*(BAG_SIDE_M / 2 * towards)) - [u, v]) < radius
    assert np.linalg.norm(cell_of(*(BAGS_M * towards)) - [u, v]) > radius
    assert anywhere > max(view.size)


@pytest.mark.parametrize("kind", ["region", "painted"])
def test_a_real_card_is_no_bag_to_a_network_that_never_saw_one(kind):
    """Where goals are regions, a card's look makes no difference; where they are painted, it has to be seen."""
    cut = np.full((96, 160, 3), 128, np.uint8)
    corners = np.array([[60.0, 40.0], [80.0, 40.0], [80.0, 60.0], [60.0, 60.0]])
    inputs = []
    for color in ((30, 110, 50), (200, 40, 40)):
        seen = cut.copy()
        seen[40:61, 60:81] = color
        inputs.append(GoalInput(kind).network_input(seen, Goal(corners, "card", color)))
    assert (inputs[0] == inputs[1]).all() == (kind == "region")
    if kind == "region":
        assert (inputs[0] == GoalInput().network_input(cut, Goal(corners))).all()
