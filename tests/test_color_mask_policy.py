from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from baggie.calibration.files import CameraIdentity
from baggie.calibration.image_to_robot.map import ImageToRobot
from baggie.commissioning.image_to_robot import grid
from baggie.errors import BaggieError, DataError
from baggie.geometry import PlanarPose, wrap_angle
from baggie.policies.baselines import ColorMaskPolicy
from baggie.types import LAYER_M, Goal, Observation
from helpers.fake_workcell import FakeCell

SIZE = (640, 360)
BAG_Z = 0.018


@pytest.fixture(scope="module")
def cell() -> FakeCell:
    return FakeCell(size=SIZE)


@pytest.fixture(scope="module")
def policy(cell: FakeCell) -> ColorMaskPolicy:
    robot = grid(cell.settings.workspace, 0.02, (BAG_Z,))
    fitted = ImageToRobot.fit(cell.camera.project(robot), robot, CameraIdentity("top", *SIZE))
    return ColorMaskPolicy(fitted, cell.settings.object_color)


def goal_at(cell: FakeCell, pose: PlanarPose, z: float = BAG_Z) -> Goal:
    square = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * 0.06
    table = np.c_[square, np.ones(4)] @ pose.matrix().T
    return Goal(cell.camera.project(np.c_[table[:, :2], np.full(4, z)]))


def test_a_map_of_all_heights_places_on_stacks_and_one_of_the_table_does_not(cell, policy):
    cell.reset((4,))
    target = PlanarPose(0.42, 0.2, 0.3)
    goal = replace(goal_at(cell, target, 2.5 * LAYER_M), layer=2)
    with pytest.raises(BaggieError, match="fitted at one height only") as error:
        policy.plan(cell.look(), goal)
    assert "\n" not in str(error.value)
    robot = np.concatenate([grid(cell.settings.workspace, 0.02, (z,)) for z in (BAG_Z, 0.1)])
    fitted = ImageToRobot.fit(cell.camera.project(robot), robot, CameraIdentity("top", *SIZE))
    action = ColorMaskPolicy(fitted, policy.object_color).plan(cell.look(), goal).action
    assert action.place.distance(target) < 0.002
    assert (action.pick_on_m, action.place_on_m) == (0.0, 2 * LAYER_M)
    lower = ColorMaskPolicy(fitted, policy.object_color).plan(cell.look(), replace(goal, layer=0)).action
    assert lower.place.distance(target) > 0.004
    lifted = ColorMaskPolicy(fitted, policy.object_color).plan(cell.look(), replace(goal, object_layer=1))
    assert lifted.action.pick_on_m == LAYER_M
    assert lifted.action.pick.distance(action.pick) > 0.001


@settings(max_examples=15, deadline=None)
@given(st.tuples(st.floats(0.4, 0.6), st.floats(-0.25, 0.25), st.floats(-0.6, 0.6)), st.integers(0, 1000))
def test_plans_from_the_bag_to_the_goal(cell, policy, pose, scene):
    cell.reset((scene,))
    x, y, yaw = pose
    target = PlanarPose(x, y, yaw)
    plan = policy.plan(cell.look(), goal_at(cell, target))
    assert plan.action.pick.distance(cell.bag) < 0.005
    assert abs(wrap_angle(plan.action.pick.yaw - cell.bag.yaw, np.pi / 2)) < np.deg2rad(4)
    assert plan.action.place.distance(target) < 0.002
    assert abs(wrap_angle(plan.action.place.yaw - yaw, np.pi / 2)) < np.deg2rad(2)
    assert 0.7 < plan.confidence <= 1.0
    assert plan.views["pick"].shape == (SIZE[1], SIZE[0])


def test_of_two_bags_it_takes_the_one_that_is_pointed_at(cell, policy):
    bags = PlanarPose(0.42, -0.2), PlanarPose(0.58, 0.15)
    picture = np.full((SIZE[1], SIZE[0], 3), 140, np.uint8)
    outlines = [goal_at(cell, bag) for bag in bags]
    for outline in outlines:
        cv2.fillPoly(picture, [outline.corners.round().astype(np.int32)], cell.settings.object_color)
    goal = goal_at(cell, PlanarPose(0.5, 0.0))
    for bag, outline in zip(bags, outlines, strict=True):
        plan = policy.plan(Observation(picture), replace(goal, object_at=tuple(outline.center + 3.0)))
        assert plan.action.pick.distance(bag) < 0.003
        u, v = outline.center.round().astype(int)
        assert plan.views["pick"][v, u] == 1.0  # both are seen, whichever is taken


def test_smaller_pictures_of_the_same_camera_will_do(cell, policy):
    cell.reset((3,))
    seen, goal = cell.look(), goal_at(cell, PlanarPose(0.5, 0.1))
    full, half = policy.plan(seen, goal), policy.plan(seen.resized(320, 180), goal.scaled(0.5, 0.5))
    assert full.action.pick.distance(half.action.pick) < 0.002
    assert full.action.place.distance(half.action.place) < 1e-9
    with pytest.raises(BaggieError, match="640 x 360"):
        policy.plan(seen.resized(640, 480), goal)


def test_says_when_there_is_no_bag_or_the_goal_is_outside(cell, policy):
    goal = goal_at(cell, PlanarPose(0.5, 0.0))
    with pytest.raises(BaggieError, match="found none"):
        policy.plan(Observation(np.full((360, 640, 3), 140, np.uint8)), goal)
    with pytest.raises(BaggieError, match="inside the picture"):
        policy.plan(cell.look(), Goal(goal.corners + np.array([700, 0])))


def test_loading_another_policys_folder_is_one_clear_line(tmp_path):
    (tmp_path / "config.yaml").write_text("policy: keypoint\n")
    for folder in (tmp_path, tmp_path / "none"):
        with pytest.raises(DataError, match=r"config\.yaml") as caught:
            ColorMaskPolicy.load(folder)
        assert "\n" not in str(caught.value)
