from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from itertools import pairwise

import cv2
import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from hypothesis import given
from hypothesis import strategies as st

import baggie  # noqa: F401 -- registers the environments
from baggie.errors import LimitError, ReachError
from baggie.geometry import PlanarPose, Rectangle, ToolPose, wrap_angle
from baggie.robot.contract import check_arm
from baggie.robot.franka.models import HOME
from baggie.robot.kinematics import Kinematics, quintic
from baggie.sim.arm import JOINT_SPEED_LIMITS
from baggie.sim.bag import Bag, pillow
from baggie.sim.cell import draw_cell
from baggie.sim.scene import arm_spec
from baggie.sim.sensor import Exposure, Sensor
from baggie.types import PickPlace
from baggie.workcell.simulated import SimulatedWorkcell, open_simulated
from baggie.workcell.workcell import WorkcellSettings
from helpers.carries import carries_in, check_reached


@pytest.fixture(scope="module")
def cell() -> Iterator[SimulatedWorkcell]:
    cell = open_simulated(0)
    yield cell
    cell.close()


def test_the_simulated_arm_keeps_the_contract(cell: SimulatedWorkcell) -> None:
    cell.reset((1,))
    cell.world.put("bag", PlanarPose(0.2, 0.55), undented=True)
    cell.world.block.lay(PlanarPose(0.49, 0.0), 0.04)
    pressed = []
    cell.world.watchers.append(lambda: pressed.append(cell.world.block.pressed_n))
    force, _ = check_arm(cell.arm, firm_height_m=0.04, clock=cell.clock)
    assert force == "force: felt 3 times at z 49 mm, on a thing of 40 mm"
    cell.world.watchers.clear()
    assert 8 < max(pressed) < 100


def test_a_bag_is_picked_carried_and_put_down(cell: SimulatedWorkcell) -> None:
    cell.reset((3,))
    start = cell.truth()
    goal = PlanarPose(0.5, -0.15 if start.y > 0 else 0.15, 0.0)
    pick = PlanarPose(start.x, start.y, wrap_angle(start.yaw, np.pi / 2))
    outcome = cell.execute(PickPlace(pick, goal))
    assert outcome.success
    assert outcome.executed.pick.distance(pick) < 0.002
    assert cell.truth().distance(goal) < 0.03
    assert cell.world.bodies["bag"].points[:, 2].max() < 0.06  # it lies flat again


def test_a_grasp_beside_the_bag_is_noticed(cell: SimulatedWorkcell) -> None:
    cell.reset((4,))
    start = cell.truth()
    beside = PlanarPose(0.5, start.y - 0.2 if start.y > 0 else start.y + 0.2)
    outcome = cell.execute(PickPlace(beside, PlanarPose(0.5, 0.0)))
    assert outcome.failure == "missed-grasp"
    assert cell.truth().distance(start) < 0.005


def test_the_same_seed_gives_the_same_pictures_and_motion(cell: SimulatedWorkcell) -> None:
    def scene(seed: int) -> tuple[np.ndarray, np.ndarray, PlanarPose]:
        cell.reset((5, seed))
        observation = cell.look()
        assert observation.depth is not None
        return observation.color, observation.depth, cell.truth()

    first, again, other = scene(0), scene(0), scene(1)
    assert first[2] == again[2] != other[2]
    np.testing.assert_array_equal(first[0], again[0])
    np.testing.assert_array_equal(first[1], again[1])
    assert not np.array_equal(first[0], other[0])


def test_the_true_outline_is_where_the_bag_is_seen(cell: SimulatedWorkcell) -> None:
    cell.reset((6,))
    color = cell.look().color.astype(int)
    red = color[..., 0] - color[..., 1:].max(axis=2) > 30
    v, u = np.nonzero(red)
    middle = cell.outline(cell.truth()).mean(axis=0)
    np.testing.assert_allclose([u.mean(), v.mean()], middle, atol=4.0)


