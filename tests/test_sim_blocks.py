from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from baggie.errors import BaggieError
from baggie.geometry import FloatArray, PlanarPose, rigid, wrap_angle
from baggie.registry import TASKS
from baggie.robot.arm import Arm
from baggie.robot.primitives import pick, place
from baggie.sim.arm import BLOCK_HANDLING, SEALED_WIDTH_M, SimulatedArm, SuctionArm
from baggie.sim.arm_world import HOLDING_N, RIM_POINTS, is_flat
from baggie.sim.cell import draw_cell
from baggie.sim.objects import CUP_RADIUS_M, Block, stand
from baggie.sim.renderer import HIDDEN_GROUP
from baggie.sim.world import World

SIDE_M = 0.04
BLOCKS = [f"block{number}" for number in range(6)]
WEIGHT = "weight"  # a block of 1 kg
HEAVY_KG_M3 = 15_600.0
STAND = PlanarPose(0.5, 0.15, 0.4)
AWAY = PlanarPose(0.3, 0.35)
GENTLY = replace(BLOCK_HANDLING, carry_m_s=0.2)


@pytest.fixture(scope="module")
def world() -> World:
    blocks = [Block(name) for name in BLOCKS] + [Block(WEIGHT, density=HEAVY_KG_M3)]
    return World(draw_cell(0), [*blocks, stand()], "cup")


@pytest.fixture(scope="module")
def opened(world: World) -> SuctionArm:
    return SuctionArm(world)


@pytest.fixture
def arm(world: World, opened: SuctionArm) -> SuctionArm:
    world.reset(scattered())
    opened.reset()
    return opened


