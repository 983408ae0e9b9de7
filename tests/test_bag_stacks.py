"""The tasks that stack bags: their scenes, and stacks in the simulator."""

from contextlib import closing
from itertools import combinations

import cv2
import mujoco
import numpy as np
import pytest

from baggie.errors import BaggieError
from baggie.geometry import PlanarPose, Rectangle, ToolPose, hand_matrix
from baggie.registry import TASKS
from baggie.robot.franka.models import HOME
from baggie.robot.kinematics import Kinematics
from baggie.robot.limits import WORKSPACE as USUAL
from baggie.sim.bag import SoftBody
from baggie.sim.cell import draw_cell, hue_distance, hue_of
from baggie.sim.scene import arm_spec
from baggie.sim.sensor import Exposure
from baggie.sim.variety import UNSEEN_HUES
from baggie.tasks.bag_stacks import WORKSPACE, colored_bags, lay_about
from baggie.tasks.bag_stacks import stacking as stacking_of
from baggie.tasks.conditions import strict_success
from baggie.tasks.pattern import Pattern
from baggie.tasks.task import Setting, Task
from baggie.workcell.simulated import SimulatedWorkcell

STACKING = [TASKS[name] for name in ("bag-tower", "bag-pyramid", "bag-layers")]
BAG_M = 0.12
stacking = pytest.mark.parametrize("task", STACKING, ids=[task.name for task in STACKING])


def overlap(a: np.ndarray, b: np.ndarray) -> float:
    """Square millimetres that two outlines `(4, 2)`, metres, have in common."""
    area, _ = cv2.intersectConvexConvex((1000 * a).astype(np.float32), (1000 * b).astype(np.float32))
    return float(area)


@stacking
@pytest.mark.parametrize(
    "workspace", [WORKSPACE, Rectangle(0.30, 0.70, -0.40, 0.30)], ids=["its own", "another"]
)
def test_in_every_scene_bags_lie_apart_and_off_the_site_and_all_is_in_the_workspace(
    task: Task, workspace: Rectangle
) -> None:
    sites = []
    for seed in range(300):
        scene = task.draw(np.random.default_rng(seed), Setting(task.things, workspace=workspace))
        (stacked,) = scene.conditions
        bags = [pose.outline(BAG_M, BAG_M) for pose in scene.poses.values()]
        pattern = list(stacked.pattern.outlines(BAG_M, BAG_M)[..., :2])
        pairs = [*combinations(bags, 2), *((bag, slot) for bag in bags for slot in pattern)]
        assert max(overlap(a, b) for a, b in pairs) < 1e-3
        stacked.pattern.check_fits(workspace)
        assert all(workspace.contains(pose.x, pose.y) for pose in scene.poses.values())
        corners, beyond = np.concatenate(bags + pattern), BAG_M / 2 + 1e-9
        assert (corners >= [workspace.x_min - beyond, workspace.y_min - beyond]).all()
        assert (corners <= [workspace.x_max + beyond, workspace.y_max + beyond]).all()
        sites.append(stacked.pattern.slots[0].pose)
    assert np.ptp([site.y for site in sites]) > 0.4  # here and there
    assert np.ptp([site.yaw for site in sites]) > 5.0  # at any angle


def test_every_camera_sees_whole_what_lies_at_the_workspace_s_edge() -> None:
    beyond = BAG_M / 2
    x = WORKSPACE.x_min - beyond, WORKSPACE.x_max + beyond
    y = WORKSPACE.y_min - beyond, WORKSPACE.y_max + beyond
    for number in range(21):
        cell = draw_cell(number)
        pixels = cell.project(np.array([[a, b, z] for a in x for b in y for z in (0.0, 0.06)]))
        assert (pixels > 20).all()
        assert (pixels < np.array(cell.lens.size) - 20).all()


def test_the_arm_reaches_all_of_the_workspace_high_and_low_at_any_yaw() -> None:
    arm = Kinematics(arm_spec("hand").compile(), HOME)
    for x in (WORKSPACE.x_min, 0.5, WORKSPACE.x_max):
        for y in (WORKSPACE.y_min, WORKSPACE.y_max):
            for z in (0.02, 0.35):
                for yaw in np.deg2rad([-90.0, 0.0, 90.0]):
                    arm.reach(HOME, hand_matrix(ToolPose(x, y, z, float(yaw))))