def test_the_goal_card_is_seen_where_it_lies_until_it_is_taken_away(cell: SimulatedWorkcell) -> None:
    def green_pixels() -> np.ndarray:
        color = cell.look().color.astype(int)
        return np.argwhere(color[..., 1] - color[..., [0, 2]].max(axis=2) > 30)[:, ::-1]

    cell.reset((11,))
    at = PlanarPose(0.5, -0.2 if cell.truth().y > 0 else 0.2, 0.3)
    cell.lay_card(at)
    expected = cell.world.cell.project(np.array([[at.x, at.y, 0.0]]))[0]
    np.testing.assert_allclose(green_pixels().mean(axis=0), expected, atol=2.0)
    cell.lay_card(None)
    assert len(green_pixels()) < 20


def test_depth_is_the_distance_to_the_table(cell: SimulatedWorkcell) -> None:
    cell.reset((7,))
    depth = cell.look().depth
    spot = np.array([0.5, -0.3 if cell.truth().y > 0 else 0.3, 0.0])
    u, v = cell.world.cell.project(spot[None])[0].round().astype(int)
    along_axis = (cell.world.cell.T_camera_base @ [*spot, 1.0])[2]
    assert depth is not None
    assert np.median(depth[v - 3 : v + 4, u - 3 : u + 4]) == pytest.approx(along_axis, abs=0.003)


def test_an_unreachable_or_forbidden_place_is_refused_before_anything_moves(cell: SimulatedWorkcell) -> None:
    cell.reset((8,))
    before = cell.arm.pose()
    with pytest.raises(LimitError, match="place position"):
        cell.execute(PickPlace(PlanarPose(0.5, 0.0), PlanarPose(1.5, 0.0)))
    assert cell.arm.pose() == before