def scattered() -> dict[str, PlanarPose]:
    yaws = np.random.default_rng(0).uniform(-0.7, 0.7, len(BLOCKS))
    poses = {
        name: PlanarPose(0.40 + 0.08 * (number % 2), -0.28 + 0.08 * (number // 2), float(yaws[number]))
        for number, name in enumerate(BLOCKS)
    }
    return poses | {WEIGHT: AWAY, "stand": STAND}


def lifted_flat(x: float, y: float, z: float) -> FloatArray:
    return rigid(np.eye(3), [x, y, z])


def seal_at(arm: SuctionArm, pose: PlanarPose) -> str | None:
    """What the cup holds when it is set down there."""
    arm.move_to(pose.at_height(0.1), 1.0)
    arm.lower_until_contact(0.0, 0.2, BLOCK_HANDLING.touch_force_n)
    arm.grasp(10.0)
    held = arm._suction.held
    assert arm.gripper_width() == (SEALED_WIDTH_M if held else 0.0)
    return held


def test_the_arm_with_a_cup_is_an_arm(arm: SuctionArm) -> None:
    assert isinstance(arm, Arm)


@pytest.mark.parametrize(
    "goal", [PlanarPose(0.45, 0.25, 0.5), PlanarPose(0.6, 0.0, -0.8)], ids=["left", "ahead"]
)
def test_a_block_is_put_where_asked(world: World, arm: SuctionArm, goal: PlanarPose) -> None:
    start = world.planar_pose("block0")
    assert pick(arm, start, BLOCK_HANDLING).held
    assert world.suction.held == "block0"
    assert world.pose("block0")[2, 3] > 0.12
    assert place(arm, goal, BLOCK_HANDLING).held
    world.advance(0.2)
    there = world.planar_pose("block0")
    assert there.distance(goal) < 0.002
    assert abs(wrap_angle(there.yaw - goal.yaw)) < np.deg2rad(1.0)
    np.testing.assert_allclose(world.pose("block0")[2, 2:], [1.0, SIDE_M / 2], atol=3e-4)
    assert world.planar_pose("block1").distance(scattered()["block1"]) < 1e-4  # nobody touched it


def test_nothing_is_held_over_an_edge_or_on_the_table(world: World, arm: SuctionArm) -> None:
    block = PlanarPose(0.55, -0.05)
    world.put("block0", block)
    inside, across = SIDE_M / 2 - CUP_RADIUS_M - 0.003, SIDE_M / 2 - CUP_RADIUS_M + 0.003
    assert seal_at(arm, PlanarPose(block.x + across, block.y)) is None
    assert seal_at(arm, PlanarPose(block.x, block.y - across)) is None
    assert seal_at(arm, PlanarPose(0.6, 0.1)) is None
    assert seal_at(arm, PlanarPose(block.x + inside, block.y)) == "block0"


@pytest.mark.parametrize("gap_m", [0.0002, 0.004])
def test_nothing_is_held_over_a_gap(world: World, arm: SuctionArm, gap_m: float) -> None:
    apart = (SIDE_M + gap_m) / 2
    world.put("block0", PlanarPose(0.55 - apart, -0.05))
    world.put("block1", PlanarPose(0.55 + apart, -0.05))
    assert seal_at(arm, PlanarPose(0.55, -0.05)) is None


def test_a_hanging_block_pulls_with_its_weight_until_it_is_let_go(world: World, arm: SuctionArm) -> None:
    assert pick(arm, AWAY, GENTLY).held
    world.advance(0.5)
    weight = 9.81 * world.things[WEIGHT].mass_kg
    assert world.suction.pull_n() == pytest.approx(weight, rel=0.05)
    arm.move_gripper(0.0)
    assert world.suction.pull_n() == 0.0
    world.advance(0.5)
    assert world.pose(WEIGHT)[2, 3] < 0.05


def test_a_jerk_tears_a_heavy_block_off(world: World, arm: SuctionArm) -> None:
    assert pick(arm, AWAY, GENTLY).held
    slow = arm.move_to(AWAY.at_height(0.10), 0.2)
    assert world.suction.held == WEIGHT
    arm.move_to(replace(slow, z=0.17), 1.5)
    assert world.suction.held is None
    assert arm.gripper_width() == 0.0


def test_what_is_too_heavy_for_the_vacuum_stays(world: World, arm: SuctionArm) -> None:
    # Twice as much as holds, as a weight that pulls at the block.
    body = world.model.body(WEIGHT).id
    world.data.xfrc_applied[body, 2] = -2 * HOLDING_N
    assert not pick(arm, AWAY, BLOCK_HANDLING).held
    assert world.pose(WEIGHT)[2, 3] == pytest.approx(SIDE_M / 2, abs=0.002)


def test_a_pyramid_of_six_stands(world: World, arm: SuctionArm) -> None:
    places = [(-0.042, 0), (0.0, 0), (0.042, 0), (-0.021, 1), (0.021, 1), (0.0, 2)]
    goals = [STAND @ PlanarPose(0.0, along, 0.0) for along, _ in places]
    for name, goal in zip(BLOCKS, goals, strict=True):
        assert pick(arm, world.planar_pose(name), BLOCK_HANDLING).held
        assert place(arm, goal, BLOCK_HANDLING).held
    world.advance(2.0)
    for name, goal, (_, layer) in zip(BLOCKS, goals, places, strict=True):
        assert world.planar_pose(name).distance(goal) < 0.003
        assert world.pose(name)[2, 3] == pytest.approx(0.005 + SIDE_M * (layer + 0.5), abs=0.001)


def test_the_same_commands_give_the_same_bytes(world: World, arm: SuctionArm) -> None:
    def run() -> bytes:
        world.reset(scattered())
        arm.reset()
        pick(arm, world.planar_pose("block2"), BLOCK_HANDLING)
        place(arm, PlanarPose(0.55, 0.0, 0.3), BLOCK_HANDLING)
        return bytes(world.data.qpos.tobytes() + world.data.qvel.tobytes())

    first = run()
    pick(arm, AWAY, BLOCK_HANDLING)  # what was held before a reset leaves no trace
    assert run() == first


def test_the_stand_bears_a_block_and_can_be_put_elsewhere(world: World, arm: SuctionArm) -> None:
    np.testing.assert_allclose(world.planar_pose("stand").xy, STAND.xy)
    world.put("block0", lifted_flat(STAND.x, STAND.y, 0.04))
    world.advance(1.0)
    assert world.pose("block0")[2, 3] == pytest.approx(0.005 + SIDE_M / 2, abs=3e-4)
    world.put("stand", PlanarPose(0.6, -0.3, 1.0))
    world.advance(1.0)
    assert world.pose("block0")[2, 3] == pytest.approx(SIDE_M / 2, abs=3e-4)
    assert world.planar_pose("stand").yaw == pytest.approx(1.0)


@given(tilt=st.floats(0.0, 4.5), towards=st.floats(0.0, 2 * np.pi), away=st.floats(-0.002, 0.002))
def test_the_lip_closes_on_a_face_a_little_tilted_but_on_no_step(
    tilt: float, towards: float, away: float
) -> None:
    rim, slope = rim_points(), np.tan(np.deg2rad(tilt))
    face = away + slope * rim @ [np.cos(towards), np.sin(towards)]
    assert is_flat(rim, face)
    assert not is_flat(rim, face + np.where(rim[:, 0] > 0.004, 0.001, 0.0))  # nor over a step


@given(tilt=st.floats(5.5, 60.0), towards=st.floats(0.0, 2 * np.pi))
def test_the_lip_stays_open_on_a_face_tilted_more(tilt: float, towards: float) -> None:
    rim, slope = rim_points(), np.tan(np.deg2rad(tilt))
    assert not is_flat(rim, slope * rim @ [np.cos(towards), np.sin(towards)])


def rim_points() -> FloatArray:
    angles = np.linspace(0.0, 2 * np.pi, RIM_POINTS, endpoint=False)
    return np.asarray(CUP_RADIUS_M * np.c_[np.cos(angles), np.sin(angles)])


def test_what_is_fixed_can_be_moved_though_blocks_sleep(world: World, arm: SuctionArm) -> None:
    world.advance(1.0)
    assert (world.data.tree_asleep >= 0).any()
    camera = world.model.camera("top").id
    world.bump_camera(np.array([0.01, -0.02, 0.03]), np.array([0.0, 0.1, 0.0]))
    np.testing.assert_allclose(world.data.cam_xpos[camera], world.cell.camera_position, atol=1e-12)
    right, up, back = world.data.cam_xmat[camera].reshape(3, 3).T
    np.testing.assert_allclose(np.c_[right, -up, -back], world.cell.camera_rotation, atol=1e-9)
    table = world.model.geom("table")
    table.contype[:] = table.conaffinity[:] = 0  # whatever lay on it
    world.update_fixed()
    world.advance(0.1)
    table.contype[:] = table.conaffinity[:] = 1  # for the tests that come after
    assert max(world.pose(name)[2, 3] for name in world.movable) < 0.0


def test_a_block_of_several_boxes_is_one_body() -> None:
    (ell,) = TASKS["block-insertion"].blocks
    world = World(draw_cell(0), [ell, Block("block0")], "cup")
    body = world.model.body("ell")
    assert body.mass[0] == pytest.approx(ell.mass_kg)
    np.testing.assert_allclose(ell.mass_kg, 600.0 * 0.04 * (0.1**2 - 0.06**2))  # a square without its notch
    geoms = np.flatnonzero(world.model.geom_bodyid == body.id)
    assert len(geoms) == 3
    start = {"ell": PlanarPose(0.5, -0.1, 0.4), "block0": PlanarPose(0.5, 0.2)}
    world.reset(start)
    assert (world.model.geom_group[geoms] == 0).all()
    arm = SuctionArm(world)
    at_end = start["ell"] @ PlanarPose(0.065, 0.0)  # of a leg, 65 mm beside its frame
    goal = PlanarPose(0.45, 0.25, 1.0)
    assert pick(arm, replace(at_end, yaw=0.0), BLOCK_HANDLING).held
    assert world.suction.held == "ell"
    place(arm, goal, BLOCK_HANDLING)
    world.advance(0.2)
    expected = goal @ replace(at_end, yaw=0.0).inverse() @ start["ell"]
    there = world.planar_pose("ell")
    assert there.distance(expected) < 0.003
    assert abs(wrap_angle(there.yaw - expected.yaw)) < np.deg2rad(1.5)
    with pytest.raises(BaggieError, match="only its colours may change"):
        world.reshape([replace(ell, more=ell.more[:1])])
    with pytest.raises(BaggieError, match="only its colours may change"):
        world.reshape([replace(ell, size_m=(0.05, 0.05, 0.04))])
    world.reshape([replace(ell, color=(1, 2, 3))])
    np.testing.assert_allclose(world.model.geom_rgba[geoms[0], :3], np.array([1, 2, 3]) / 255, rtol=1e-6)
    world.reset({"block0": start["block0"]}, aside=["ell"])
    assert (world.model.geom_group[geoms] == HIDDEN_GROUP).all()


def test_bad_names_are_said_so(world: World) -> None:
    with pytest.raises(BaggieError, match="name of its own"):
        World(draw_cell(0), [Block("a"), Block("a")], "cup")
    with pytest.raises(BaggieError, match="expected poses of all"):
        world.reset({"block0": AWAY})
    with pytest.raises(BaggieError, match="got 'nothing'"):
        world.put("nothing", AWAY)
    with pytest.raises(BaggieError, match="use SuctionArm"):
        SimulatedArm(world)