@stacking
def test_a_task_has_a_bag_of_a_hue_of_its_own_for_each_slot_and_steps_to_spare(task: Task) -> None:
    (stacked,) = task.draw(np.random.default_rng(0)).conditions
    assert len(stacked.bags) == len(stacked.pattern.slots) < task.max_steps
    hues = [hue_of(bag.color) for bag in task.things]
    assert min(hue_distance(a, b) for a, b in combinations(hues, 2)) > 20
    assert {bag.color for bag in colored_bags(6, one_color=True)} == {task.things[0].color}


def test_a_workspace_without_room_is_one_line() -> None:
    pattern, rng = Pattern.parse("layers:2x2,2x2 turned"), np.random.default_rng(0)
    with pytest.raises(BaggieError, match=r"room for 8 bags of 12 cm beside their pattern, got x 0\.35"):
        lay_about(colored_bags(8), pattern, USUAL, rng)


@pytest.mark.parametrize("name", ["bag-tower", "bag-layers"])
def test_unseen_bags_are_square_of_one_unseen_size_and_of_unseen_hues_apart(name: str) -> None:
    task = TASKS[name]
    count = len(task.things)
    for seed in range(40):
        setting = Setting(
            task.things, workspace=Rectangle(0.2, 0.8, -0.6, 0.6), scenery="unseen-bag", seed=(seed,)
        )
        bags = task.draw(np.random.default_rng(seed), setting).things
        (size,) = {(bag.length_m, bag.width_m, bag.fill) for bag in bags}
        assert size[0] == size[1]
        assert any(low <= size[0] <= high for low, high in ((0.095, 0.105), (0.13, 0.145)))
        assert [bag.name for bag in bags] == [bag.name for bag in task.things]
        hues = [hue_of(bag.color) for bag in bags]
        assert all(any(low - 1 <= hue <= high + 1 for low, high in UNSEEN_HUES) for hue in hues)
        assert len({*hues}) == count
        if count <= 4:
            assert min(hue_distance(a, b) for a, b in combinations(hues, 2)) > 30
    one = colored_bags(3, one_color=True)
    setting = Setting(one, workspace=WORKSPACE, scenery="unseen-bag")
    assert len({bag.color for bag in TASKS["bag-tower"].draw(np.random.default_rng(0), setting).things}) == 1


def test_stacks_are_drawn_as_ever_in_other_light_and_refused_among_other_things() -> None:
    task = TASKS["bag-tower"]
    plain, light = (
        task.draw(np.random.default_rng(3), Setting(task.things, workspace=WORKSPACE, scenery=scenery))
        for scenery in ("plain", "light")
    )
    assert (plain.things, plain.poses) == (light.things, light.poses)
    assert plain.variety is None
    assert light.variety.exposure != Exposure()
    with pytest.raises(BaggieError, match="plain, light, unseen-bag for stacks of bags, got 'varied'"):
        task.draw(np.random.default_rng(3), Setting(task.things, workspace=WORKSPACE, scenery="varied"))


def test_settings_say_what_the_bags_of_a_scene_are() -> None:
    with closing(SimulatedWorkcell(0, TASKS["bag-stack"], scenery="unseen-bag", pictures=False)) as opened:
        opened.reset((8800, 1))
        bags = opened.scene.things
        assert opened.settings.object_colors == tuple(bag.color for bag in bags)
        assert opened.settings.object_size_m == bags[0].size_m != TASKS["bag-stack"].things[0].size_m
        assert opened.settings.object_symmetry == 2


def test_a_stack_that_is_to_be_taken_apart_stands_beside_free_places() -> None:
    task = TASKS["bag-unstack"]
    with closing(SimulatedWorkcell(0, task, pictures=False)) as opened:
        for number in range(3):
            opened.reset((8800, number))
            (unstacked,), state = opened.scene.conditions, opened.state()
            heights = [state.poses[bag][2, 3] for bag in unstacked.bags]
            assert heights == sorted(heights)
            assert heights[-1] > 0.04  # on two others
            for bag, slot in zip(unstacked.bags, unstacked.standing.slots, strict=True):
                assert state.places[bag].distance(slot.pose) < 0.02
            assert unstacked.share(state) == 0.0
            gaps = [place.distance(unstacked.standing.slots[0].pose) for place in unstacked.places]
            assert min(gaps) > BAG_M
        stood = opened.scene
        opened.reset((8800, 2))
        assert (opened.scene.starts.keys(), opened.scene.poses) == (stood.starts.keys(), stood.poses)
    with pytest.raises(BaggieError, match="more than one layer to take apart"):
        stacking_of(task, Pattern.parse("layers:2x2")).draw(np.random.default_rng(0))