def test_a_place_that_no_turn_of_the_wrist_reaches_is_refused_before_the_pick(
    cell: SimulatedWorkcell, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell.reset((8,))
    wide = Rectangle(0.2, 0.9, -0.7, 0.7)
    monkeypatch.setattr(cell.arm, "limits", replace(cell.settings.limits, workspace=wide, reach=wide))
    before = cell.clock()
    with pytest.raises(ReachError, match=r"cannot reach x 0\.850, y 0\.600, z 0\.200 m"):
        cell.execute(PickPlace(cell.truth(), PlanarPose(0.85, 0.6)))
    assert cell.clock() == before


def test_however_a_carry_is_said_the_arm_moves_the_same(cell: SimulatedWorkcell) -> None:
    ways = []
    for pick_turn, place_yaw in ((0.0, 0.0), (np.pi, 2 * np.pi), (np.pi / 2, -4 * np.pi)):
        cell.reset((12,))
        start = cell.truth()
        goal = PlanarPose(0.5, -0.15 if start.y > 0 else 0.15, place_yaw)
        pick = replace(start, yaw=wrap_angle(start.yaw, np.pi / 2) + pick_turn)
        outcome = cell.execute(PickPlace(pick, goal))
        assert outcome.success
        assert cell.truth().distance(goal) < 0.01
        # Not where the bag comes to lie: squeezed cloth makes millimetres of the last digits of an angle.
        ways.append([*outcome.executed.to_array(), cell.clock()])
    np.testing.assert_allclose(ways, np.tile(ways[0], (3, 1)), atol=5e-4)


def test_a_limit_met_on_the_way_to_the_place_puts_the_bag_back(
    cell: SimulatedWorkcell, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell.reset((13,))
    start = cell.truth()
    goal = PlanarPose(0.5, -0.15 if start.y > 0 else 0.15)
    move_to = cell.arm.move_to

    def refuse_the_place(target: ToolPose, speed_m_s: float) -> ToolPose:
        if target.planar.distance(goal) < 0.01:
            raise LimitError("the way is too long")
        return move_to(target, speed_m_s)

    monkeypatch.setattr(cell.arm, "move_to", refuse_the_place)
    with pytest.raises(LimitError, match="too long"):
        cell.execute(PickPlace(start, goal))
    assert cell.truth().distance(start) < 0.02
    assert cell.world.bodies["bag"].points[:, 2].max() < 0.06, "it lies on the table"


@given(carries_in(WorkcellSettings().workspace), st.sampled_from([1, 2, 4]))
def test_every_action_of_the_environment_is_reached(
    cell: SimulatedWorkcell, action: PickPlace, symmetry: int
) -> None:
    cell.arm.park()
    check_reached(cell, action, symmetry)


def test_a_lost_bag_is_laid_back(cell: SimulatedWorkcell) -> None:
    cell.reset((9,))
    cell.world.bodies["bag"].put(PlanarPose(0.0, 0.6), height_m=0.3, undented=True)
    assert cell.rescue()
    pose = cell.truth()
    assert cell.settings.workspace.contains(pose.x, pose.y)


def test_a_bag_laid_back_keeps_its_dents_unless_it_is_laid_as_new(cell: SimulatedWorkcell) -> None:
    here = PlanarPose(0.5, 0.1, 0.3)

    def laid(*, undented: bool) -> np.ndarray:
        cell.world.put("bag", here, undented=undented)
        cell.world.advance(1.0)
        return cell.world.bodies["bag"].points

    cell.world.reset({"bag": here})
    new = cell.world.bodies["bag"].points
    from baggie.robot.primitives import pick

    assert pick(cell.arm, here, cell.settings.handling).held
    assert cell.rescue()  # as a person would, who does not knead it
    dented = np.linalg.norm(laid(undented=False) - new, axis=1)
    undented = np.linalg.norm(laid(undented=True) - new, axis=1)
    assert dented.max() > 0.002
    assert undented.max() < 1e-5


def test_the_bag_sags_when_held(cell: SimulatedWorkcell) -> None:
    cell.reset((10,))
    start = cell.truth()
    from baggie.robot.primitives import pick

    assert pick(cell.arm, start, cell.settings.handling).held
    heights = cell.world.bodies["bag"].points[:, 2]
    assert heights.min() > 0.05  # lifted clear of the table
    assert np.ptp(heights) > 0.05  # and no plate


def test_cells_differ_and_stay_the_same() -> None:
    one, again, other = draw_cell(1), draw_cell(1), draw_cell(2)
    np.testing.assert_array_equal(one.camera_position, again.camera_position)
    assert not np.allclose(one.camera_position, other.camera_position)
    np.testing.assert_allclose(one.camera_rotation @ one.camera_rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(one.camera_rotation) == pytest.approx(1.0)


@pytest.mark.parametrize("number", range(6))
def test_every_cell_sees_the_whole_workspace(number: int) -> None:
    from baggie.workcell.workcell import WorkcellSettings

    area = WorkcellSettings().workspace
    corners = np.array([[x, y, 0.0] for x in (area.x_min, area.x_max) for y in (area.y_min, area.y_max)])
    pixels = draw_cell(number).project(corners)
    assert (pixels > 60).all()
    assert (pixels < np.array([1280, 720]) - 60).all()


def test_the_lens_puts_a_point_where_it_projects_it() -> None:
    lens = draw_cell(0).lens
    width, height = lens.size
    focal = height / 2 / np.tan(lens.render_fovy / 2)
    for ray in ([0.0, 0.0], [0.4, -0.3], [-0.8, 0.45]):
        ideal = np.zeros((height, width, 3), np.uint8)
        at = np.array(ray) * focal + [(width - 1) / 2, (height - 1) / 2]
        cv2.circle(ideal, np.round(at * 16).astype(int).tolist(), 6 * 16, (255, 255, 255), -1, cv2.LINE_AA, 4)
        v, u = np.nonzero(lens.distort(ideal)[..., 0] > 127)
        seen = lens.project(np.array([[*ray, 1.0]]))[0]
        np.testing.assert_allclose([u.mean(), v.mean()], seen, atol=0.7)


def test_the_sensor_is_unbiased_and_noisier_where_it_is_bright() -> None:
    sensor = Sensor((320, 240), vignette=0.0)
    rng = np.random.default_rng(0)
    spreads = []
    for level in (40, 200):
        recorded = sensor.expose(np.full((240, 320, 3), level, np.uint8), Exposure(), rng)
        assert recorded.mean() == pytest.approx(level, abs=0.6)
        spreads.append(recorded.std())
    assert spreads[1] > spreads[0] > 1.0


def test_a_pillow_is_closed_and_has_the_volume_of_its_parameters() -> None:
    bag = Bag(length_m=0.1, width_m=0.14, fill=1.2)
    points, tetrahedra = pillow(bag)
    edges = points[tetrahedra[:, 1:]] - points[tetrahedra[:, :1]]
    volumes = np.linalg.det(edges) / 6
    assert (volumes > 0).all()
    assert set(tetrahedra.ravel()) == set(range(len(points)))  # no point hangs in the air
    np.testing.assert_allclose(np.ptp(points, axis=0), [0.1, 0.14, bag.thickness_m])
    assert 0.4 < volumes.sum() / (0.1 * 0.14 * bag.thickness_m) < 0.9


def test_random_bags_are_reproducible_and_vary() -> None:
    one, again = (Bag.random(np.random.default_rng(3)) for _ in range(2))
    assert one == again != Bag.random(np.random.default_rng(4))


def test_inverse_kinematics_inverts_forward_kinematics() -> None:
    kinematics = Kinematics(arm_spec().compile(), HOME)
    rng = np.random.default_rng(0)
    for _ in range(5):
        target = PlanarPose(*rng.uniform([0.35, -0.3, -0.7], [0.65, 0.3, 0.7])).at_height(
            rng.uniform(0.02, 0.3)
        )
        path = kinematics.line(HOME, target)
        reached = kinematics.tool_pose(path[-1])
        np.testing.assert_allclose(reached.xyz, target.xyz, atol=5e-4)
        assert reached.yaw == pytest.approx(target.yaw, abs=2e-3)
        start = kinematics.tool_pose(HOME).xyz
        direction = (target.xyz - start) / np.linalg.norm(target.xyz - start)
        for q in path:  # the tool stays on the straight line
            along = kinematics.tool_pose(q).xyz - start
            assert np.linalg.norm(along - (along @ direction) * direction) < 0.003


def test_a_path_that_would_leave_its_line_at_a_joint_limit_is_refused() -> None:
    kinematics = Kinematics(arm_spec("cup").compile(), HOME)
    above = kinematics.line(HOME, ToolPose(0.47, 0.08, 0.18, -2.1))[-1]
    lower = ToolPose(0.47, 0.08, 0.0, -2.1)
    with pytest.raises(
        ReachError, match=r"cannot follow a straight line to x 0.470, .*mm beside it on the way"
    ):
        kinematics._line(above, lower)
    reached = kinematics.tool_pose(kinematics.line(HOME, lower)[-1])  # by another way
    np.testing.assert_allclose(reached.xyz, lower.xyz, atol=5e-4)


@given(st.floats(0.35, 0.6), st.floats(-0.3, 0.3), st.floats(-3.2, 3.2))
def test_at_its_even_speed_the_tool_is_as_fast_all_along_a_path(x: float, y: float, yaw: float) -> None:
    kinematics = Kinematics(arm_spec("cup").compile(), HOME)
    try:
        above = kinematics.line(HOME, ToolPose(x, y, 0.18, yaw))[-1]
        path = kinematics.line(above, ToolPose(x, y, 0.0, yaw))
    except ReachError:
        return
    even = kinematics.even_speed(path, JOINT_SPEED_LIMITS)
    seconds = kinematics.shortest_times(path, even, JOINT_SPEED_LIMITS)
    heights = np.array([kinematics.tool_pose(q).z for q in path])
    lengths = [
        np.linalg.norm(np.diff([kinematics.tool_pose(q).xyz for q in two], axis=0)) for two in pairwise(path)
    ]
    assert lengths / seconds == pytest.approx(even)
    assert heights[0] - heights[-1] == pytest.approx(0.18, abs=1e-3)
    rates = np.abs(np.diff(path, axis=0)) / seconds[:, None] / JOINT_SPEED_LIMITS
    assert rates.max() == pytest.approx(1.0)  # faster, one joint would be too fast


def test_where_the_tool_stays_it_has_no_speed_to_keep() -> None:
    kinematics = Kinematics(arm_spec("cup").compile(), HOME)
    path = kinematics.line(HOME, ToolPose(0.45, 0.1, 0.1, 0.0))
    turned = HOME + np.array([0, 0, 0, 0, 0, 0, 0.3])  # about the tool's own axis
    speed = kinematics.even_speed(path, JOINT_SPEED_LIMITS)
    assert kinematics.even_speed(np.stack([turned, *path, path[-1]]), JOINT_SPEED_LIMITS) == speed
    for still in ([HOME], [HOME, HOME], [HOME, turned]):
        assert kinematics.even_speed(np.stack(still), JOINT_SPEED_LIMITS) == np.inf


@given(st.floats(0.4, 0.6), st.floats(-0.25, 0.25), st.floats(-3.2, 3.2), st.integers(-20, 20))
def test_a_line_turns_the_shorter_way_if_joints_allow_and_never_goes_round(
    x: float, y: float, yaw: float, turns: int
) -> None:
    model = arm_spec().compile()
    kinematics = Kinematics(model, HOME)
    start = kinematics.line(HOME, ToolPose(0.5, 0.0, 0.2, 1.5))[-1]
    target = ToolPose(x, y, 0.2, yaw)
    path = kinematics.line(start, target)
    same = kinematics.line(start, replace(target, yaw=yaw + 2 * np.pi * turns))
    assert abs(kinematics.turn(same) - kinematics.turn(path)) < 1e-4
    assert abs(wrap_angle(kinematics.tool_pose(path[-1]).yaw - yaw)) < 2e-3
    low, high = model.jnt_range[:7].T
    assert ((low <= path) & (path <= high)).all()
    shorter = wrap_angle(yaw - 1.5)
    if abs(kinematics.turn(path) - shorter) > 0.01:
        wrist = start[6] - shorter  # roughly: the base turns, too
        assert not low[6] + 0.7 < wrist < high[6] - 0.7


def test_a_line_to_a_huge_yaw_is_no_longer_than_others() -> None:
    path = Kinematics(arm_spec().compile(), HOME).line(HOME, ToolPose(0.5, 0.0, 0.2, 1e12))
    assert len(path) < 100


def test_what_is_out_of_reach_is_said_so() -> None:
    kinematics = Kinematics(arm_spec().compile(), HOME)
    with pytest.raises(ReachError, match="choose a place nearer"):
        kinematics.line(HOME, PlanarPose(1.2, 0.3).at_height(0.1))


def test_minimum_jerk_starts_and_ends_at_rest() -> None:
    t = np.linspace(0, 1, 2001)
    s = quintic(t)
    velocity = np.gradient(s, t)
    assert (s[0], s[-1]) == (0.0, 1.0)
    assert (np.diff(s) >= 0).all()
    assert abs(velocity[0]) < 1e-3
    assert velocity.max() == pytest.approx(1.875, abs=1e-3)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_the_environment_passes_gymnasiums_own_check() -> None:
    check_env(gymnasium.make("baggie/BagPlace-v0").unwrapped, skip_render_check=True)


def test_pictures_have_the_same_colours_whether_depth_is_measured_or_not(cell: SimulatedWorkcell) -> None:
    with closing(open_simulated(0, depth=False)) as without:
        cell.reset((5, 3))
        without.reset((5, 3))
        for _ in range(2):
            seen, plain = cell.look(), without.look()
            np.testing.assert_array_equal(seen.color, plain.color)
            assert seen.depth is not None
            assert plain.depth is None