@pytest.fixture(scope="module")
def cell():
    opened = SimulatedWorkcell(0, TASKS["bag-tower"], pictures=False)
    yield opened
    opened.close()


def lay(cell: SimulatedWorkcell, *offs_m: float) -> None:
    """Lay bags at the site, one on the other, each so far beside the one below it."""
    (stacked,) = cell.scene.conditions
    poses = {}
    for bag, slot, off_m in zip(stacked.bags, stacked.pattern.slots, np.cumsum(offs_m), strict=True):
        at = PlanarPose(slot.pose.x + float(off_m), slot.pose.y, slot.pose.yaw)
        poses[bag] = at.upright(0.017 + 0.031 * slot.layer)
    cell.world.reset(poses)


def test_a_tower_laid_straight_stands_and_counts(cell) -> None:
    lay(cell, 0.0, 0.0, 0.0)
    state = cell.state()
    assert state.points.keys() == state.poses.keys()
    for bag, points in state.points.items():
        assert points[:, 2].mean() == pytest.approx(state.poses[bag][2, 3])
    assert strict_success(cell.scene.conditions, cell)
    assert cell.demonstrate() is None


def test_an_outline_in_a_layer_is_where_the_bag_laid_there_appears(cell) -> None:
    lay(cell, 0.0, 0.0, 0.0)
    cell.wait(1.0)
    (stacked,), state = cell.scene.conditions, cell.state()
    for bag, slot in zip(stacked.bags, stacked.pattern.slots, strict=True):
        truly = cell.world.cell.project(state.poses[bag][None, :3, 3])[0]
        seen = cell.outline(state.places[bag], slot.layer).mean(axis=0)
        assert np.linalg.norm(seen - truly) < 2  # pixels, of 1 mm
    on_table, higher = (cell.outline(stacked.pattern.slots[0].pose, layer) for layer in (0, 2))
    assert np.ptp(higher, axis=0).min() > np.ptp(on_table, axis=0).min()  # nearer to the camera


def test_a_tower_whose_top_was_laid_beside_does_not_count(cell) -> None:
    lay(cell, 0.0, 0.0, 0.035)
    assert not strict_success(cell.scene.conditions, cell)
    cell.wait(1.0)
    assert not strict_success(cell.scene.conditions, cell)


def test_a_tower_that_is_pushed_falls_within_the_wait(cell) -> None:
    lay(cell, 0.0, 0.0, 0.0)
    (stacked,) = cell.scene.conditions
    assert stacked.holds(cell.state())
    top = cell.world.bodies[stacked.bags[-1]]
    assert isinstance(top, SoftBody)
    cell.world.data.qvel[top._velocities[:, 0]] = 1.0  # metres a second
    assert not strict_success(cell.scene.conditions, cell)
    assert stacked.share(cell.state()) <= 2 / 3


def test_bags_are_carried_to_the_site_by_yaws_that_say_how_the_fingers_open(cell) -> None:
    assert cell.settings.object_symmetry == TASKS["bag-tower"].object_symmetry == 2
    assert cell.settings.workspace == WORKSPACE
    cell.reset((5,))
    action = cell.demonstrate()
    (stacked,) = cell.scene.conditions
    outcome = cell.execute(action)
    assert outcome.failure is None
    turned = np.sin(outcome.executed.place.yaw - stacked.pattern.slots[0].pose.yaw)
    assert abs(turned) < np.sin(np.deg2rad(2.0))
    assert stacked.filled(cell.state()).keys() == {0}


def test_nothing_sleeps_while_a_workcell_waits() -> None:
    cell = SimulatedWorkcell(0, TASKS["block-pyramid"], pictures=False)
    asleep: list[bool] = []
    cell.world.watchers.append(lambda: asleep.append(bool((cell.world.data.tree_asleep >= 0).any())))
    flags = cell.world.model.opt.enableflags
    cell.world.advance(1.0)
    assert asleep[-1]  # so there is something to be kept awake
    asleep.clear()
    cell.wait(0.1)
    assert asleep
    assert not any(asleep)
    assert cell.world.model.opt.enableflags == flags
    assert flags & int(mujoco.mjtEnableBit.mjENBL_SLEEP)
    cell.close()
